"""Where the joints of a robot are by the numbers of its description, for what is drawn of it."""

import numpy as np

from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import RigidPlatform


def poses(robot: RobotDescription, count: int) -> np.ndarray:
    """Anywhere in the workspace, turned by up to a quarter of a radian."""
    rng, (centre, half) = np.random.default_rng(3), robot.workspace.inner_box
    dof = len(robot.drives)
    z = np.column_stack([centre + half * rng.uniform(-0.7, 0.7, (count, 3)), np.zeros(count)])
    z[:, 3] = rng.uniform(0.1, 0.25, count)
    return z[:, :dof]


def direction(angle: float) -> np.ndarray:
    """Of an angle about world z."""
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def parts_of_platform(robot: RobotDescription, z: np.ndarray) -> list[np.ndarray]:
    """The platform point, or the points of both parts that limbs hold."""
    if isinstance(robot.platform, RigidPlatform):
        return [z[:3]]
    half = robot.platform.half(float(z[3]))
    return [z[:3] + half, z[:3] - half]


def part_of_limb(robot: RobotDescription, limb: int) -> int:
    """Which of them limb 0, 1, … holds."""
    rigid = isinstance(robot.platform, RigidPlatform)
    return 0 if rigid or limb + 1 in robot.platform.first else 1


def elbow(limb: LimbGeometry, q: float) -> np.ndarray:
    """The upper end of a limb's struts, in their middle."""
    x, _, up = limb.R_WL.T
    if limb.drive == "rotary":
        return limb.base + limb.upper_arm * (np.cos(q) * x - np.sin(q) * up)
    return limb.base + q * limb.R_WL @ limb.rail


def tool_point(robot: RobotDescription, z: np.ndarray) -> np.ndarray:
    """The origin of the body that carries the tool."""
    if isinstance(robot.platform, RigidPlatform):
        return z[:3]
    one, other = parts_of_platform(robot, z)
    carrier = {"middle": z[:3], "first": one, "second": other}[robot.platform.tool_on]
    return carrier + np.array(robot.platform.tool)
