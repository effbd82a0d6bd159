"""The telescope bar (Cardan axle) from base to platform, which turns the tool by ψ."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.mechanism.vectors import frame, rotation_z, unit
from deltaid.robot.telescope import Telescope


@dataclass(frozen=True)
class TelescopeBar:
    """The telescope bar as functions of r and ψ: both parts' poses, end effector, length [m]."""

    R_WT: ca.SX
    r_WTU: ca.SX
    r_WTL: ca.SX
    R_WE: ca.SX
    length: ca.SX


def build_telescope(r: ca.SX, psi: ca.SX, bar: Telescope) -> TelescopeBar:
    """Poses of the telescope bar; ψ turns the fork of its base joint about world z.

    The bar's z axis points from platform to base. The cross of the base joint turns about the
    fork's x axis and the bar about the cross's y axis, so y is perpendicular to both.
    """
    r_WTU, r_WTL = ca.SX(np.array(bar.base_joint)), r + np.array(bar.platform_joint)
    span = r_WTU - r_WTL
    R_WE = rotation_z(psi)
    z_T = unit(span)
    y_T = unit(ca.cross(z_T, R_WE[:, 0]))
    return TelescopeBar(
        R_WT=frame(ca.cross(y_T, z_T), y_T, z_T),
        r_WTU=r_WTU,
        r_WTL=r_WTL,
        R_WE=R_WE,
        length=ca.sqrt(ca.sumsqr(span)),
    )
