"""Whether the limbs of a composed robot close at all where it is meant to work."""

import numpy as np
from jaxtyping import Float

from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import RigidPlatform


def open_limb(robot: RobotDescription) -> str:
    """Why a limb cannot hold the platform in the middle of the workspace; empty if all can.

    A rotary limb reaches from |L − l| to L + l around its motor axis, L and l seen along that axis;
    a linear one as far from its rail as its strut is long.
    """
    if robot.limbs is None:  # a mechanism of the user's own, which is checked when it is built
        return ""
    home = robot.home
    for i, limb in enumerate(robot.limb_geometry):
        held = home[:3] + limb.attachment
        if not isinstance(robot.platform, RigidPlatform):
            sign = 1.0 if robot.platform.on_first(i) else -1.0
            held = held + sign * robot.platform.half(home[3])
        shortest, longest = _fitting(limb, limb.R_WL.T @ (held - limb.base))
        if not shortest < limb.strut < longest:
            side = "at least" if limb.strut <= shortest else "at most"
            bound = shortest if limb.strut <= shortest else longest
            middle = ", ".join(f"{x:.4g}" for x in home[:3])
            return (
                f"limb {i + 1} cannot reach the middle of the workspace, ({middle}) m, with a "
                f"strut of {limb.strut:g} m; it takes {side} {bound:.4g} m"
            )
    return ""


def _fitting(limb: LimbGeometry, p: Float[np.ndarray, " 3"]) -> tuple[float, float]:
    """Shortest and longest strut between the limb's drive and a point p in its frame [m]."""
    if limb.drive == "linear":
        return float(np.linalg.norm(p - (limb.rail @ p) * limb.rail)), np.inf
    rho, lateral, arm = np.hypot(p[0], p[2]), p[1], limb.upper_arm
    return float(np.hypot(lateral, rho - arm)), float(np.hypot(lateral, rho + arm))
