"""Newton's and Euler's laws of one rigid body; all of a robot's dynamics comes from `wrench`.

Everything is linear in the body's ten parameters and, for given ω, in accelerations; so the very
function that gives the forces of a motion gives mass matrix, Coriolis matrix and gravity when it is
handed partial velocities, their rates, and −g in place of accelerations.
"""

from dataclasses import dataclass

import casadi as ca

from deltaid.mechanism.mechanism import MovingBody
from deltaid.mechanism.rotation import skew


@dataclass(frozen=True)
class Wrench:
    """What a motion takes from a body's joints; one column for each column of accelerations.

    Attributes:
        push: m a, in the body's inertial frame L [N].
        swing: what the rotation adds to it, in the link frame B [N].
        moment: about the origin of B, in B [N m].
    """

    push: ca.SX
    swing: ca.SX
    moment: ca.SX


def wrench(
    R: ca.SX, p: ca.SX, a: ca.SX, alpha: ca.SX, w: ca.SX, spin: ca.SX | None = None
) -> Wrench:
    """Force and moment about the origin of a link frame B,

        push   = m a,   swing = ω̇ × mc + ω × (ω × mc),
        moment = mc × Rᵀa + Θ ω̇ + ω × Θ ω.

    With `spin` in place of the second ω, both are bilinear in the two such that partial velocities
    and their rates give the Coriolis matrix of Christoffel symbols: with Σ = ½ tr(Θ) − Θ,

        swing  = ω̇ × mc + ω × (spin × mc),   moment = mc × Rᵀa + Θ ω̇ + Σω × spin.

    Args:
        R: from B to L.
        p: the body's ten parameters.
        a: acceleration of the origin less gravity, in L; 3 × n.
        alpha: ω̇ in B; 3 × n.
        w: ω in B.
        spin: 3 × n.
    """
    mc, Theta, W = p[1:4], inertia_tensor(p), skew(w)
    second = w if spin is None else spin
    swing = -skew(mc) @ alpha - W @ (skew(mc) @ second)
    moment = skew(mc) @ (R.T @ a) + Theta @ alpha - skew(Theta @ w) @ second
    if spin is not None:
        moment += 0.5 * ca.trace(Theta) * (W @ spin)
    return Wrench(p[0] * a, swing, moment)


def potential(body: MovingBody, p: ca.SX, gravity: ca.SX) -> ca.SX:
    """Potential energy −gᵀ (m r + R mc) in gravity, which is given in L [J]."""
    return -ca.dot(gravity, p[0] * body.origin.at + body.rotation.R @ p[1:4])


def inertia_tensor(p: ca.SX) -> ca.SX:
    """Θ of the ten parameters."""
    return ca.vertcat(
        ca.horzcat(p[4], p[7], p[9]), ca.horzcat(p[7], p[5], p[8]), ca.horzcat(p[9], p[8], p[6])
    )
