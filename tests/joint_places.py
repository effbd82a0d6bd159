"""Where the joints of a robot are by the oracle, for what is drawn of it."""

import numpy as np

from deltaid.dynamics.parameters import prior_parameters
from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import RigidPlatform
from oracle.composed import ComposedOracle
from plants import oracle_of


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


def prior_oracle(robot: RobotDescription) -> ComposedOracle:
    """The oracle's robot, whose limbs and platform have places."""
    return oracle_of(robot, prior_parameters(robot))


def tool_point(robot: RobotDescription, z: np.ndarray) -> np.ndarray:
    """The origin of the body that carries the tool."""
    if isinstance(robot.platform, RigidPlatform):
        return z[:3]
    first, second = prior_oracle(robot).parts(z)
    carrier = {"middle": z[:3], "first": first, "second": second}[robot.platform.tool_on]
    return carrier + np.array(robot.platform.tool)
