"""Rows of torques and sensors of a recording, filtered alike."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import stated_spreads
from deltaid.estimation.information import Information, entries_at, triangle
from deltaid.estimation.problem import LinearProblem
from deltaid.recording.columns import SensorChannels
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.sensors.robot_sensors import all_sensor_rows
from deltaid.sensors.rows import SensorRows

# Least residual of torques, as a share of each, and samples of them that count as independent.
_LEFT, _OF_TORQUES = 0.02, 1000.0
# Fixed parameters are known to this share of their size.
_KNOWN = 1e-4
# Parameters zero by symmetry where not free, and how far real bodies are from that.
_BY_SYMMETRY, _STRAIGHT = ("mcx", "mcy", "mcz", "Ixy", "Iyz", "Ixz"), 0.02
# Windows of a recording that are evaluated, and samples of them all after the filter.
_WINDOWS, _MOST = 6, 4000

Values = Float[np.ndarray, "channels samples"]


@dataclass(frozen=True, eq=False)
class SensorSignal:
    """What one sensor shows: y = X θ, θ the robot's parameters and then the sensor's unknowns."""

    rows: SensorRows  # what it measures of the robot
    columns: SensorChannels  # in the log
    X: Float[np.ndarray, "channels theta samples"]  # like y filtered, zero where nothing counts
    y: Values
    counts: Float[np.ndarray, " samples"]  # how far each sample does
    raw: Float[np.ndarray, "channels rows"]  # y in all rows, unfiltered; NaN where nothing

    @property
    def name(self) -> str:
        return self.rows.name

    @property
    def units(self) -> list[str]:
        return [channel.unit for channel in self.rows.channels]


@dataclass(frozen=True, eq=False)
class SensedRows:
    """The rows of a recording."""

    dynamics: Dynamics
    signals: tuple[SensorSignal, ...]
    torques: Information  # what the drives' torques tell of all the robot's parameters
    starts: Int[np.ndarray, " stretches"]  # first samples of stretches without a gap
    period: float  # between two samples [s]
    row: float  # between two rows of the log [s]

    @cached_property
    def by_torques(self) -> LinearProblem:
        """Least squares of the robot's parameters by torques and prior."""
        robot, layout = self.dynamics.robot, self.dynamics.layout
        stated = stated_spreads(robot)
        prior = np.array([entry.prior for entry in layout.parameters])
        scale = np.array([entry.scale for entry in layout.parameters])
        std = scale * [stated.get(name, PRIOR_SPREAD) for name in layout.names]
        for k, entry in enumerate(layout.parameters[: layout.coefficients.start]):
            free, symbol = robot.bodies[entry.owner].free, entry.symbol
            if not free or (symbol in _BY_SYMMETRY and symbol.replace("I", "S") not in free):
                std[k] = (_STRAIGHT if free else _KNOWN) * entry.scale
        torques, size, samples = self.torques, self.torques.torque_rms(), self.torques.samples
        noise, counted = np.maximum(size, 1e-12), np.minimum(_OF_TORQUES / samples, 1.0)

        def weighted() -> LinearProblem:
            problem = LinearProblem.of_triangle(torques.weighted(counted / noise**2), torques.rows)
            return problem.with_known(np.diag(1 / std), prior / std)

        for _ in range(2):  # the residual sets each drive's weight
            noise = np.maximum(torques.rms(weighted().x), _LEFT * size + 1e-12)
        return weighted()


def sensed_rows(dynamics: Dynamics, recording: PreparedRecording) -> SensedRows | None:
    """The rows of a recording; None where it has no sensor, or too little of one."""
    columns, drives = recording.log.columns, np.arange(dynamics.dof)
    sensor_columns = {sensor.name: sensor for sensor in columns.sensors}
    if not sensor_columns or not columns.torque:
        return None
    sensors = [rows for rows in all_sensor_rows(dynamics) if rows.name in sensor_columns]
    row_of, entries = dynamics.regressor_pattern

    def measured(w: SampleBlock) -> np.ndarray:
        shown, free = columns.shown(w.extra), ~columns.held(w.time, w.extra).any(axis=0)
        Y = entries_at(dynamics, w.z, w.qd, w.qdd, np.zeros_like(w.qd))
        parts = [w.weighted(Y, row_of), w.weighted(w.tau.T, drives)]
        for rows in sensors:
            sensor = shown[rows.name]
            counts = free & np.isfinite(sensor).all(axis=0)
            C = rows.entries(w.z, w.qd, w.qdd, np.zeros_like(sensor))
            parts += [
                C * counts,
                np.where(counts, sensor, 0.0),
                np.atleast_2d(counts).astype(float),
            ]
        return np.vstack(parts)

    windows = list(recording.spread(dynamics.kinematics, _WINDOWS))
    every = max(1, -(-recording.log.samples // (recording.filter.thinned * _MOST)))
    parts = [window.filtered(measured)[:, ::every] for window in windows]
    parts = [part for part in parts if part.shape[1] > 1]
    if not parts:
        return None
    each = [n for rows in sensors for n in (len(rows.pattern[0]), len(rows.channels), 1)]
    ends = np.cumsum([len(row_of), len(drives), *each])[:-1]
    sparse, tau, *data = np.split(np.hstack(parts), ends)
    parameters, samples = len(dynamics.layout.parameters), tau.shape[1]
    rows_of_drives = np.zeros((len(drives), parameters + 1, samples))
    rows_of_drives[row_of, entries], rows_of_drives[:, -1] = sparse, tau
    torques = Information(
        np.arange(parameters),
        np.stack([triangle(rows.T) for rows in rows_of_drives]),
        np.full(len(drives), float(samples)),
        np.abs(tau).max(axis=1),
    )
    shown, signals = [columns.shown(window.own.extra) for window in windows], list[SensorSignal]()
    for rows, C, y, (counts,) in zip(sensors, data[::3], data[1::3], data[2::3], strict=True):
        X = np.zeros((len(rows.channels), parameters + len(rows.parameters), samples))
        X[rows.pattern] = C
        raw = np.hstack([sensor[rows.name] for sensor in shown])
        signals.append(SensorSignal(rows, sensor_columns[rows.name], X, y, counts, raw))
    starts = np.cumsum([0, *(part.shape[1] for part in parts)])[:-1]
    row = 1 / recording.log.rate
    period = recording.filter.thinned * every * row
    return SensedRows(dynamics, tuple(signals), torques, starts, period, row)
