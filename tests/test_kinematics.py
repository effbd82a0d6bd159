"""Inverse and forward kinematics, their Jacobians and rates; poses of tools.

Poses of all other bodies: test_class.py.
"""

import numpy as np
import pytest

from deltaid.errors import DescriptionError, KinematicsError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from geometries import (
    GEOMETRIES,
    box,
    elbows,
    kinematics,
    platform_joints,
    poses_within_reach,
)
from support import assert_close, slope


@pytest.mark.parametrize("name", GEOMETRIES)
class TestInverses:
    def test_forward_of_inverse_is_the_pose(self, name: str) -> None:
        k = kinematics(name)
        z = poses_within_reach(k)
        np.testing.assert_allclose(k.forward(k.inverse(z)), z, rtol=0, atol=1e-12)

    def test_inverse_of_forward_is_the_angles(self, name: str) -> None:
        k, rng = kinematics(name), np.random.default_rng(2)
        q = np.hstack([box(name, "q", rng, 100), rng.uniform(-9, 9, (100, k.dof - 3))])
        np.testing.assert_allclose(k.inverse(k.forward(q)), q, rtol=0, atol=1e-12)

    def test_inverse_puts_elbows_a_strut_away_and_outwards(self, name: str) -> None:
        k = kinematics(name)
        limbs, z = k.robot.limbs, poses_within_reach(k)
        for pose, q in zip(z, k.inverse(z), strict=True):
            strut = platform_joints(limbs, pose) - elbows(limbs, q)
            np.testing.assert_allclose(np.linalg.norm(strut, axis=1), limbs.strut, rtol=1e-13)
            for i, phi in enumerate(np.deg2rad(limbs.azimuth_deg)):
                plane = np.array([[np.cos(phi), np.sin(phi), 0], [0, 0, 1]])
                motor = np.array([limbs.base_radius, 0])
                line = plane @ platform_joints(limbs, pose)[i] - motor
                arm = plane @ elbows(limbs, q)[i] - motor
                assert line[1] < 0  # downwards, so outwards is counter-clockwise from it
                assert np.linalg.det([line, arm]) > 0

    def test_forward_gives_the_lower_of_two_points(self, name: str) -> None:
        k = kinematics(name)
        q = k.inverse(poses_within_reach(k))
        for angles, pose in zip(q, k.forward(q), strict=True):
            centres = elbows(k.robot.limbs, angles) - platform_joints(k.robot.limbs, np.zeros(3))
            normal = np.cross(centres[1] - centres[0], centres[2] - centres[0])
            normal /= np.linalg.norm(normal)
            mirrored = pose[:3] - 2 * normal * (normal @ (pose[:3] - centres[0]))
            assert pose[2] < mirrored[2]


@pytest.mark.parametrize("name", GEOMETRIES)
class TestDerivatives:
    def test_jacobian(self, name: str) -> None:
        k = kinematics(name)
        z = poses_within_reach(k, 20)
        differences = [slope(k.inverse, z, axis) for axis in np.eye(k.dof)]
        assert_close(k.jacobian(z), np.stack(differences, axis=2), 1e-8)

    def test_jacobian_rate(self, name: str) -> None:
        k = kinematics(name)
        z = poses_within_reach(k, 20)
        zd = np.random.default_rng(3).standard_normal(z.shape)
        assert_close(k.jacobian_rate(z, zd), slope(k.jacobian, z, zd), 1e-8)

    def test_drive_motion_differentiates_inverse(self, name: str) -> None:
        k, rng = kinematics(name), np.random.default_rng(4)
        z = poses_within_reach(k, 20)
        zd, zdd = rng.standard_normal((2, *z.shape))

        def angles(t: np.ndarray) -> np.ndarray:
            return k.inverse(z + zd * t + 0.5 * zdd * t**2)

        def speeds(t: np.ndarray) -> np.ndarray:
            return k.drive_motion(z + zd * t + 0.5 * zdd * t**2, zd + zdd * t, zdd)[1]

        q, qd, qdd = k.drive_motion(z, zd, zdd)
        now, tick = np.zeros(1), np.ones(1)
        np.testing.assert_allclose(q, k.inverse(z), rtol=0, atol=0)
        assert_close(qd, slope(angles, now, tick), 1e-8)
        assert_close(qdd, slope(speeds, now, tick), 1e-8)

    def test_condition(self, name: str) -> None:
        k = kinematics(name)
        z = poses_within_reach(k, 20)
        J = k.jacobian(z)
        norms = np.linalg.norm(J, axis=(1, 2)) * np.linalg.norm(np.linalg.inv(J), axis=(1, 2))
        np.testing.assert_allclose(k.condition(z), norms / k.dof, rtol=1e-10)


def test_forward_names_the_first_bad_sample() -> None:
    k = kinematics("even")
    q = np.full((4, 3), 0.4)
    q[2:] = [[-3.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]
    with pytest.raises(KinematicsError) as caught:
        k.forward(q)
    assert caught.value.where == "sample 2"
    with pytest.raises(KinematicsError):
        k.forward(q[3:])


@pytest.mark.parametrize("method", ["inverse", "forward", "jacobian", "condition", "poses"])
@pytest.mark.parametrize("columns", [2, 4])
def test_wrong_number_of_columns(method: str, columns: int) -> None:
    with pytest.raises(KinematicsError, match=rf"\(samples, 3\), got \(5, {columns}\)"):
        getattr(kinematics("even"), method)(np.zeros((5, columns)))


def test_nan_pose_is_refused() -> None:
    with pytest.raises(KinematicsError, match="sample 1"):
        kinematics("even").inverse(np.array([[0, 0, -1.0], [0, np.nan, -1.0]]))


def standing(name: str, mode: str = "outwards") -> RobotDescription:
    """The mirror image of a robot, with its platform above its motors."""
    data = load_robot(name).model_dump(exclude_none=True)
    low, high = data["workspace"]["z"]
    data["workspace"]["z"] = (-high, -low)
    for limits in data["drive_limits"].values():
        first, last = limits["angle_deg"]
        limits["angle_deg"] = (-last, -first)
    data["limbs"]["working_mode"] = mode
    return RobotDescription.model_validate(data)


def test_elbows_point_outwards_below_a_platform_too() -> None:
    hanging, upright = (Kinematics(robot("clavel-delta3")) for robot in (load_robot, standing))
    z = poses_within_reach(hanging)
    mirrored = z * [1, 1, -1]
    q = hanging.inverse(z)
    np.testing.assert_allclose(upright.inverse(mirrored), -q, atol=1e-12)
    np.testing.assert_allclose(upright.forward(-q), mirrored, atol=1e-12)
    inwards = Kinematics(standing("clavel-delta3", "inwards"))
    with pytest.raises(KinematicsError, match=r"elbow of limb \d points outwards"):
        inwards.forward(-q)


def with_tool(name: str, **platform: object) -> RobotDescription:
    robot = load_robot(name)
    return robot.changed(platform=robot.platform.changed(**platform))


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
    with pytest.raises(DescriptionError, match="tool_on"):
        with_tool("h4", tool=(0.03, 0, 0))
