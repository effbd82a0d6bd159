"""Task-space motions as truncated Fourier series, eq. (8)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.mechanism.one_or_many import one_or_many_times
from deltaid.shown import Shown

Coefficients = Float[np.ndarray, "coordinates harmonics"]


@dataclass(frozen=True, repr=False)
class FourierMotion(Shown):
    """z_i(t) = b_i0 + Σ_k [a_ik sin(ω₀ k t) + b_ik cos(ω₀ k t)], eq. (8).

    Attributes:
        base_frequency: ω₀ [rad/s].
        centre: b_i0, in m and rad.
        sine, cosine: a and b, one row a coordinate, one column a harmonic.
    """

    base_frequency: float
    centre: Float[np.ndarray, " coordinates"]
    sine: Coefficients
    cosine: Coefficients

    @property
    def period(self) -> float:
        """2π/ω₀ [s]."""
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
        zdd = -(s * w**2) @ self.sine.T - (c * w**2) @ self.cosine.T
        return z, zd, zdd
