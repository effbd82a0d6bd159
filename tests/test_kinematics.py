"""Kinematics: closed loops, inverses of each other, derivatives, and errors that tell the truth."""

from __future__ import annotations

import re
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from deltaid.errors import KinematicsError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.robot.limbs import Limbs
from deltaid.robot.telescope import Telescope
from support import assert_close, random_states, random_twin, slope

# Lengths like a 1.6 m robot's, unless a name says otherwise.
PLAIN = {"base_radius": 0.21, "platform_radius": 0.05, "upper_arm": 0.49, "strut": 1.13}
GEOMETRIES = {
    "even": {**PLAIN, "azimuth_deg": (0, 120, 240)},
    "clockwise": {**PLAIN, "azimuth_deg": (10, 250, 130)},
    "uneven": {**PLAIN, "azimuth_deg": (25, 120, 270)},
    "uneven clockwise": {**PLAIN, "azimuth_deg": (-70, 200, 95)},
    "wide platform": {
        "base_radius": 0.1,
        "platform_radius": 0.2,
        "upper_arm": 0.3,
        "strut": 0.8,
        "azimuth_deg": (5, 120, 240),
    },
    "elbows turned over": {
        "base_radius": 0.1,
        "platform_radius": 0.18,
        "upper_arm": 0.5,
        "strut": 0.705,
        "azimuth_deg": (5, 120, 240),
    },
    "random": {},
    "telescope": {},
    "offset telescope": {},
}
RANDOM = {"random": False, "telescope": True, "offset telescope": True}


@cache
def kinematics(name: str) -> Kinematics:
    robot = random_twin(list(GEOMETRIES).index(name), telescope=RANDOM.get(name, False)).robot
    robot = robot.changed(name=name)
    if name not in RANDOM:
        robot = robot.changed(limbs=Limbs(**GEOMETRIES[name]))
    if name == "offset telescope":
        bar = Telescope(base_joint=(0.03, -0.02, 0.1), platform_joint=(-0.01, 0.025, 0.04))
        robot = robot.changed(telescope=bar)
    return Kinematics(robot)


# Where poses are taken: middle and half width of boxes for z, as shares of arm + strut, and for the
# arm angles. Far off the axis of a wide platform, the elbows' triangle turns over.
ELSEWHERE = {"z": ((0.03, -0.02, -0.62), (0.18, 0.18, 0.1)), "q": ((0.4, 0.4, 0.4), 0.3)}
WHERE = {
    "elbows turned over": {
        "z": ((-0.253, -0.487, -0.695), 0.005),
        "q": ((1.6, 1.6, 0.4), 0.01),
    }
}


def box(name: str, variable: str, rng: np.random.Generator, n: int) -> np.ndarray:
    middle, half = WHERE.get(name, ELSEWHERE)[variable]
    return middle + half * rng.uniform(-1, 1, (n, 3))


def poses_within_reach(k: Kinematics, n: int = 100) -> np.ndarray:
    """Random task coordinates in a box below the base, ψ over more than a revolution."""
    rng, size = np.random.default_rng(1), k.robot.limbs.upper_arm + k.robot.limbs.strut
    psi = rng.uniform(-9, 9, (n, k.dof - 3))
    return np.hstack([size * box(k.robot.name, "z", rng, n), psi])


def elbows(limbs: Limbs, q: np.ndarray) -> np.ndarray:
    """Elbows (limbs, 3) for the arm angles of one q, from the conventions alone."""
    phi = np.deg2rad(limbs.azimuth_deg)
    radius = limbs.base_radius + limbs.upper_arm * np.cos(q[:3])
    height = -limbs.upper_arm * np.sin(q[:3])
    return np.column_stack([radius * np.cos(phi), radius * np.sin(phi), height])


def platform_joints(limbs: Limbs, z: np.ndarray) -> np.ndarray:
    """Ends of the struts (limbs, 3) at one z."""
    phi = np.deg2rad(limbs.azimuth_deg)
    return z[:3] + limbs.platform_radius * np.column_stack([np.cos(phi), np.sin(phi), 0 * phi])


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


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), telescope=st.booleans(), clockwise=st.booleans())
def test_kinematics_of_any_robot_by_the_oracle(seed: int, telescope: bool, clockwise: bool) -> None:
    twin = random_twin(seed, telescope=telescope, clockwise=clockwise)
    k = Kinematics(twin.robot)
    z, q, _, _ = random_states(twin.oracle, np.random.default_rng(seed), 10)
    np.testing.assert_allclose(k.forward(q), z, rtol=0, atol=1e-12)
    np.testing.assert_allclose(k.inverse(z), q, rtol=0, atol=1e-12)


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


def rotation(axis: str, angle: float) -> np.ndarray:
    """Rotation about a coordinate axis, by Rodrigues' formula."""
    e = np.eye(3)["xyz".index(axis)]
    K = np.array([np.cross(e, v) for v in np.eye(3)]).T
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def reach_by_search(limbs: Limbs, z: np.ndarray) -> np.ndarray:
    """Signed distances (limbs,) by which the strut's ends are inside the limbs' reach.

    Searches the circle of the elbow: the end must lie within a strut of one of its points and
    beyond a strut of another; otherwise the nearest of all spheres about them is what is missing.
    """
    angles = np.linspace(-np.pi, np.pi, 20001)
    distances = []
    for i, end in enumerate(platform_joints(limbs, z)):
        phi, arm = np.deg2rad(limbs.azimuth_deg[i]), limbs.upper_arm
        radius = limbs.base_radius + arm * np.cos(angles)
        circle = np.column_stack(
            [radius * np.cos(phi), radius * np.sin(phi), -arm * np.sin(angles)]
        )
        distances.append(np.linalg.norm(circle - end, axis=1))
    near, far = np.min(distances, axis=1), np.max(distances, axis=1)
    return np.minimum(limbs.strut - near, far - limbs.strut)


def scattered_poses(name: str, n: int = 300) -> np.ndarray:
    """Poses of which many are out of reach: too far, too near, too far to the side."""
    limbs = kinematics(name).robot.limbs
    size = limbs.upper_arm + limbs.strut
    return np.random.default_rng(5).uniform([-size, -size, -size], [size, size, 0.0], (n, 3))


@pytest.mark.parametrize("name", ["even", "uneven clockwise", "wide platform"])
def test_reach_is_the_distance_to_the_edge_of_the_reachable_space(name: str) -> None:
    k = kinematics(name)
    z = scattered_poses(name)
    reach = np.array(ca.Function("reach", [k.mechanism.z], [k.mechanism.reach])(z.T)).T
    expected = np.array([reach_by_search(k.robot.limbs, pose) for pose in z])
    assert np.mean(expected > 0) > 0.2
    assert np.mean(expected < 0) > 0.2
    np.testing.assert_allclose(reach, expected, atol=1e-6)


@pytest.mark.parametrize("name", ["even", "uneven clockwise", "wide platform"])
def test_unreachable_pose_names_sample_limb_and_distance(name: str) -> None:
    k = kinematics(name)
    within, blamed = poses_within_reach(k, 3), set()
    for pose in scattered_poses(name, 60):
        reach = reach_by_search(k.robot.limbs, pose)
        if reach.min() > 0:
            assert np.isfinite(k.inverse(pose[None])).all()
            continue
        with pytest.raises(KinematicsError) as caught:
            k.inverse(np.vstack([within, pose, within]))
        text = str(caught.value)
        limb = int(re.search(r"limb (\d) cannot reach", text)[1])
        missing = float(re.search(r"([-\d.e]+) m are missing", text)[1])
        assert caught.value.where == "sample 3"
        assert limb - 1 == np.flatnonzero(reach <= 0)[0]
        assert missing == pytest.approx(-reach[limb - 1], rel=1e-3, abs=1e-6)
        blamed.add(limb)
    assert blamed == {1, 2, 3}


LEAN = 65.0  # a straight limb's angle below the horizontal, degrees, platform side inwards


def stretched_pose(name: str, limb: int, deficit: float) -> np.ndarray:
    """A pose, well within the other limbs' reach, `deficit` metres from this limb's full stretch.

    Arm and strut lie in the limb's plane or, for the second limb, the strut leaves it.
    """
    limbs = kinematics(name).robot.limbs
    phi = np.deg2rad(limbs.azimuth_deg[limb])
    down, aside = np.deg2rad(LEAN), 0.1 if limb == 1 else 0.0
    strut = limbs.strut - deficit
    arm = limbs.upper_arm * np.array([-np.cos(down), 0, -np.sin(down)])
    along = np.sqrt(1 - aside**2) * arm / limbs.upper_arm + [0, aside, 0]
    inwards = np.array([limbs.base_radius - limbs.platform_radius, 0, 0])
    return rotation("z", phi) @ (inwards + arm + strut * along)


@pytest.mark.parametrize("name", ["even", "uneven clockwise", "random"])
@pytest.mark.parametrize("limb", [0, 1, 2])
@pytest.mark.parametrize("deficit", [0.0, 3e-16, -3e-16, 1e-15, -1e-15, 1e-13, -1e-13])
def test_stretched_limb_is_singular(name: str, limb: int, deficit: float) -> None:
    k, z = kinematics(name), stretched_pose(name, limb, deficit)[None]
    reach = reach_by_search(k.robot.limbs, z[0])
    assert np.delete(reach, limb).min() > 0.01
    assert reach[limb] == pytest.approx(0, abs=1e-6)
    with pytest.raises(KinematicsError, match=f"singular: arm and struts of limb {limb + 1}"):
        k.inverse(z)
    with pytest.raises(KinematicsError, match="singular"):
        k.drive_motion(z, 0 * z, 0 * z)


def test_inverse_is_never_silently_nan_at_the_edge() -> None:
    """Where rounding decides whether the arm's angle exists."""
    k, (x, _, z) = kinematics("even"), stretched_pose("even", 0, 0.0)
    for step in np.arange(-20, 21) * 1e-16:
        with pytest.raises(KinematicsError, match="singular"):
            k.inverse(np.array([[x + step, 0.0, z]]))


@pytest.mark.parametrize("limb", [0, 1, 2])
def test_pose_a_little_off_the_singular_one_has_angles(limb: int) -> None:
    k, z = kinematics("even"), stretched_pose("even", limb, 1e-10)[None]
    assert k.inverse(z)[0, limb] == pytest.approx(np.pi - np.deg2rad(LEAN), abs=1e-4)
    assert k.condition(z)[0] > 1e3


def test_pose_near_a_singular_one_is_computed() -> None:
    k, z = kinematics("even"), stretched_pose("even", 0, 1e-6)[None]
    q, _, _ = k.drive_motion(z, 0 * z, 0 * z)
    np.testing.assert_allclose(k.forward(q), z, atol=1e-9)


def straight_angles(limb: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose and arm angles with one limb straight, the others' elbows outwards, by bisection."""
    limbs, z = kinematics("even").robot.limbs, stretched_pose("even", limb, 0.0)

    def excess(angle: float, i: int) -> float:
        gap = platform_joints(limbs, z) - elbows(limbs, np.full(3, angle))
        return float(np.linalg.norm(gap[i]) - limbs.strut)

    q = np.full(3, np.pi - np.deg2rad(LEAN))
    for i in {0, 1, 2} - {limb}:
        q[i] = brentq(excess, -1.0, 1.2, args=(i,), xtol=1e-15)
    return z, q


@pytest.mark.parametrize("limb", [0, 2])
@pytest.mark.parametrize("bend", [0.0, 1e-8, -1e-8])
def test_forward_of_a_stretched_limb_is_singular(limb: int, bend: float) -> None:
    k, (z, q) = kinematics("even"), straight_angles(limb)
    q[limb] += bend
    if bend <= 0:
        np.testing.assert_allclose(k.forward_unchecked(q[None])[0][0], z, atol=1e-7)
    with pytest.raises(KinematicsError, match="singular"):
        k.forward(q[None])


@pytest.mark.parametrize("limb", [0, 1, 2])
@pytest.mark.parametrize("name", ["even", "uneven clockwise", "telescope"])
def test_forward_refuses_an_elbow_that_points_inwards(name: str, limb: int) -> None:
    """The dynamics take the elbows outwards; the torques of this posture would be another's."""
    k = kinematics(name)
    limbs, z = k.robot.limbs, poses_within_reach(k, 1)
    q = k.inverse(z)
    phi = np.deg2rad(limbs.azimuth_deg[limb])
    line = rotation("z", phi).T @ platform_joints(limbs, z[0])[limb] - [limbs.base_radius, 0, 0]
    q[0, limb] = 2 * np.arctan2(-line[2], line[0]) - q[0, limb]  # mirrored about the line
    struts = np.linalg.norm(platform_joints(limbs, z[0]) - elbows(limbs, q[0]), axis=1)
    np.testing.assert_allclose(struts, limbs.strut, rtol=1e-12)
    with pytest.raises(KinematicsError, match=f"elbow of limb {limb + 1} points inwards"):
        k.forward(q)
    assert np.isnan(k.forward_unchecked(q)[0]).all()


@pytest.mark.parametrize("name", ["even", "uneven clockwise"])
def test_forward_tells_the_strut_length_missing(name: str) -> None:
    """The shortest strut that still closes the loops is the radius of the circle of the elbows."""
    k = kinematics(name)
    short = k.robot.limbs.changed(strut=0.45)
    k = Kinematics(k.robot.changed(limbs=short))
    q = np.array([[0.3, 0.5, 0.4], [0.2, -0.3, 0.1]])
    corners = elbows(short, q[1]) - platform_joints(short, np.zeros(3))
    a, b, c = (np.linalg.norm(corners[i] - corners[j]) for i, j in ((0, 1), (1, 2), (2, 0)))
    half = (a + b + c) / 2
    radius = a * b * c / (4 * np.sqrt(half * (half - a) * (half - b) * (half - c)))
    assert radius > short.strut
    with pytest.raises(KinematicsError, match=r"elbows are too far apart") as caught:
        k.forward(q[1:])
    missing = float(re.search(r"by ([-\d.e]+) m of strut", str(caught.value))[1])
    assert missing == pytest.approx(radius - short.strut, rel=1e-3)
    z, good = k.forward_unchecked(q[1:])
    assert np.isnan(z).all()
    assert not good.any()


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
