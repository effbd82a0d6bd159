"""Misfit between a mapped sensor signal and the robot as torques and prior determine it.

With T y in place of y, and σ the residual that sensor noise and model errors allow,

    Q = min over θ of  n Σ_k mean((T y)_k − X_k θ)² / σ_k² + ‖D (θ − θ̂)‖²,

divided by the number n of independent samples and the number of channels. σ_k scales with T y, so a
small T gains nothing. Rows of torques and sensors pass the same filter.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import block_diag

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_deviations, prior_parameters
from deltaid.estimation.information import Information, entries_at, triangle
from deltaid.estimation.problem import LinearProblem
from deltaid.levels import EXACT
from deltaid.recording.columns import Columns, SensorChannels
from deltaid.recording.log import FEW_WINDOWS
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.time.signals import interpolate
from deltaid.recording.windows import SampleBlock
from deltaid.robot.body import ZERO_UNLESS_FREE
from deltaid.sensors.robot_sensors import all_sensor_rows
from deltaid.sensors.rows import SensorRows

# Prior deviation of entries that symmetry makes zero, as a share of their scale.
_STRAIGHT = 0.02
# Most filtered samples of all evaluated windows.
_MOST = 4000
# Number of independent samples that a drive or a sensor counts for.
_COUNTED = 200.0
# Errors of a good model, as shares of a channel's motion, of a drive's or group's, of its mean.
_OF_CHANNEL, _OF_GROUP, _OF_MEAN = 0.08, 0.02, 0.005

Map = Float[np.ndarray, "channels channels"]
Values = Float[np.ndarray, "channels samples"]
Theta = Float[np.ndarray, " theta"]


@dataclass(frozen=True, eq=False)
class MapFit:
    """Fit of one map: misfit Q, θ, and the standard deviation of its last entry."""

    Q: float
    theta: Theta
    last_std: float


@dataclass(frozen=True, eq=False)
class Misfit:
    """Measured values y = X θ of one sensor, with θ the robot's parameters and then the sensor's
    unknowns, and the distribution of θ from torques and prior."""

    rows: SensorRows
    columns: SensorChannels  # in the log
    by_torques: Theta  # θ̂
    D: Float[np.ndarray, "theta theta"]
    X: Float[np.ndarray, "channels theta samples"]  # filtered like y, zero in excluded rows
    y: Values
    samples: Float[np.ndarray, " samples"]  # weight of each
    raw: Float[np.ndarray, "channels rows"]  # y in all rows, unfiltered; NaN where missing
    starts: Int[np.ndarray, " stretches"]  # first samples of stretches without a gap
    period: float  # between two samples [s]
    row: float  # between two rows of the log [s]

    @property
    def name(self) -> str:
        return self.rows.name

    @property
    def units(self) -> list[str]:
        return [channel.unit for channel in self.rows.channels]

    @cached_property
    def counts(self) -> float:
        return float(self.samples.sum())

    @cached_property
    def moving(self) -> Values:
        """y without its weighted mean."""
        return self.y - np.outer(self.y.sum(axis=1) / max(self.counts, 1e-300), self.samples)

    @cached_property
    def white(self) -> Float[np.ndarray, " channels"]:
        """White noise by second differences [N, N m]."""
        second = np.diff(self.raw, 2, axis=1)
        counts = np.isfinite(second).sum(axis=1)
        return np.sqrt(np.nansum(second**2, axis=1) / np.maximum(counts, 1) / 6)

    @cached_property
    def noise(self) -> Float[np.ndarray, " channels"]:
        """Stated noise [N, N m]."""
        return np.array([channel.noise for channel in self.rows.channels])

    @cached_property
    def groups(self) -> list[list[int]]:
        """Channels of the same unit: forces, and moments."""
        units = self.units
        return [[k for k, unit in enumerate(units) if unit == kind] for kind in sorted(set(units))]

    def with_columns(
        self, columns: Float[np.ndarray, "channels added _"], spread: float
    ) -> "Misfit":
        """The misfit with additional columns and the prior deviation of their coefficients."""
        n = columns.shape[1]
        return replace(
            self,
            X=np.concatenate([self.X, columns], axis=1),
            by_torques=np.append(self.by_torques, np.zeros(n)),
            D=block_diag(self.D, np.eye(n) / spread),
        )

    @cached_property
    def _triangles(self) -> Float[np.ndarray, "channels _ augmented"]:
        """R of each channel k with RᵀR the mean second moments of [X_k; y], to judge maps fast."""
        y = np.broadcast_to(self.y, (len(self.X), *self.y.shape))
        rows = np.concatenate([self.X, y], axis=1) / np.sqrt(max(self.counts, 1.0))
        return np.asarray(np.linalg.qr(rows.swapaxes(1, 2), mode="r"))

    def _sigma(self, T: Map) -> Float[np.ndarray, " channels"]:
        """Admissible residual of each channel."""
        motion = np.sqrt(np.sum((T @ self.moving) ** 2, axis=1) / max(self.counts, 1.0))
        of_group = np.empty_like(motion)
        for group in self.groups:
            of_group[group] = np.sqrt(np.mean(motion[group] ** 2))
        p = self.by_torques[: len(self.rows.dynamics.layout.names)]
        # Expected mean without the sensor's offsets.
        level = self.X[:, : len(p)].sum(axis=2) @ p / max(self.counts, 1.0)
        of_model = _OF_CHANNEL * motion, _OF_GROUP * of_group, _OF_MEAN * level
        white = np.minimum(np.abs(T), 1.0) @ self.white
        return np.sqrt(np.sum(np.square((*of_model, self.noise, white)), axis=0))

    def judge(self, T: Map, only: list[int] | None = None) -> MapFit:
        """The fit of one map by some channels; by default all."""
        kept, n = list(range(len(T))) if only is None else only, len(self.by_torques)
        R = self._triangles[kept] * (np.sqrt(_COUNTED) / self._sigma(T)[kept])[:, None, None]
        b = np.einsum("kri,ki->kr", R[:, :, n:], T[kept]).ravel()
        problem = LinearProblem(R[:, :, :n].reshape(-1, n), b, np.zeros(len(b), dtype=int))
        problem = problem.with_known(self.D, self.D @ self.by_torques)
        Q = float(problem.residual @ problem.residual) / (_COUNTED * len(kept))
        last_std = float(np.linalg.norm(problem.inverse[-1]) * np.sqrt(max(Q, 1e-6)))
        return MapFit(Q, problem.x, last_std)

    def expected(self, theta: Theta) -> Values:
        return np.einsum("kin,i->kn", self.X, theta)

    def residual_rms(self, fit: MapFit) -> Float[np.ndarray, " channels"]:
        """RMS residual of each unmapped channel, in its unit."""
        residual = self.y - self.expected(fit.theta)
        return np.sqrt(np.sum(residual**2, axis=1) / max(self.counts, 1.0))

    def unexplained(self, fit: MapFit) -> float:
        """Unexplained share of y's motion, at most 1."""
        residual = np.sum((self.y - self.expected(fit.theta)) ** 2, axis=1)
        motion = np.sum(self.moving**2, axis=1)
        shares = [residual[group].sum() / max(motion[group].sum(), 1e-300) for group in self.groups]
        return min(1.0, float(np.sqrt(max(shares))))

    @property
    def correlation(self) -> float:
        """Correlation of the signal with the one expected from torques, without means."""
        expected = self.expected(self.by_torques)
        expected -= expected.sum(axis=1, keepdims=True) / self.counts * self.samples
        expected, y = expected / self.noise[:, None], self.moving / self.noise[:, None]
        size = np.sqrt(np.sum(expected**2) * np.sum(y**2))
        return float(abs(np.sum(expected * y)) / max(size, 1e-300))

    def stretches(self) -> Iterator[slice]:
        """Stretches without a gap."""
        ends = [*self.starts[1:].tolist(), self.y.shape[1]]
        yield from map(slice, self.starts.tolist(), ends)

    def earlier(self, delay: float) -> "Misfit":
        """The misfit with the signal shifted earlier by a delay [s]."""
        y = self.y.copy()
        for part in self.stretches() if delay else ():
            time = np.arange(part.stop - part.start) * self.period
            shifted = np.clip(time + delay, time[0], time[-1])
            y[:, part] = interpolate(time, self.y[:, part].T, shifted).T
        return replace(self, y=y)


def misfits(dynamics: Dynamics, recording: PreparedRecording) -> list[Misfit]:
    """Misfits of a recording's sensors, filtered like torques; none with too few samples."""
    columns = recording.log.columns
    mapped = {sensor.name: sensor for sensor in columns.sensors}
    if not mapped or not columns.torque:
        return []
    sensors = [rows for rows in all_sensor_rows(dynamics) if rows.name in mapped]
    windows = list(recording.spread(dynamics.kinematics, FEW_WINDOWS))
    every = max(1, -(-recording.log.samples // (recording.filter.thinned * _MOST)))
    measured = partial(_measured, dynamics, columns, sensors)
    parts = [window.filtered(measured)[:, ::every] for window in windows]
    parts = [part for part in parts if part.shape[1] > 1]
    if not parts:
        return []
    torque_rows = len(dynamics.regressor_pattern[0]), dynamics.dof
    each = [n for rows in sensors for n in (len(rows.pattern[0]), len(rows.channels), 1)]
    ends = np.cumsum([*torque_rows, *each])[:-1]
    sparse, tau, *data = np.split(np.hstack(parts), ends)
    known, parameters = _by_torques(dynamics, sparse, tau), len(dynamics.layout.parameters)
    raw, found = [columns.shown(window.inner.extra) for window in windows], list[Misfit]()
    for rows, C, y, (counts,) in zip(sensors, data[::3], data[1::3], data[2::3], strict=True):
        X = np.zeros((len(rows.channels), parameters + len(rows.parameters), len(counts)))
        X[rows.pattern] = C
        found.append(
            Misfit(
                rows,
                mapped[rows.name],
                np.append(known.x, [entry.prior for entry in rows.parameters]),
                block_diag(known.root, np.diag([1.0 / entry.std for entry in rows.parameters])),
                X,
                y,
                counts,
                raw=np.hstack([signals[rows.name] for signals in raw]),
                starts=np.cumsum([0, *(part.shape[1] for part in parts)])[:-1],
                period=recording.filter.thinned * every / recording.log.rate,
                row=1 / recording.log.rate,
            )
        )
    return found


def _measured(
    dynamics: Dynamics, columns: Columns, sensors: Sequence[SensorRows], w: SampleBlock
) -> Float[np.ndarray, "rows samples"]:
    """Entries of the regressor, and torques; then of each sensor its entries, its values, and
    whether a sample counts."""
    signals, free = columns.shown(w.extra), ~columns.held(w.time, w.extra).any(axis=0)
    Y = entries_at(dynamics, w.z, w.qd, w.qdd, np.zeros_like(w.qd))
    drives, _ = dynamics.regressor_pattern
    parts = [w.weighted(Y, drives), w.weighted(w.tau.T, np.arange(dynamics.dof))]
    for rows in sensors:
        y = signals[rows.name]
        counts = free & np.isfinite(y).all(axis=0)
        C = rows.entries(w.z, w.qd, w.qdd, np.zeros_like(y))
        parts += [C * counts, np.where(counts, y, 0.0), np.atleast_2d(counts).astype(float)]
    return np.vstack(parts)


def _by_torques(
    dynamics: Dynamics, sparse: Values, tau: Float[np.ndarray, "dof samples"]
) -> LinearProblem:
    """Least squares of the robot's parameters from torques and prior.

    Args:
        sparse: entries of the regressor, in the order of its pattern.
    """
    drives, entries = dynamics.regressor_pattern
    count, samples = len(dynamics.layout.parameters), tau.shape[1]
    Y = np.zeros((dynamics.dof, count + 1, samples))
    Y[drives, entries], Y[:, -1] = sparse, tau
    triangles, largest = np.stack([triangle(rows.T) for rows in Y]), np.abs(tau).max(axis=1)
    counted = np.full(dynamics.dof, float(samples))
    torques = Information(np.arange(count), triangles, counted, largest)
    robot, layout = dynamics.robot, dynamics.layout
    prior, std = prior_parameters(robot), prior_deviations(robot)
    for k, entry in enumerate(layout.parameters[: layout.coefficients.start]):
        free, symbol = robot.bodies[entry.owner].free, entry.symbol.replace("I", "S")
        if not free or (symbol in ZERO_UNLESS_FREE and symbol not in free):
            std[k] = (_STRAIGHT if free else EXACT) * entry.scale
    size, counted = torques.torque_rms(), np.minimum(_COUNTED / torques.samples, 1.0)

    def weighted(noise: Float[np.ndarray, " drives"]) -> LinearProblem:
        problem = LinearProblem.of_triangle(torques.weighted(counted / noise**2), torques.rows)
        return problem.with_known(np.diag(1 / std), prior / std)

    noise = np.maximum(size, 1e-12)
    for _ in range(2):  # the residual sets each drive's weight
        noise = np.maximum(torques.rms(weighted(noise).x), _OF_GROUP * size + 1e-12)
    return weighted(noise)
