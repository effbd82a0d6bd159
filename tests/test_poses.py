"""Poses of all bodies: limbs close, struts, telescope bar and tools hang as they are built."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from pydantic import ValidationError

from deltaid.mechanism.kinematics import Kinematics
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from geometries import GEOMETRIES, kinematics, poses_within_reach, rotation


@pytest.mark.parametrize("name", GEOMETRIES)
class TestPoses:
    def test_rotations_are_proper(self, name: str) -> None:
        k = kinematics(name)
        for body in k.poses(poses_within_reach(k)):
            product = body.R_WB @ body.R_WB.swapaxes(1, 2)
            np.testing.assert_allclose(product, np.tile(np.eye(3), (100, 1, 1)), atol=1e-12)
            np.testing.assert_allclose(np.linalg.det(body.R_WB), 1.0, rtol=1e-12)

    def test_limbs_close(self, name: str) -> None:
        k = kinematics(name)
        limbs, z = k.robot.limbs, poses_within_reach(k)
        bodies = k.poses(z)
        assert [b.name for b in bodies[:7]] == ["U", "S"] * 3 + ["P"]
        np.testing.assert_allclose(bodies[6].r_WB, z[:, :3], rtol=0, atol=0)
        for i, phi in enumerate(np.deg2rad(limbs.azimuth_deg)):
            arm, strut = bodies[2 * i], bodies[2 * i + 1]
            outwards = np.array([np.cos(phi), np.sin(phi), 0])
            elbow = arm.r_WB + limbs.upper_arm * arm.R_WB[:, :, 0]
            tip = strut.r_WB + limbs.strut * strut.R_WB[:, :, 0]
            joint = z[:, :3] + limbs.platform_radius * outwards
            seat = np.tile(limbs.base_radius * outwards, (100, 1))
            np.testing.assert_allclose(arm.r_WB, seat, rtol=0, atol=1e-12)
            np.testing.assert_allclose(elbow, strut.r_WB, rtol=0, atol=1e-12)
            np.testing.assert_allclose(tip, joint, rtol=0, atol=1e-12)

    def test_upper_arm_turns_down_about_its_motor_axis(self, name: str) -> None:
        k = kinematics(name)
        z = poses_within_reach(k, 20)
        for i, phi in enumerate(np.deg2rad(k.robot.limbs.azimuth_deg)):
            for R, angle in zip(k.poses(z)[2 * i].R_WB, k.inverse(z)[:, i], strict=True):
                expected = rotation("z", phi) @ rotation("y", angle)
                np.testing.assert_allclose(R, expected, atol=1e-12)

    def test_strut_hangs_on_a_joint_parallel_to_the_motor_axis(self, name: str) -> None:
        k = kinematics(name)
        bodies = k.poses(poses_within_reach(k))
        for arm, strut in zip(bodies[0:6:2], bodies[1:6:2], strict=True):
            z = np.cross(strut.R_WB[:, :, 0], arm.R_WB[:, :, 1])
            z /= np.linalg.norm(z, axis=1, keepdims=True)
            np.testing.assert_allclose(strut.R_WB[:, :, 2], z, atol=1e-12)


@pytest.mark.parametrize("name", ["telescope", "offset telescope"])
def test_telescope_bar_hangs_between_its_joints(name: str) -> None:
    k = kinematics(name)
    bar, z = k.robot.telescope, poses_within_reach(k)
    upper, lower, effector = k.poses(z)[7:]
    assert (upper.name, lower.name, effector.name) == ("TU", "TL", "EE")
    top, bottom = np.tile(bar.base_joint, (100, 1)), z[:, :3] + bar.platform_joint
    np.testing.assert_allclose(upper.r_WB, top, rtol=0, atol=0)
    np.testing.assert_allclose(lower.r_WB, bottom, rtol=0, atol=1e-15)
    np.testing.assert_allclose(effector.r_WB, z[:, :3], rtol=0, atol=0)
    length = np.linalg.norm(top - bottom, axis=1, keepdims=True)
    np.testing.assert_allclose(upper.R_WB[:, :, 2], (top - bottom) / length, atol=1e-13)
    np.testing.assert_allclose(lower.R_WB, upper.R_WB, rtol=0, atol=0)
    slide = ca.Function("slide", [k.mechanism.z], [k.mechanism.joints["slide"]])
    np.testing.assert_allclose(np.array(slide(z.T)).T, length, rtol=1e-13)


@pytest.mark.parametrize("name", ["telescope", "offset telescope"])
def test_telescope_bar_tilts_on_a_cross_in_a_fork_that_turns_with_psi(name: str) -> None:
    k = kinematics(name)
    z = poses_within_reach(k)
    upper, _, effector = k.poses(z)[7:]
    for R_WT, R_WE, psi in zip(upper.R_WB, effector.R_WB, z[:, 3], strict=True):
        np.testing.assert_allclose(R_WE, rotation("z", psi), atol=1e-14)
        tilt = rotation("z", psi).T @ R_WT
        about_x, about_y = np.arctan2(tilt[2, 1], tilt[1, 1]), np.arcsin(tilt[0, 2])
        assert np.abs([about_x, about_y]).max() < np.pi / 2
        expected = rotation("x", about_x) @ rotation("y", about_y)
        np.testing.assert_allclose(tilt, expected, atol=1e-13)


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
