"""Vectors and rotations along a motion, as chains of elementary turns with angular velocity.

Each turn adds only its own rate to the angular velocity, so what is zero by geometry is zero by
structure: regressor columns of parameters without effect stay empty. Angles are given by cosine and
sine, which follow from vectors without an arctangent.
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Path:
    """A point, a vector or a length with its first two time derivatives."""

    at: ca.SX
    rate: ca.SX
    acceleration: ca.SX

    def __getitem__(self, k: int) -> "Path":
        return Path(self.at[k], self.rate[k], self.acceleration[k])

    def shifted(self, by: Float[np.ndarray, " 3"]) -> "Path":
        """The point at a constant offset from this one."""
        return replace(self, at=self.at + fixed(by))

    @classmethod
    def still(cls, at: ca.SX) -> "Path":
        """A constant, with zero derivatives."""
        none = ca.SX(*at.shape)
        return cls(at, none, none)


def along(value: ca.SX, z: Path) -> Path:
    """A function of z with its time derivatives along a motion of z."""
    rate = ca.jtimes(value, z.at, z.rate)
    bias = ca.jtimes(rate, z.at, z.rate)
    return Path(value, rate, ca.jtimes(value, z.at, z.acceleration) + bias)


@dataclass(frozen=True)
class Turn:
    """A turn about one axis of the frame.

    Attributes:
        axis: "x", "y" or "z".
        cos, sin: of its angle.
        rate, acceleration: of its angle [rad/s, rad/s²].
    """

    axis: str
    cos: ca.SX
    sin: ca.SX
    rate: ca.SX
    acceleration: ca.SX


@dataclass(frozen=True)
class Rotation:
    """A rotation R = R_LB with angular velocity ω and acceleration ω̇, resolved in B."""

    R: ca.SX
    w: ca.SX
    alpha: ca.SX


def rotation(*turns: Turn) -> Rotation:
    """Successive turns, each about an axis e of the frame after the previous ones.

    With E the matrix of a turn by ϑ, ω ← Eᵀω + e ϑ̇ and ω̇ ← Eᵀω̇ + e ϑ̈ + (Eᵀω) × e ϑ̇.
    """
    R, w, alpha = ca.SX.eye(3), ca.SX(3, 1), ca.SX(3, 1)
    for turn in turns:
        k = "xyz".index(turn.axis)
        i, j = (k + 1) % 3, (k + 2) % 3
        e, E = ca.SX(ca.sparsify(ca.DM(np.eye(3)[k]))), ca.SX(3, 3)
        E[k, k], E[i, i], E[j, j] = 1, turn.cos, turn.cos
        E[i, j], E[j, i] = -turn.sin, turn.sin
        spin, carried = e * turn.rate, E.T @ w
        R, w = R @ E, carried + spin
        alpha = E.T @ alpha + e * turn.acceleration + skew(carried) @ spin
    return Rotation(R, w, alpha)


def pointing(axes: str, v: Path, length: Path) -> tuple[Turn, Turn]:
    """The two turns of a universal joint that point the third axis of a frame along a vector.

    With "yz", turns by β about y and γ about z point x along v; "xy" points z in the same way:

        v = ℓ (cos β cos γ, sin γ, −sin β cos γ),   −90° < γ < 90°.

    Args:
        axes: of both turns.
        v: the vector.
        length: its length ℓ.
    """
    j, k = ("xyz".index(axis) for axis in axes)
    x, y, z = v[3 - j - k], v[j], v[k]
    squared = x.at**2 + z.at**2  # (ℓ cos γ)²
    radius = ca.sqrt(squared)
    inverse, shorter = radius / squared, reciprocal(length.at)
    c_b, s_b = x.at * inverse, -z.at * inverse
    c_g, s_g = radius * shorter, y.at * shorter
    b_rate = -(s_b * x.rate + c_b * z.rate) * inverse
    g_rate = (y.rate - s_g * length.rate) * inverse
    outwards = c_b * x.rate - s_b * z.rate  # rate of the radius
    turned = s_b * x.acceleration + c_b * z.acceleration + 2 * b_rate * outwards
    lifted = y.acceleration - s_g * length.acceleration - 2 * c_g * length.rate * g_rate
    first = Turn(axes[0], c_b, s_b, b_rate, -turned * inverse)
    return first, Turn(axes[1], c_g, s_g, g_rate, (lifted + y.at * g_rate**2) * inverse)


def fixed(A: Float[np.ndarray, "..."]) -> ca.SX:
    """Constants with exact zeros where only rounding differs from zero, so that no graph computes
    them."""
    A = np.asarray(A, dtype=float)
    return ca.SX(ca.sparsify(ca.DM(np.where(np.abs(A) < 1e-15, 0.0, A))))


def skew(v: ca.SX) -> ca.SX:
    """[v]ₓ without entries for the components of v that are zero by construction."""
    return ca.sparsify(ca.skew(v))


def reciprocal(x: ca.SX) -> ca.SX:
    """1 / x as x / x², because CasADi turns each product with 1 / x into a division; NaN at 0."""
    return x / (x * x)


def inverse(A: ca.SX) -> ca.SX:
    """Inverse of a small square matrix by cofactors; decoupled rows and columns cost nothing.

    Infinite where A is singular.
    """
    return ca.inv_minor(A)
