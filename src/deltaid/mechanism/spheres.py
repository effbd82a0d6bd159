"""Forward kinematics in closed form, for three limbs that hold one platform."""

import casadi as ca

from deltaid.mechanism.limb import elbow, mode_margin
from deltaid.robot.limbs import LimbGeometry


def meeting_point(
    q: ca.SX, limbs: tuple[LimbGeometry, ...], *, below: bool
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Platform point from three drive coordinates: the lower or upper point where spheres meet.

    The sphere of limb i has the strut's length as radius and its elbow, moved by the attachment, as
    centre c_i. With a = c_1 − c_0, b = c_2 − c_0, n = a × b, points at distances l_i satisfy
    2 a·x = |a|² + l_0² − l_1² and the same with b, so x = foot ± √margin n/|n|. Returns the point;
    the margin [m²], negative when the spheres do not meet; and each limb's `mode_margin` [m].
    """
    centres = [elbow(q[i], limb) - ca.DM(limb.attachment) for i, limb in enumerate(limbs)]
    a, b = centres[1] - centres[0], centres[2] - centres[0]
    n = ca.cross(a, b)
    n_squared = ca.sumsqr(n)
    squares = [limb.strut**2 for limb in limbs]
    alpha = ca.sumsqr(a) + (squares[0] - squares[1])
    beta = ca.sumsqr(b) + (squares[0] - squares[2])
    foot = (alpha * ca.cross(b, n) + beta * ca.cross(n, a)) / (2 * n_squared)
    margin = squares[0] - ca.sumsqr(foot)
    down = ca.if_else(n[2] > 0, -1.0, 1.0)
    side = down if below else -down
    point = centres[0] + foot + side * ca.sqrt(margin / n_squared) * n
    modes = [mode_margin(q[i], point + ca.DM(l.attachment), l) for i, l in enumerate(limbs)]
    return point, margin, ca.vertcat(*modes)
