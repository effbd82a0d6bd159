"""The pose z of measured drive coordinates: in closed form, or by Newton steps cycle by cycle."""

from dataclasses import dataclass

import casadi as ca

from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.vectors import inverse

# Newton's steps a cycle; each squares the distance, and a robot moves a few millimetres a cycle.
_STEPS = 2
# Loops that are open by less [m, rad] count as closed; rounding to floats leaves some 1e-6.
_CLOSED = 1e-5


@dataclass(frozen=True)
class Pose:
    """z of one cycle, and whether the loops close there."""

    z: ca.SX
    closed: ca.SX


def pose(mechanism: Mechanism, near: ca.SX, q: ca.SX) -> Pose:
    """z of q.

    Args:
        near: the cycle before's.
    """
    form = mechanism.forward
    if form is not None:
        found = ca.Function("z", [mechanism.q_symbols], [form.z, form.margin, form.modes])
        z, margin, modes = found(q)
        return Pose(z, ca.logic_and(margin > 0, ca.mmin(modes) > 0))
    step = mechanism.z - inverse(ca.jacobian(mechanism.closure, mechanism.z)) @ mechanism.closure
    move = ca.Function("move", [mechanism.z, mechanism.q_symbols], [step])
    check = ca.Function(
        "check", [mechanism.z, mechanism.q_symbols], [mechanism.closure, mechanism.modes]
    )
    z = near
    for _ in range(_STEPS):
        z = move(z, q)
    gap, modes = check(z, q)
    return Pose(z, ca.logic_and(ca.sum1(ca.fabs(gap)) < _CLOSED, ca.mmin(modes) > 0))
