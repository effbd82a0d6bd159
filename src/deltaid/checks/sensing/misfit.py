"""Misfit between a mapped sensor signal and the robot as torques and prior determine it.

With T y in the place of y, and σ the residual that sensor noise and model errors allow,

    Q = min over θ of  n Σ_k mean((T y)_k − X_k θ)² / σ_k² + (θ − θ̂)ᵀ A (θ − θ̂),

in samples n that count as independent, over n and the number of channels. σ_k follows the size of
T y, so that nothing is gained by making it small. Rows of torques and sensors are filtered alike.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from deltaid.checks.sensing.sensed_rows import SensedRows, SensorSignal, Values
from deltaid.recording.time.signals import interpolate

# Samples of a sensor that count as independent.
_COUNTED = 200.0
# What a good model errs by: as shares of a channel's motion, of that of all like it, of its level.
_OF_CHANNEL, _OF_GROUP, _OF_MEAN = 0.08, 0.02, 0.005
# Rounds of estimating and shifting a delay, which is so large a priori [s].
_ROUNDS, _DELAY = 4, 0.05
# Stretches shorter than this, in samples, say nothing about time.
_SHORT = 12

Map = Float[np.ndarray, "channels channels"]


@dataclass(frozen=True, eq=False)
class MapFit:
    """Fit of one map: misfit Q, θ, and the standard deviation of its last entry."""

    Q: float
    theta: Float[np.ndarray, " theta"]
    last_std: float


@dataclass(frozen=True, eq=False)
class Misfit:
    """One sensor's rows as products, so that a map costs no sample."""

    rows: SensedRows
    signal: SensorSignal  # of the columns of θ
    shown: SensorSignal  # of the data y, the same unless exchanged
    beside: Float[np.ndarray, "channels added samples"] | None = None  # additional columns
    spread: float = 1.0  # standard deviation of their coefficients

    @cached_property
    def counts(self) -> float:
        return float(self.shown.counts.sum())

    @cached_property
    def theta_columns(self) -> Float[np.ndarray, "channels theta samples"]:
        own = self.signal.X
        return own if self.beside is None else np.concatenate([own, self.beside], axis=1)

    @cached_property
    def moving(self) -> Values:
        """y without its mean where it counts."""
        mean = self.shown.y.sum(axis=1) / max(self.counts, 1e-300)
        return self.shown.y - mean[:, None] * self.shown.counts

    @cached_property
    def white(self) -> Float[np.ndarray, " channels"]:
        """Noise from row to row, as second differences show it [N, N m]."""
        second = np.diff(self.shown.raw, 2, axis=1)
        counts = np.isfinite(second).sum(axis=1)
        return np.sqrt(np.nansum(second**2, axis=1) / np.maximum(counts, 1) / 6)

    @cached_property
    def noise(self) -> Float[np.ndarray, " channels"]:
        """As stated [N, N m]."""
        return np.array([channel.noise for channel in self.signal.rows.channels])

    @cached_property
    def groups(self) -> list[list[int]]:
        """Channels that measure the same: forces, and moments."""
        units = self.signal.units
        return [[k for k, unit in enumerate(units) if unit == kind] for kind in sorted(set(units))]

    @cached_property
    def _unknowns(self) -> Float[np.ndarray, "2 unknowns"]:
        """Prior means and standard deviations of what θ has behind the robot's parameters."""
        of_sensor = [(entry.prior, entry.std) for entry in self.signal.rows.parameters]
        added = self.theta_columns.shape[1] - self.signal.X.shape[1]
        return np.reshape([*of_sensor, *[(0.0, self.spread)] * added], (-1, 2)).T

    @cached_property
    def by_torques(self) -> Float[np.ndarray, " theta"]:
        return np.append(self.rows.by_torques.x, self._unknowns[0])

    @cached_property
    def _precision(self) -> Float[np.ndarray, "theta theta"]:
        """A of θ by torques and prior."""
        rows = self.rows.by_torques.A
        return block_diag(rows.T @ rows, np.diag(self._unknowns[1] ** -2.0))

    @cached_property
    def _moments(self) -> Float[np.ndarray, "channels augmented augmented"]:
        """Second moments of [X_k; y] for each channel k."""
        y = np.broadcast_to(self.shown.y, (len(self.theta_columns), *self.shown.y.shape))
        rows = np.concatenate([self.theta_columns, y], axis=1)
        return rows @ rows.swapaxes(1, 2) / max(self.counts, 1.0)

    @cached_property
    def _motion(self) -> Float[np.ndarray, "channels channels"]:
        """Second moments of y's motion."""
        return self.moving @ self.moving.T / max(self.counts, 1.0)

    @cached_property
    def _level(self) -> Float[np.ndarray, " channels"]:
        """What it should show in the mean, but for its own offsets."""
        p = self.rows.by_torques.x
        return self.theta_columns[:, : len(p)].sum(axis=2) @ p / max(self.counts, 1.0)

    def _sigma(self, T: Map) -> Float[np.ndarray, " channels"]:
        """Admissible residual of each channel."""
        motion = np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", T, self._motion, T), 0.0))
        group_motion = np.empty_like(motion)
        for group in self.groups:
            group_motion[group] = np.sqrt(np.mean(motion[group] ** 2))
        white = np.minimum(np.abs(T), 1.0) @ self.white
        of_model = _OF_CHANNEL * motion, _OF_GROUP * group_motion, _OF_MEAN * self._level
        return np.sqrt(np.sum(np.square((*of_model, self.noise, white)), axis=0))

    def judge(self, T: Map, only: list[int] | None = None) -> MapFit:
        """Judge one map, by some channels; default all."""
        kept = list(range(len(T))) if only is None else only
        T, weights = T[kept], _COUNTED / self._sigma(T)[kept] ** 2
        n, moments, known = len(self.by_torques), self._moments[kept], self._precision
        A = known + np.tensordot(weights, moments[:, :n, :n], 1)
        b = known @ self.by_torques
        constant = float(b @ self.by_torques)
        b += weights @ np.einsum("kij,kj->ki", moments[:, :n, n:], T)
        constant += float(weights @ np.einsum("ki,kij,kj->k", T, moments[:, n:, n:], T))
        theta, of_last = np.linalg.solve(A, np.stack([b, np.eye(n)[-1]], axis=1)).T
        Q = max(constant - float(b @ theta), 0.0) / (_COUNTED * len(kept))
        return MapFit(Q, theta, float(np.sqrt(of_last[-1] * max(Q, 1e-6))))

    def expected(self, theta: Float[np.ndarray, " theta"]) -> Values:
        return np.einsum("kin,i->kn", self.theta_columns, theta)

    def left(self, fit: MapFit) -> Float[np.ndarray, " channels"]:
        """RMS residual of each unmapped channel, in its own unit."""
        residual = self.shown.y - self.expected(fit.theta)
        return np.sqrt(np.sum(residual**2, axis=1) / max(self.counts, 1.0))

    def unexplained(self, fit: MapFit) -> float:
        """Unexplained share of y's motion, at most 1."""
        residual, motion = self.left(fit) ** 2, np.mean(self.moving**2, axis=1)
        shares = [residual[group].sum() / max(motion[group].sum(), 1e-300) for group in self.groups]
        return min(1.0, float(np.sqrt(max(shares))))

    @property
    def along(self) -> float:
        """Correlation of the signal with the one expected from torques, without means."""
        expected = self.expected(self.by_torques)
        expected -= expected.sum(axis=1, keepdims=True) / self.counts * self.shown.counts
        expected, y = expected / self.noise[:, None], self.moving / self.noise[:, None]
        size = np.sqrt(np.sum(expected**2) * np.sum(y**2))
        return float(abs(np.sum(expected * y)) / max(size, 1e-300))

    def stretches(self) -> Iterator[slice]:
        """Stretches without a gap that are long enough to determine a delay."""
        ends = [*self.rows.starts[1:].tolist(), self.shown.y.shape[1]]
        for first, last in zip(self.rows.starts.tolist(), ends, strict=True):
            if last - first >= _SHORT:
                yield slice(first, last)

    def earlier(self, delay: float) -> "Misfit":
        """The same with the signal shifted earlier [s]."""
        y = self.shown.y.copy()
        for part in self.stretches() if delay else ():
            values = self.shown.y[:, part].T
            time = np.arange(len(values)) * self.rows.period
            y[:, part] = interpolate(time, values, np.clip(time + delay, time[0], time[-1])).T
        return replace(self, shown=replace(self.shown, y=y))


@dataclass(frozen=True)
class SensorLag:
    """A sensor's delay against the motion, its standard deviation [s], and the misfit without."""

    delay: float
    std: float
    Q: float


def lag_of(misfit: Misfit, unshifted: MapFit) -> SensorLag | None:
    """The delay of a sensor, y(t) = ŷ(t − δ), by Gauss–Newton steps jointly with θ."""
    if np.ptp(misfit.shown.counts) > 1e-6:  # with holes there is no shifting
        return None
    T, theta, delay, std = np.eye(len(misfit.noise)), unshifted.theta, 0.0, np.inf
    for _ in range(_ROUNDS):
        expected = misfit.expected(theta)
        slope = np.zeros_like(expected)
        for part in misfit.stretches():
            slope[:, part] = -np.gradient(expected[:, part], misfit.rows.period, axis=1)
        fit = replace(misfit.earlier(delay), beside=slope[:, None, :], spread=_DELAY).judge(T)
        theta, step, std = fit.theta[:-1], float(fit.theta[-1]), fit.last_std
        delay += step
        if abs(step) < 0.1 * std:
            break
    return SensorLag(delay, std, misfit.earlier(delay).judge(T).Q)
