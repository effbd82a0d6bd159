"""The edge of what limbs reach: how far it is, and straight, folded and parted limbs at it."""

import re

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

from deltaid.errors import KinematicsError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.robot.limbs import Limbs
from geometries import elbows, kinematics, platform_joints, poses_within_reach
from oracle.tree import rot_z
from sweeps import swept


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


@pytest.mark.parametrize(
    "name", swept(["even", "uneven clockwise", "wide platform"], "uneven clockwise")
)
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
    return rot_z(phi) @ (inwards + arm + strut * along)


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
    line = rot_z(phi).T @ platform_joints(limbs, z[0])[limb] - [limbs.base_radius, 0, 0]
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
