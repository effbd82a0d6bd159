"""Task-space motions as truncated Fourier series, eq. (8), and their unknowns as a vector."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError, positive
from deltaid.mechanism.one_or_many import one_or_many_times, real_numbers
from deltaid.shown import Shown

Coefficients = Float[np.ndarray, "coordinates harmonics"]


@dataclass(frozen=True, repr=False)
class FourierMotion(Shown):
    """z_i(t) = b_i0 + Σ_k [a_ik sin(ω₀ k t) + b_ik cos(ω₀ k t)], eq. (8).

    Attributes:
        base_frequency: ω₀ [rad/s].
        centre: b_i0, in m and rad.
        sine, cosine: a and b, one row for each coordinate, one column for each harmonic.
    """

    base_frequency: float
    centre: Float[np.ndarray, " coordinates"]
    sine: Coefficients
    cosine: Coefficients

    def __post_init__(self) -> None:
        centre, sine, cosine = (
            real_numbers(getattr(self, name), name) for name in ("centre", "sine", "cosine")
        )
        for name, array in (("centre", centre), ("sine", sine), ("cosine", cosine)):
            for place in np.argwhere(~np.isfinite(array))[:1].tolist():
                raise DeltaidError(
                    f"is {array[tuple(place)]:g}, not a finite number",
                    where=f"{name}{place}",
                    cure="give finite numbers",
                )
        positive("base_frequency", float(self.base_frequency))
        if sine.ndim != 2 or sine.shape != cosine.shape or centre.shape != sine.shape[:1]:
            raise DeltaidError(
                f"centre, sine and cosine have shapes {centre.shape}, {sine.shape}, {cosine.shape}",
                where="a motion",
                cure="sine and cosine have one row a coordinate of the centre",
            )

    @property
    def period(self) -> float:
        """Duration of a period, 2π/ω₀ [s]."""
        return 2 * np.pi / self.base_frequency

    @one_or_many_times
    def evaluate(
        self, time: Float[np.ndarray, " samples"]
    ) -> tuple[Float[np.ndarray, "samples coordinates"], ...]:
        """z, ż, z̈ at the given times."""
        w = self.base_frequency * np.arange(1, self.sine.shape[1] + 1)
        s, c = np.sin(np.outer(time, w)), np.cos(np.outer(time, w))
        z = self.centre + s @ self.sine.T + c @ self.cosine.T
        zd = (c * w) @ self.sine.T - (s * w) @ self.cosine.T
        return z, zd, -(s * w**2) @ self.sine.T - (c * w**2) @ self.cosine.T


Vector = Float[np.ndarray, " unknowns"]
Basis = Float[np.ndarray, "3 samples terms"]


@dataclass(frozen=True)
class Series:
    """Shape and scaling of the unknowns.

    Attributes:
        harmonics: n_F of (8).
        slowest, fastest: bounds of the base frequency ω₀ [rad/s].
        centre, size: middle and half width of each coordinate's range, the unit of coefficients.
    """

    harmonics: int
    slowest: float
    fastest: float
    centre: Float[np.ndarray, " dof"]
    size: Float[np.ndarray, " dof"]

    @property
    def dof(self) -> int:
        """Number of task coordinates."""
        return len(self.size)

    @property
    def length(self) -> int:
        """Number of unknowns: log ω₀, then centre, sines and cosines of each coordinate."""
        return 1 + self.dof * (1 + 2 * self.harmonics)

    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of the unknowns: those of log ω₀, and ± 3 sizes for coefficients."""
        frequency = (float(np.log(self.slowest)), float(np.log(self.fastest)))
        return [frequency] + [(-3.0, 3.0)] * (self.length - 1)

    def coefficients(self, x: Vector) -> Float[np.ndarray, "dof terms"]:
        """Rows [b_0, a_1 … a_n, b_1 … b_n] of (8) in m and rad, b_0 relative to `centre`."""
        return x[1:].reshape(self.dof, -1) * self.size[:, None]

    def frequency(self, x: Vector) -> float:
        """Base frequency ω₀ [rad/s]."""
        return float(np.exp(x[0]))

    def motion(self, x: Vector) -> FourierMotion:
        """The motion of a vector of unknowns."""
        c, n = self.coefficients(x), self.harmonics
        centre = self.centre + c[:, 0]
        return FourierMotion(self.frequency(x), centre, c[:, 1 : n + 1], c[:, n + 1 :])

    def basis(self, phase: Float[np.ndarray, " samples"]) -> Basis:
        """Φ, Φ′, Φ″: values of [1, sin kφ, cos kφ] and their derivatives with respect to φ."""
        k, one = np.arange(1, self.harmonics + 1), np.ones((len(phase), 1))
        s, c = np.sin(np.outer(phase, k)), np.cos(np.outer(phase, k))
        rows = (one, s, c), (0 * one, c * k, -s * k), (0 * one, -s * k**2, -c * k**2)
        return np.stack([np.hstack(row) for row in rows])

    def state(self, x: Vector, basis: Basis) -> Float[np.ndarray, "inputs samples"]:
        """s = (z, ż, z̈) at the basis' points, samples in columns."""
        c, w = self.coefficients(x), self.frequency(x)
        z = c @ basis[0].T + self.centre[:, None]
        return np.vstack([z, w * (c @ basis[1].T), w**2 * (c @ basis[2].T)])

    def chain(
        self, x: Vector, basis: Basis, gradients: Float[np.ndarray, "functions inputs samples"]
    ) -> Float[np.ndarray, "functions unknowns"]:
        """∂/∂x from ∂/∂s, for several functions at once."""
        c, powers = self.coefficients(x), self.frequency(x) ** np.arange(3)
        by_order = gradients.reshape(len(gradients), 3, self.dof, -1)
        along = np.einsum("o,fods,ost->fodt", powers, by_order, basis, optimize=True)
        d_log_w = np.einsum("o,fodt,dt->f", np.arange(3.0), along, c)
        d_c = along.sum(axis=1) * self.size[:, None]
        return np.column_stack([d_log_w, d_c.reshape(len(gradients), -1)])
