"""Regressor of one rigid body: its generalised forces, linear in its ten parameters."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.mechanism.mechanism import MovingBody


@dataclass(frozen=True)
class BodyMotion:
    """Motion of a link frame B, resolved in B, for task coordinates z.

    Attributes:
        J_v: partial velocities of the frame's origin ∂v/∂ż, 3×δ.
        J_w: partial angular velocities ∂ω/∂ż, 3×δ.
        w: angular velocity ω, 3.
        alpha: angular acceleration ω̇, 3.
        a: acceleration of the origin minus gravity, 3.
    """

    J_v: ca.SX
    J_w: ca.SX
    w: ca.SX
    alpha: ca.SX
    a: ca.SX


def body_motion(
    body: MovingBody,
    z: ca.SX,
    zd: ca.SX,
    zdd: ca.SX,
    gravity: Float[np.ndarray, " 3"],
) -> BodyMotion:
    """Twist, acceleration and partial velocities of a body by differentiating its pose.

    With R = R_LB, the skew matrix RᵀṘ holds ω; r̈ = (∂r/∂z) z̈ + (d/dt ∂r/∂z) ż. Gravity is given
    in the world.
    """
    R, r = body.R_LB, body.r_LB
    J_r = ca.jacobian(r, z)
    J_w = ca.horzcat(*[_vee(R.T @ _partial(R, z, i)) for i in range(z.numel())])
    w = J_w @ zd
    acceleration = J_r @ zdd + ca.jtimes(J_r @ zd, z, zd)
    return BodyMotion(
        J_v=R.T @ J_r,
        J_w=J_w,
        w=w,
        alpha=J_w @ zdd + ca.jtimes(w, z, zd),
        a=R.T @ (acceleration - ca.DM(body.R_WL.T @ gravity)),
    )


def body_regressor(motion: BodyMotion) -> ca.SX:
    """Generalised forces of a body as a δ×10 matrix that multiplies its parameters (4).

    About the origin of B and resolved in B, Newton's and Euler's laws read

        force  = m a + ([ω̇]ₓ + [ω]ₓ²) mc,
        moment = mc × a + Θ ω̇ + ω × Θ ω,

    and the generalised forces are J_vᵀ force + J_wᵀ moment (Jourdain's principle).
    """
    W, A = _skew(motion.w), _skew(motion.alpha)
    of_force = ca.horzcat(motion.a, A + W @ W)
    of_moment = ca.horzcat(
        ca.SX(3, 1), -_skew(motion.a), _times_inertia(motion.alpha) + W @ _times_inertia(motion.w)
    )
    linear = ca.horzcat(of_force, ca.SX(3, 6))
    return motion.J_v.T @ linear + motion.J_w.T @ of_moment


def body_mass_matrix(p: ca.SX, motion: BodyMotion) -> ca.SX:
    """Task-space mass matrix J_vᵀ m J_v + J_vᵀ [mc]ₓᵀ J_w + (…)ᵀ + J_wᵀ Θ J_w of one body."""
    Theta = ca.vertcat(
        ca.horzcat(p[4], p[7], p[9]), ca.horzcat(p[7], p[5], p[8]), ca.horzcat(p[9], p[8], p[6])
    )
    coupling = motion.J_v.T @ _skew(p[1:4]).T @ motion.J_w
    linear = p[0] * motion.J_v.T @ motion.J_v
    return linear + coupling + coupling.T + motion.J_w.T @ Theta @ motion.J_w


def _times_inertia(v: ca.SX) -> ca.SX:
    """The 3×6 matrix L(v) with Θ v = L(v) [Θ_xx Θ_yy Θ_zz Θ_xy Θ_yz Θ_xz]ᵀ."""
    x, y, z = v[0], v[1], v[2]
    return ca.sparsify(
        ca.vertcat(
            ca.horzcat(x, 0, 0, y, 0, z),
            ca.horzcat(0, y, 0, x, z, 0),
            ca.horzcat(0, 0, z, 0, y, x),
        )
    )


def _skew(v: ca.SX) -> ca.SX:
    """[v]ₓ without entries for the components of v that are zero by construction."""
    return ca.sparsify(ca.skew(v))


def _partial(R: ca.SX, z: ca.SX, i: int) -> ca.SX:
    return ca.reshape(ca.jacobian(ca.vec(R), z[i]), 3, 3)


def _vee(W: ca.SX) -> ca.SX:
    """The vector of a matrix that is skew by construction."""
    return ca.sparsify(ca.vertcat(W[2, 1], W[0, 2], W[1, 0]))
