"""Misfit between a mapped sensor signal and the robot as torques and prior determine it.

With T y in the place of y, and σ the residual that sensor noise and model errors allow,

    Q = min over θ of  n Σ_k mean((T y)_k − X_k θ)² / σ_k² + (θ − θ̂)ᵀ A (θ − θ̂),

in samples n that count as independent, over n and the number of channels. σ_k follows the size of
T y, so that nothing is gained by making it small.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from deltaid.check.sensing.sheet import Normal, Sheet, Signal, Values
from deltaid.recording.time.resampling import interpolate

# Samples that count as independent.
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
    """Fit of one map: misfit Q, θ, and values of additional columns with standard deviations."""

    Q: float
    theta: Float[np.ndarray, " theta"]
    added: Float[np.ndarray, " added"]
    std: Float[np.ndarray, " added"]


@dataclass(frozen=True, eq=False)
class Misfit:
    """One sensor's rows as products, so that a map costs no sample.

    Attributes:
        signal: of the columns X; shown: of the data y, the same unless exchanged.
    """

    sheet: Sheet
    signal: Signal
    shown: Signal

    @cached_property
    def counts(self) -> float:
        return float(self.shown.counts.sum())

    @cached_property
    def moving(self) -> Values:
        """y without its mean where it counts."""
        mean = self.shown.y.sum(axis=1) / max(self.counts, 1e-300)
        return self.shown.y - mean[:, None] * self.shown.counts

    @cached_property
    def white(self) -> Float[np.ndarray, " channels"]:
        """Noise from row to row, as second differences show it [N, N m]."""
        second = np.diff(self.shown.raw, 2, axis=1)
        counts = np.isfinite(second)
        power = np.where(counts, second, 0.0) ** 2
        return np.sqrt(power.sum(axis=1) / np.maximum(counts.sum(axis=1), 1) / 6)

    @cached_property
    def noise(self) -> Float[np.ndarray, " channels"]:
        """As stated [N, N m]."""
        return np.array([channel.noise for channel in self.signal.rows.channels])

    @cached_property
    def groups(self) -> list[list[int]]:
        """Channels that measure the same: forces, and moments."""
        units = [channel.unit for channel in self.signal.rows.channels]
        return [[k for k, unit in enumerate(units) if unit == kind] for kind in sorted(set(units))]

    @cached_property
    def _known(self) -> Normal:
        return self.sheet.known(self.signal)

    @cached_property
    def by_torques(self) -> Float[np.ndarray, " theta"]:
        return np.linalg.solve(*self._known)

    @cached_property
    def _products(self) -> tuple[np.ndarray, np.ndarray]:
        return self._mean("kin,kjn->kij", self.signal.X, self.signal.X), self._mean(
            "kin,jn->kij", self.signal.X, self.shown.y
        )

    @cached_property
    def _scatter(self) -> tuple[np.ndarray, np.ndarray]:
        """Second moments of y, and of its motion."""
        n, y = max(self.counts, 1.0), self.shown.y
        return y @ y.T / n, self.moving @ self.moving.T / n

    @cached_property
    def _level(self) -> Float[np.ndarray, " channels"]:
        """What it should show in the mean, but for its own offsets."""
        theta = self.by_torques.copy()
        theta[len(theta) - len(self.signal.rows.parameters) :] = 0.0
        return self.expected(theta).sum(axis=1) / max(self.counts, 1.0)

    def _mean(self, indices: str, *operands: np.ndarray) -> np.ndarray:
        return np.einsum(indices, *operands, optimize=True) / max(self.counts, 1.0)

    def _sigma(self, T: Map) -> Float[np.ndarray, " channels"]:
        """Admissible residual of each channel."""
        motion = np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", T, self._scatter[1], T), 0.0))
        group_motion = np.empty_like(motion)
        for group in self.groups:
            group_motion[group] = np.sqrt(np.mean(motion[group] ** 2))
        white = np.minimum(np.abs(T), 1.0) @ self.white
        of_model = _OF_CHANNEL * motion, _OF_GROUP * group_motion, _OF_MEAN * self._level
        return np.sqrt(np.sum(np.square((*of_model, self.noise, white)), axis=0))

    def of(
        self,
        T: Map,
        only: list[int] | None = None,
        beside: Float[np.ndarray, "channels added samples"] | None = None,
        spread: float = 1.0,
    ) -> MapFit:
        """Judge one map.

        Args:
            only: channels to judge; default all.
            beside: additional columns.
            spread: standard deviation of their coefficients.
        """
        (G, g), (XX, Xy), added = self._known, self._products, 0
        constant = g @ self.by_torques
        if beside is not None:
            added = beside.shape[1]
            G, g = block_diag(G, np.eye(added) / spread**2), np.append(g, np.zeros(added))
            cross = self._mean("kin,kan->kia", self.signal.X, beside)
            own = self._mean("kan,kbn->kab", beside, beside)
            XX = np.block([[XX, cross], [cross.swapaxes(1, 2), own]])
            Ey = self._mean("kan,jn->kaj", beside, self.shown.y)
            Xy = np.concatenate([Xy, Ey], axis=1)
        kept = list(range(len(T))) if only is None else only
        T, weights = T[kept], _COUNTED / self._sigma(T)[kept] ** 2
        A = G + np.einsum("k,kij->ij", weights, XX[kept])
        b = g + weights @ np.einsum("kij,kj->ki", Xy[kept], T)
        constant += weights @ np.einsum("ki,ij,kj->k", T, self._scatter[0], T)
        of_added = np.eye(len(b))[:, len(b) - added :]
        solved = np.linalg.solve(A, np.column_stack([b, of_added]))
        solution = solved[:, 0]
        Q = max(float(constant - b @ solution), 0.0) / (_COUNTED * len(kept))
        size = len(solution) - added
        variance = np.diag(solved[size:, 1:])
        return MapFit(Q, solution[:size], solution[size:], np.sqrt(variance * max(Q, 1e-6)))

    def expected(self, theta: Float[np.ndarray, " theta"]) -> Values:
        return np.einsum("kin,i->kn", self.signal.X, theta)

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
        expected, counts = self.expected(self.by_torques), self.shown.counts
        mean = expected.sum(axis=1) / self.counts
        expected = (expected - mean[:, None] * counts) / self.noise[:, None]
        y = self.moving / self.noise[:, None]
        size = np.sqrt(np.sum(expected**2) * np.sum(y**2))
        return float(abs(np.sum(expected * y)) / max(size, 1e-300))

    def stretches(self) -> Iterator[slice]:
        """Stretches without a gap that are long enough to determine a delay."""
        ends = [*self.sheet.starts[1:].tolist(), self.shown.y.shape[1]]
        for first, last in zip(self.sheet.starts.tolist(), ends, strict=True):
            if last - first >= _SHORT:
                yield slice(first, last)

    def earlier(self, delay: float) -> "Misfit":
        """The same with the signal shifted earlier [s]."""
        y = self.shown.y.copy()
        for part in self.stretches() if delay else ():
            values = self.shown.y[:, part].T
            time = np.arange(len(values)) * self.sheet.period
            y[:, part] = interpolate(time, values, np.clip(time + delay, time[0], time[-1])).T
        return replace(self, shown=replace(self.shown, y=y)) if delay else self


@dataclass(frozen=True)
class Lag:
    """A sensor's delay against the motion, its standard deviation [s], and the misfit without."""

    delay: float
    std: float
    Q: float


def lag_of(misfit: Misfit, unshifted: MapFit) -> Lag | None:
    """The delay of a sensor, y(t) = ŷ(t − δ), by Gauss–Newton steps jointly with θ."""
    if np.ptp(misfit.shown.counts) > 1e-6:  # with holes there is no shifting
        return None
    T, fit, delay, std = np.eye(len(misfit.noise)), unshifted, 0.0, np.inf
    for _ in range(_ROUNDS):
        expected = misfit.expected(fit.theta)
        slope = np.zeros_like(expected)
        for part in misfit.stretches():
            slope[:, part] = -np.gradient(expected[:, part], misfit.sheet.period, axis=1)
        fit = misfit.earlier(delay).of(T, beside=slope[:, None, :], spread=_DELAY)
        step, std = float(fit.added[0]), float(fit.std[0])
        delay += step
        if abs(step) < 0.1 * std:
            break
    return Lag(delay, std, misfit.earlier(delay).of(T).Q)
