"""Where an articulated platform carries its tool."""

import numpy as np
import pytest
from pydantic import ValidationError

from deltaid.mechanism.kinematics import Kinematics
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot


def with_tool(name: str, **platform: object) -> RobotDescription:
    data = load_robot(name).model_dump(exclude_none=True)
    data["platform"] |= platform
    return RobotDescription.model_validate(data)


@pytest.mark.parametrize("name", ["h4", "i4", "par4", "par4-linear"])
@pytest.mark.parametrize(("part", "place"), [("first", 0), ("second", 1)])
def test_a_tool_on_a_part_moves_with_it_and_turns_by_psi(name, part, place):
    offset = np.array([0.03, -0.02, -0.05])
    robot = with_tool(name, tool_on=part, tool=tuple(offset))
    kinematics, rng = Kinematics(robot), np.random.default_rng(0)
    z = kinematics.home + rng.uniform(-1, 1, (20, 4)) * [0.05, 0.05, 0.03, 0.5]
    poses = kinematics.poses(z)
    parts = [pose for pose in poses if pose.name == robot.platform.bodies[0]]
    tool = next(pose for pose in poses if pose.name == "EE")
    np.testing.assert_allclose(tool.r_WB, parts[place].r_WB + offset, atol=1e-15)
    np.testing.assert_allclose(tool.R_WB[:, 0, 0], np.cos(z[:, 3]), atol=1e-15)


def test_nothing_carries_a_tool_beside_the_middle_bar():
    with pytest.raises(ValidationError, match="tool_on"):
        with_tool("h4", tool=(0.03, 0, 0))
