"""Filtered rows of torques and sensors of a recording, side by side, and what torques alone say."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import stated_spreads
from deltaid.estimation.information import entries_at
from deltaid.recording.columns import SensorChannels
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples, Window
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.sensors.of_robot import all_sensor_rows
from deltaid.sensors.rows import SensorRows

# Windows of a recording that are looked at, and samples of them all after the filter.
_WINDOWS, _MOST = 6, 4000
# What a model leaves of torques at least, as a share of each; samples that count as independent.
_LEFT, _COUNTED = 0.02, 1000.0
# What is not free is known to this share of its size.
_KNOWN = 1e-4
# What symmetry makes zero, where it is not free, and how far real bodies are from that.
_BY_SYMMETRY, _STRAIGHT = ("mcx", "mcy", "mcz", "Ixy", "Iyz", "Ixz"), 0.02

Matrix = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class Sensed:
    """One sensor among the rows.

    Attributes:
        rows: what it shows of the robot.
        given: its columns in the log.
        channels: which rows of the sheet are its own.
    """

    rows: SensorRows
    given: SensorChannels
    channels: slice

    @property
    def name(self) -> str:
        """As in the description."""
        return self.rows.name


@dataclass(frozen=True, eq=False)
class Sheet:
    """Rows over θ, the robot's parameters and then all unknowns of sensors.

    Attributes:
        dynamics: of the robot.
        sensors: those of the recording.
        X: of what sensors show; y: what they show, both filtered, zero where it does not count.
        told: how far each sample counts for each channel.
        Y, tau: of the drives' torques.
        starts: first samples of stretches without a gap.
        period: between two samples [s].
        row: between two rows of the log [s].
        raw: what sensors show in all rows of these stretches, unfiltered; NaN where nothing.
    """

    dynamics: Dynamics
    sensors: tuple[Sensed, ...]
    X: Float[np.ndarray, "channels theta samples"]
    y: Float[np.ndarray, "channels samples"]
    told: Float[np.ndarray, "channels samples"]
    Y: Float[np.ndarray, "drives parameters samples"]
    tau: Float[np.ndarray, "drives samples"]
    starts: Int[np.ndarray, " stretches"]
    period: float
    row: float
    raw: Float[np.ndarray, "channels rows"]

    @cached_property
    def prior(self) -> tuple[Float[np.ndarray, " theta"], Float[np.ndarray, " theta"]]:
        """Mean and standard deviation of θ before any row."""
        robot, layout = self.dynamics.robot, self.dynamics.layout
        stated = stated_spreads(robot)
        std = [one.scale * stated.get(one.name, PRIOR_SPREAD) for one in layout.parameters]
        for k, one in enumerate(layout.parameters[: layout.coefficients.start]):
            free = robot.bodies[one.owner].free
            if not free:
                std[k] = _KNOWN * one.scale
            elif one.symbol in _BY_SYMMETRY and one.symbol.replace("I", "S") not in free:
                std[k] = _STRAIGHT * one.scale
        own = [one for sensor in self.sensors for one in sensor.rows.parameters]
        mean = [one.prior for one in (*layout.parameters, *own)]
        return np.array(mean), np.array(std + [one.std for one in own])

    @cached_property
    def of_torques(self) -> tuple[Matrix, Float[np.ndarray, " theta"]]:
        """A and A θ of what torques and prior say of θ."""
        mean, std = self.prior
        A, h = np.diag(std**-2.0), mean / std**2
        own = len(self.dynamics.layout.parameters)
        noise = np.maximum(np.sqrt(np.mean(self.tau**2, axis=1)), 1e-12)
        G, g = A, h
        for _ in range(3):  # what is left tells how far each drive counts
            G, g = A.copy(), h.copy()
            for Y, tau, left in zip(self.Y, self.tau, noise, strict=True):
                share = min(_COUNTED, len(tau)) / (len(tau) * left**2)
                G[:own, :own] += share * (Y @ Y.T)
                g[:own] += share * (Y @ tau)
            p = np.linalg.solve(G, g)[:own]
            left = self.tau - np.einsum("ijk,j->ik", self.Y, p)
            floor = _LEFT * np.sqrt(np.mean(self.tau**2, axis=1)) + 1e-12
            noise = np.maximum(np.sqrt(np.mean(left**2, axis=1)), floor)
        return G, g


def sheet(dynamics: Dynamics, recording: Recording) -> Sheet | None:
    """The rows of a recording; None where it has no sensor, or too little of one."""
    columns = recording.log.columns
    if not columns.sensors or not columns.torque:
        return None
    given = {one.name: one for one in columns.sensors}
    every = [rows for rows in all_sensor_rows(dynamics) if rows.name in given]
    sensors, first = list[Sensed](), 0
    for rows in every:
        channels = slice(first, first + len(rows.channels))
        sensors.append(Sensed(rows, given[rows.name], channels))
        first = channels.stop
    windows = list(recording.spread(dynamics.kinematics, _WINDOWS))
    shown = [columns.shown(w.own.extra) for w in windows]
    raw = np.hstack([np.vstack([one[sensor.name] for sensor in sensors]) for one in shown])
    parts = [_rows(dynamics, sensors, w, recording) for w in windows]
    parts = [part for part in parts if part[1].shape[1] > 1]
    if not parts:
        return None
    X, y, told, Y, tau = (np.concatenate([part[k] for part in parts], axis=-1) for k in range(5))
    thinned = recording.thinned * _every(recording)
    lengths = np.cumsum([0, *(part[1].shape[1] for part in parts)])[:-1]
    row = 1 / recording.log.rate
    return Sheet(dynamics, tuple(sensors), X, y, told, Y, tau, lengths, thinned * row, row, raw)


def _every(recording: Recording) -> int:
    """Of what the filter keeps each so-manieth is taken."""
    return max(1, -(-recording.log.samples // (recording.thinned * _MOST)))


def _rows(
    dynamics: Dynamics, sensors: Sequence[Sensed], window: Window, recording: Recording
) -> tuple[np.ndarray, ...]:
    """X, y, weights, Y and τ of a window."""
    columns, own = recording.log.columns, len(dynamics.layout.parameters)
    drives, entries = dynamics.regressor_pattern

    def of(w: Samples) -> np.ndarray:
        shown = columns.shown(w.extra)
        free = ~columns.held(w.time, w.extra).any(axis=0)
        Y = entries_at(dynamics, w.z, w.qd, w.qdd, np.zeros_like(w.qd))
        parts = [w.weighted(Y, drives), w.weighted(w.tau.T, np.arange(dynamics.dof))]
        for sensor in sensors:
            values = shown[sensor.name]
            counts = free & np.isfinite(values).all(axis=0)
            C = sensor.rows.entries(w.z, w.qd, w.qdd, np.zeros_like(values))
            parts += [C * counts, np.where(counts, values, 0.0)]
            parts.append(np.tile(counts.astype(float), (len(values), 1)))
        return np.vstack(parts)

    values = window.filtered(of)[:, :: _every(recording)]
    samples = values.shape[1]
    cuts = [len(drives), dynamics.dof]
    for sensor in sensors:
        cuts += [len(sensor.rows.pattern[0])] + [len(sensor.rows.channels)] * 2
    sparse, tau, *parts = np.split(values, np.cumsum(cuts)[:-1])
    Y = np.zeros((dynamics.dof, own, samples))
    Y[drives, entries] = sparse
    total = own + sum(len(sensor.rows.parameters) for sensor in sensors)
    X, y, told, first = list[np.ndarray](), list[np.ndarray](), list[np.ndarray](), own
    for k, sensor in enumerate(sensors):
        C = np.zeros((len(sensor.rows.channels), total, samples))
        channels, at = sensor.rows.pattern
        C[channels, np.where(at < own, at, at - own + first)] = parts[3 * k]
        first += len(sensor.rows.parameters)
        X.append(C)
        y.append(parts[3 * k + 1])
        told.append(parts[3 * k + 2])
    return np.concatenate(X), np.concatenate(y), np.concatenate(told), Y, tau
