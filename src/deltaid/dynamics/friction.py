"""Friction terms as regressor columns: how much of each term's coefficient a joint feels.

The generalised forces of a term are its coefficient times h(v) ∂ϑ̇/∂q̇ with the joint's speed
v = ϑ̇ (eqs. (6) and (7) for viscous and Coulomb friction).
"""

from collections.abc import Callable

import casadi as ca

from deltaid.robot.friction import FrictionTerm

# Speeds below this [rad/s, m/s] count as rest: it keeps powers of |v| differentiable there.
_REST = 1e-9

Sign = Callable[[ca.SX], ca.SX]


def term_factor(term: FrictionTerm, v: ca.SX, sign: Sign, load: ca.SX) -> ca.SX:
    """h(v) of one term; `sign` may be smooth, `load` is the drive's own torque τ."""
    s = sign(v)
    if term.kind == "viscous":
        return 0.5 * (1 + s) * v if term.one_sided else v
    if term.kind == "coulomb":
        return 0.5 * (s + s * s) if term.one_sided else s
    if term.kind == "viscous_back":
        return 0.5 * (1 - s) * v
    if term.kind == "coulomb_back":
        return 0.5 * (s - s * s)
    if term.kind == "offset":
        return ca.SX(1)
    if term.kind == "load":
        return s * ca.fabs(load)
    size = ca.sqrt(v * v + _REST**2)
    if term.kind == "power":
        return s * size**term.exponent
    return s * ca.exp(-((size / term.speed) ** term.exponent))
