"""How badly a map of what a sensor shows goes with what torques and prior say of the robot.

With T y in the place of y, and σ what a sensor's noise and a model's errors may leave,

    Q = min over θ of  n Σ_k mean((T y)_k − X_k θ)² / σ_k² + (θ − θ̂)ᵀ A (θ − θ̂),

in samples n that count as independent, over n and the number of channels. σ_k follows the size of
T y, so that nothing is gained by making it small.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.check.sensing.sheet import Sensed, Sheet

# Samples that count as independent.
_COUNTED = 200.0
# What a good model errs by: as shares of a channel's motion, of that of all like it, of its level.
_OF_CHANNEL, _OF_GROUP, _OF_MEAN = 0.08, 0.02, 0.005

Map = Float[np.ndarray, "channels channels"]


@dataclass(frozen=True, eq=False)
class Found:
    """One map judged.

    Attributes:
        Q: its misfit.
        theta: θ with it.
        added: of the columns beside θ.
        std: of these, from what is left.
    """

    Q: float
    theta: Float[np.ndarray, " theta"]
    added: Float[np.ndarray, " added"]
    std: Float[np.ndarray, " added"]


@dataclass(frozen=True, eq=False)
class Misfit:
    """One sensor's rows as products, so that a map costs no sample.

    Attributes:
        sheet: of the recording.
        sensor: whose columns X are.
        channels: rows of the sheet that are shown; its own where nothing is exchanged.
    """

    sheet: Sheet
    sensor: Sensed
    channels: slice

    @cached_property
    def columns(self) -> Float[np.ndarray, "channels theta samples"]:
        """Columns of what it should show."""
        return self.sheet.X[self.sensor.channels]

    @cached_property
    def y(self) -> Float[np.ndarray, "channels samples"]:
        """What it shows."""
        return self.sheet.y[self.channels]

    @cached_property
    def told(self) -> Float[np.ndarray, " samples"]:
        """How far samples count."""
        return self.sheet.told[self.channels][0]

    @cached_property
    def mean(self) -> Float[np.ndarray, " channels"]:
        """Of y where it counts."""
        return self.y.sum(axis=1) / max(float(self.told.sum()), 1e-300)

    @cached_property
    def moving(self) -> Float[np.ndarray, "channels samples"]:
        """y without its mean."""
        return self.y - self.mean[:, None] * self.told

    @cached_property
    def white(self) -> Float[np.ndarray, " channels"]:
        """Noise from row to row, as second differences show it [N, N m]."""
        second = np.diff(self.sheet.raw[self.channels], 2, axis=1)
        counts = np.isfinite(second)
        power = np.where(counts, second, 0.0) ** 2
        return np.sqrt(power.sum(axis=1) / np.maximum(counts.sum(axis=1), 1) / 6)

    @cached_property
    def noise(self) -> Float[np.ndarray, " channels"]:
        """As stated [N, N m]."""
        return np.array([one.noise for one in self.sensor.rows.channels])

    @cached_property
    def groups(self) -> list[list[int]]:
        """Channels that measure the same: forces, and moments."""
        units = [one.unit for one in self.sensor.rows.channels]
        return [[k for k, unit in enumerate(units) if unit == kind] for kind in sorted(set(units))]

    @cached_property
    def _products(self) -> tuple[np.ndarray, np.ndarray]:
        n = max(float(self.told.sum()), 1.0)
        return (
            np.einsum("kin,kjn->kij", self.columns, self.columns, optimize=True) / n,
            np.einsum("kin,jn->kij", self.columns, self.y, optimize=True) / n,
        )

    @cached_property
    def _scatter(self) -> tuple[np.ndarray, np.ndarray]:
        """Second moments of y, and of its motion."""
        n = max(float(self.told.sum()), 1.0)
        return self.y @ self.y.T / n, self.moving @ self.moving.T / n

    @cached_property
    def _level(self) -> Float[np.ndarray, " channels"]:
        """What it should show in the mean, but for its own offsets."""
        G, g = self.sheet.of_torques
        own = len(self.sheet.dynamics.layout.parameters)
        theta = np.linalg.solve(G, g)
        theta[own:] = 0.0
        return self.expected(theta).sum(axis=1) / max(float(self.told.sum()), 1.0)

    def sigma(self, T: Map) -> Float[np.ndarray, " channels"]:
        """What may be left of each channel."""
        motion = np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", T, self._scatter[1], T), 0.0))
        alike = np.empty_like(motion)
        for group in self.groups:
            alike[group] = np.sqrt(np.mean(motion[group] ** 2))
        parts = (
            _OF_CHANNEL * motion,
            _OF_GROUP * alike,
            _OF_MEAN * self._level,
            self.noise,
            np.minimum(np.abs(T), 1.0) @ self.white,
        )
        return np.sqrt(np.sum(np.square(parts), axis=0))

    def of(
        self,
        T: Map,
        only: list[int] | None = None,
        beside: Float[np.ndarray, "channels added samples"] | None = None,
        spread: float = 1.0,
    ) -> Found:
        """Judge one map.

        Args:
            only: channels that are looked at; all if left out.
            beside: further columns, and the standard deviation of what belongs to them.
        """
        G, g = self.sheet.of_torques
        kept = list(range(len(T))) if only is None else only
        weights = _COUNTED / self.sigma(T)[kept] ** 2
        XX, Xy = (part[kept] for part in self._products)
        mapped = np.einsum("kij,kj->ki", Xy, T[kept])
        A = G + np.einsum("k,kij->ij", weights, XX)
        b = g + weights @ mapped
        square = np.einsum("ki,ij,kj->k", T[kept], self._scatter[0], T[kept])
        constant = weights @ square + g @ np.linalg.solve(G, g)
        added = 0
        if beside is not None:
            added, n = beside.shape[1], max(float(self.told.sum()), 1.0)
            E, Ty = beside[kept], T[kept] @ self.y
            cross = np.einsum("k,kin,kan->ia", weights, self.columns[kept], E, optimize=True) / n
            own = np.einsum("k,kan,kbn->ab", weights, E, E) / n + np.eye(added) / spread**2
            A = np.block([[A, cross], [cross.T, own]])
            b = np.append(b, np.einsum("k,kan,kn->a", weights, E, Ty) / n)
        x = np.linalg.solve(A, b)
        Q = max(float(constant - b @ x), 0.0) / (_COUNTED * len(kept))
        std = np.zeros(0)
        if added:
            std = np.sqrt(np.diag(np.linalg.inv(A))[-added:] * max(Q, 1e-6))
        size = len(x) - added
        return Found(Q, x[:size], x[size:], std)

    def expected(self, theta: Float[np.ndarray, " theta"]) -> Float[np.ndarray, "channels samples"]:
        """What it should show."""
        return np.einsum("kin,i->kn", self.columns, theta)

    def unexplained(self, found: Found) -> float:
        """The share of y's motion that is left by a robot with these torques, at most 1."""
        rest = self.left(np.eye(len(self.noise)), found) ** 2
        motion = np.mean(self.moving**2, axis=1)
        shares = [rest[group].sum() / max(motion[group].sum(), 1e-300) for group in self.groups]
        return min(1.0, float(np.sqrt(max(shares))))

    def left(self, T: Map, found: Found) -> Float[np.ndarray, " channels"]:
        """Root mean square of what is left of each channel, in its own unit."""
        n = max(float(self.told.sum()), 1.0)
        rest = T @ self.y - self.expected(found.theta)
        return np.sqrt(np.sum(rest**2, axis=1) / n)
