"""Inertia of one body about the points that other programs ask for, and whether it can exist.

The package keeps the ten parameters (4) about the origin of the link frame. MuJoCo, URDF and most
CAD programs want the tensor about the centre of mass c, by Steiner's rule

    Θ_C = Θ_B − m (c·c I − c cᵀ),

in axes parallel to the link frame. Entries off the diagonal carry the minus sign everywhere.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.robot.inertia import why_inconsistent


@dataclass(frozen=True)
class BodyInertia:
    """One body's inertia in its link frame's axes.

    Attributes:
        mass: [kg].
        com: centre of mass from the link frame's origin [m].
        about_link: tensor about the link frame's origin [kg m²].
        about_com: tensor about the centre of mass [kg m²].
    """

    mass: float
    com: Float[np.ndarray, " 3"]
    about_link: Float[np.ndarray, "3 3"]
    about_com: Float[np.ndarray, "3 3"]


def body_inertia(p: Float[np.ndarray, " 10"]) -> BodyInertia:
    """From the ten parameters about the link frame."""
    m, c = float(p[0]), p[1:4] / p[0]
    xx, yy, zz, xy, yz, xz = p[4:]
    about_link = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    about_com = about_link - m * (c @ c * np.eye(3) - np.outer(c, c))
    return BodyInertia(m, c, about_link, about_com)


def why_not_physical(p: Float[np.ndarray, " 10"]) -> str:
    """Why no body has these parameters; empty for one that can exist.

    Beside the pseudo-inertia matrix (12) the tensor about the centre of mass is looked at, as the
    program that reads it will: positive definite, principal moments within the triangle inequality.
    """
    if not np.all(np.isfinite(p)):
        return "its parameters are not all finite"
    reason = why_inconsistent(p)
    if reason:
        return reason
    a, b, c = np.linalg.eigvalsh(body_inertia(p).about_com)
    if a > 0 and a + b > c:
        return ""
    return (
        f"its principal moments of inertia about the centre of mass, {a:.4g}, {b:.4g}, {c:.4g} "
        "kg m², are lost in rounding"
    )
