"""Ten inertia parameters of a rigid body, and its 4×4 pseudo-inertia matrix.

A body's parameters are ordered as in eq. (4) of the paper,

    p = [m, mc_x, mc_y, mc_z, Θ_xx, Θ_yy, Θ_zz, Θ_xy, Θ_yz, Θ_xz],

with the first moment mc and the inertia tensor Θ about the origin of the link frame, in the axes
of the link frame. Their units are kg, kg m and kg m². Θ_xy is the *entry* of the tensor (5), that
is −∫xy dm. The pseudo-inertia matrix (12) is

    M̄ = [[Σ, mc], [mcᵀ, m]],   Σ = ½ tr(Θ) I − Θ = ∫ r rᵀ dm,

and the body exists physically if and only if M̄ is positive definite.

MuJoCo, URDF and most CAD programs need the tensor about the centre of mass c in axes parallel to
the link frame, by Steiner's rule

    Θ_C = Θ − m (c·c I − c cᵀ).

Its off-diagonal entries have the minus sign, too.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

InertiaName = Literal["m", "mcx", "mcy", "mcz", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz"]
INERTIA_NAMES: tuple[InertiaName, ...] = get_args(InertiaName)
INERTIA_UNITS = ("kg",) + ("kg m",) * 3 + ("kg m²",) * 6
MOMENTS_OF_INERTIA = INERTIA_NAMES[4:7]
# Parameters of a body that are positive: mass and moments of inertia.
POSITIVE_NAMES = (INERTIA_NAMES[0], *MOMENTS_OF_INERTIA)

# Independent entries of M̄ and their indices: x, y, z are rows 0–2, the mass is row 3.
PSEUDO_INERTIA_ENTRIES = {
    "m": (3, 3),
    "mcx": (0, 3),
    "mcy": (1, 3),
    "mcz": (2, 3),
    "Sxx": (0, 0),
    "Syy": (1, 1),
    "Szz": (2, 2),
    "Sxy": (0, 1),
    "Syz": (1, 2),
    "Sxz": (0, 2),
}

# Indices of an entry of Σ, and the index in p of the same entry of Θ.
_SECOND_MOMENTS = (((0, 0), 4), ((1, 1), 5), ((2, 2), 6), ((0, 1), 7), ((1, 2), 8), ((0, 2), 9))


def pseudo_inertia(p: Float[np.ndarray, "*batch 10"]) -> Float[np.ndarray, "*batch 4 4"]:
    """Pseudo-inertia matrix M̄(p), eq. (12)."""
    p = np.asarray(p, dtype=float)
    M = np.zeros((*p.shape[:-1], 4, 4))
    half_trace = 0.5 * (p[..., 4] + p[..., 5] + p[..., 6])
    for (i, j), k in _SECOND_MOMENTS:
        M[..., i, j] = M[..., j, i] = (half_trace if i == j else 0.0) - p[..., k]
    M[..., :3, 3] = M[..., 3, :3] = p[..., 1:4]
    M[..., 3, 3] = p[..., 0]
    return M


def inertia_parameters(M: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 10"]:
    """Inverse of `pseudo_inertia`: p with Θ = tr(Σ) I − Σ."""
    M = np.asarray(M, dtype=float)
    p = np.empty((*M.shape[:-2], 10))
    trace = M[..., 0, 0] + M[..., 1, 1] + M[..., 2, 2]
    p[..., 0] = M[..., 3, 3]
    p[..., 1:4] = M[..., :3, 3]
    for (i, j), k in _SECOND_MOMENTS:
        p[..., k] = (trace if i == j else 0.0) - M[..., i, j]
    return p


def entry_map() -> Float[np.ndarray, "10 10"]:
    """Matrix that maps the entries of M̄, in the order of PSEUDO_INERTIA_ENTRIES, to p."""
    k, (i, j) = np.arange(10), np.transpose(list(PSEUDO_INERTIA_ENTRIES.values()))
    units = np.zeros((10, 4, 4))
    units[k, i, j] = units[k, j, i] = 1.0
    return inertia_parameters(units).T.copy()


def consistency(p: Float[np.ndarray, "*batch 10"]) -> Float[np.ndarray, "*batch"]:
    """Distance of a body from the boundary of physical consistency, without unit.

    It is the smallest eigenvalue of M̄ after scaling rows and columns to a unit diagonal: positive
    if and only if the body is consistent, 1 if its centre of mass is at the origin and its
    principal axes are along the frame, −∞ if a diagonal entry is not positive.
    """
    M = pseudo_inertia(p)
    d = np.diagonal(M, axis1=-2, axis2=-1)
    possible = np.all(d > 0, axis=-1)
    s = 1.0 / np.sqrt(np.where(d > 0, d, 1.0))
    scaled = M * s[..., :, None] * s[..., None, :]
    return np.where(possible, np.linalg.eigvalsh(scaled)[..., 0], -np.inf)


Vector = Sequence[float] | Float[np.ndarray, " 3"]


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Rigid body with ten parameters about a link frame's origin; parameters of parts add up.

    Attributes:
        p: m, first moment and inertia tensor in this module's order [kg, kg m, kg m²].
    """

    p: Float[np.ndarray, " 10"]

    @classmethod
    def of_moments(cls, m: float, mc: Vector, Sigma: Float[np.ndarray, "3 3"]) -> "RigidBody":
        """Body with mass m [kg], first moment mc [kg m], second moments Σ = ∫ r rᵀ dm [kg m²]."""
        M = np.empty((4, 4))
        M[:3, :3], M[:3, 3], M[3, :3], M[3, 3] = Sigma, mc, mc, m
        return cls(inertia_parameters(M))

    @classmethod
    def centred(cls, m: float, c: Vector, Sigma_C: Float[np.ndarray, "3 3"]) -> "RigidBody":
        """Body with mass m [kg], centre of mass c [m] and second moments Σ_C about c [kg m²]."""
        c = np.asarray(c)
        return cls.of_moments(m, m * c, Sigma_C + m * np.outer(c, c))

    @classmethod
    def point(cls, m: float, c: Vector) -> "RigidBody":
        """Mass m [kg] at a point c [m]."""
        return cls.centred(m, c, np.zeros((3, 3)))

    def transformed(self, T: Float[np.ndarray, "4 4"]) -> "RigidBody":
        """Body whose points (r, 1) are mapped to T (r, 1), so M̄ becomes T M̄ Tᵀ."""
        return RigidBody(inertia_parameters(T @ pseudo_inertia(self.p) @ T.T))

    def without(self, entries: Collection[str]) -> "RigidBody":
        """Body with these entries of M̄ (`PSEUDO_INERTIA_ENTRIES`) set to zero."""
        M = pseudo_inertia(self.p)
        for name in entries:
            i, j = PSEUDO_INERTIA_ENTRIES[name]
            M[i, j] = M[j, i] = 0.0
        return RigidBody(inertia_parameters(M))

    def moved(self, R: Float[np.ndarray, "3 3"], d: Float[np.ndarray, " 3"]) -> "RigidBody":
        """Body in a frame in which its link frame is rotated by R and shifted by d [m]."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, d
        return self.transformed(T)

    @property
    def mass(self) -> float:
        """Mass of the body [kg]."""
        return float(self.p[0])

    @property
    def com(self) -> Float[np.ndarray, " 3"]:
        """Centre of mass from the link frame's origin [m]."""
        return self.p[1:4] / self.p[0]

    @property
    def about_link(self) -> Float[np.ndarray, "3 3"]:
        """Inertia tensor Θ about the link frame's origin [kg m²]."""
        xx, yy, zz, xy, yz, xz = self.p[4:]
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def about_com(self) -> Float[np.ndarray, "3 3"]:
        """Inertia tensor about the centre of mass, Θ − m (c·c I − c cᵀ) [kg m²]."""
        c = self.com
        return self.about_link - self.mass * (c @ c * np.eye(3) - np.outer(c, c))

    @property
    def second_moments(self) -> Float[np.ndarray, "3 3"]:
        """Second moments about the centre of mass, Σ_C = Σ − m c cᵀ [kg m²]."""
        return pseudo_inertia(self.p)[:3, :3] - self.p[0] * np.outer(self.com, self.com)

    @property
    def gyration(self) -> float:
        """Radius of gyration about the link frame's origin, ℓ² = tr Σ / m [m]."""
        return float(np.sqrt(max(np.trace(pseudo_inertia(self.p)[:3, :3]), 0.0) / self.p[0]))

    def with_thickness(self) -> "RigidBody":
        """Body with a small thickness added if it has none (plate, line, point), else unchanged.

        Adds m (ℓ/1000)² to the three second moments, with its radius of gyration ℓ (at least 1 mm).
        This changes moments of inertia of size m ℓ² by less than 2e-6 of their values.
        """
        if self.p[0] <= 0 or consistency(self.p) > 1e-6:
            return self
        M = pseudo_inertia(self.p)
        M[:3, :3] += self.p[0] * (1e-3 * max(self.gyration, 1e-3)) ** 2 * np.eye(3)
        return RigidBody(inertia_parameters(M))

    @property
    def why_inconsistent(self) -> str:
        """Physical condition that the body violates, as a sentence; empty if it is consistent."""
        if consistency(self.p) > 0:
            return ""
        if self.p[0] <= 0:
            return f"its mass is {self.p[0]:.4g} kg, which is not positive"
        Sigma_C = self.second_moments
        a, b, c = np.linalg.eigvalsh(np.trace(Sigma_C) * np.eye(3) - Sigma_C)
        if a <= 0:
            return (
                "its inertia about its centre of mass is not positive definite "
                f"(principal moments {a:.4g}, {b:.4g}, {c:.4g} kg m²); "
                "is the inertia given about the centre of mass instead of the link frame?"
            )
        return (
            "its principal moments of inertia about the centre of mass, "
            f"{a:.4g}, {b:.4g}, {c:.4g} kg m², violate the triangle inequality"
        )

    @property
    def why_not_physical(self) -> str:
        """Reason why no body can have these parameters; empty if one can.

        Checks the pseudo-inertia matrix (12), and the tensor about the centre of mass as programs
        that read it do: positive definite, principal moments within the triangle inequality.
        """
        if not np.all(np.isfinite(self.p)):
            return "its parameters are not all finite"
        if reason := self.why_inconsistent:
            return reason
        a, b, c = np.linalg.eigvalsh(self.about_com)
        if a > 0 and a + b > c:
            return ""
        return (
            f"its principal moments of inertia about the centre of mass, {a:.4g}, {b:.4g}, "
            f"{c:.4g} kg m², are lost in rounding"
        )
