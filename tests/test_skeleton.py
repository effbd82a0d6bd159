"""Robots as they are drawn: each line from joint to joint, by the numbers of the description."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import plotly.graph_objects as go
import pytest
from scipy.spatial.transform import Rotation

from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.skeleton import Skeleton
from deltaid.model.record import IdentifiedModel
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import pseudo_inertia
from deltaid.robot.load import load_robot
from deltaid.robot.platform import RigidPlatform
from deltaid.studio.stand import robot_at
from deltaid.view.animation import animation, placed, robot_lines
from deltaid.view.drawing import drawing
from joint_places import direction, poses, prior_oracle, tool_point
from support import example

ROBOTS = ("telescope aside", "linear-delta-45", "h4-linear", "par4", "i4", "one strut a limb")

Line = tuple[str, np.ndarray, np.ndarray]


@cache
def drawn(name: str) -> tuple[RobotDescription, Kinematics, Skeleton]:
    if name == "one strut a limb":
        robot = load_robot("clavel-delta3")
        limbs = robot.limbs.changed(struts_per_limb=1, strut_spacing=None)
        robot = robot.changed(limbs=limbs)
    elif name == "telescope aside":
        robot = load_robot("irb360-6-1600")
        joints = {"base_joint": (0.02, 0.0, 0.05), "platform_joint": (-0.01, 0.03, 0.04)}
        robot = robot.changed(telescope=robot.telescope.changed(**joints))
    else:
        robot = load_robot(name)
    kinematics = Kinematics(robot)
    return robot, kinematics, Skeleton(robot, kinematics.mechanism)


def of_limbs(robot: RobotDescription, q: np.ndarray, z: np.ndarray) -> list[Line]:
    """Struts, what is between the two of a pair, arms or rails; base and platform around them."""
    oracle, limbs = prior_oracle(robot), robot.limb_geometry
    apart = 0.25 * np.mean([np.linalg.norm(limb.attachment) for limb in limbs])
    lines, base, seats = list[Line](), list[np.ndarray](), [[], []] if oracle.first else [[]]
    for i, limb in enumerate(limbs):
        k = int(bool(oracle.first) and i not in oracle.first)
        held, joint, y = oracle.held(z)[i], oracle.limbs[i].tip(q[i]), limb.R_WL[:, 1]
        if limb.drive == "rotary":
            lines.append(("U", limb.base, joint))
        else:
            low, high = robot.drive_limits[f"drive{i + 1}"].range
            ends = (limb.base + s * limb.R_WL @ limb.rail for s in (low, high))
            lines.append(("base", *ends))
        assert np.linalg.norm(held - joint) == pytest.approx(limb.strut)
        sides = [-apart * y, apart * y] if limb.struts == 2 else [np.zeros(3)]
        lines += [("S", joint + side, held + side) for side in sides]
        driven = "U" if limb.drive == "rotary" else "C"
        lines.append((driven, joint + sides[0], joint + sides[-1]))
        base += [limb.base + side for side in sides]
        seats[k] += [held + side for side in sides]
    lines += [("base", *both) for both in zip(base, np.roll(base, 1, axis=0), strict=True)]
    for ring in seats:
        each = zip(ring, np.roll(ring, 1, axis=0), strict=True)
        lines += [(robot.platform.bodies[0], *both) for both in each]
    return lines


def of_tool(robot: RobotDescription, z: np.ndarray) -> list[Line]:
    """A telescope, or what joins both parts of a platform; and the tool's own x axis."""
    platform, bar = robot.platform, robot.telescope
    if bar is not None:
        top, bottom = np.array(bar.base_joint), z[:3] + bar.platform_joint
        middle = 0.5 * (top + bottom)
        pointer = z[:3] + 0.05 * direction(z[3])
        return [("TU", top, middle), ("TL", middle, bottom), ("EE", z[:3], pointer)]
    if isinstance(platform, RigidPlatform):
        return []
    first, second = prior_oracle(robot).parts(z)
    size = np.mean([np.linalg.norm(limb.attachment) for limb in robot.limb_geometry])
    tool = tool_point(robot, z)
    pointer = tool + max(0.5 * size, 0.03) * direction(z[3])
    joining = {"h4": "MB", "par4": "R", "i4": "HP"}[platform.kind]
    return [(joining, first, second), ("EE", tool, pointer)]


def in_order(lines: list[Line]) -> dict[str, np.ndarray]:
    """Lines of each body, both ends and all lines sorted: which comes first does not matter."""
    found = dict[str, list[np.ndarray]]()
    for body, *ends in lines:
        both = sorted(np.round(ends, 9).tolist())
        found.setdefault(body, []).append(np.ravel(both))
    return {body: np.array(sorted(map(tuple, each))) for body, each in found.items()}


@pytest.mark.parametrize("name", ROBOTS)
def test_lines_go_from_joint_to_joint(name: str) -> None:
    robot, kinematics, skeleton = drawn(name)
    z = poses(robot, 3)
    q, ends = kinematics.inverse(z), skeleton.evaluate(z)
    bodies = [segment.body for segment in skeleton.segments]
    for k in range(len(z)):
        expected = in_order(of_limbs(robot, q[k], z[k]) + of_tool(robot, z[k]))
        found = in_order([(b, *e) for b, e in zip(bodies, ends[k], strict=True)])
        assert found.keys() == expected.keys() == set(skeleton.bodies)
        for body, lines in found.items():
            np.testing.assert_allclose(lines, expected[body], atol=2e-9, err_msg=body)


def points_of(trace: go.Scatter3d) -> np.ndarray:
    return np.column_stack([trace.x, trace.y, trace.z])


def with_gaps(skeleton: Skeleton, ends: np.ndarray, body: str) -> np.ndarray:
    own = [k for k, segment in enumerate(skeleton.segments) if segment.body == body]
    gap = np.full((1, 3), np.nan)
    return np.concatenate([part for k in own for part in (ends[k], gap)])


def test_a_robot_is_one_line_a_body() -> None:
    """With a gap behind each of its segments; in single precision."""
    robot, _, skeleton = drawn("irb360-6-1600")
    ends = skeleton.evaluate(poses(robot, 1))[0]
    lines = robot_lines(skeleton, ends)
    assert tuple(lines) == skeleton.bodies
    for body, trace in lines.items():
        np.testing.assert_allclose(points_of(trace), with_gaps(skeleton, ends, body), atol=1e-6)


def test_an_animation_shows_each_instant_as_it_is() -> None:
    """Of the four seconds in which the platform travels farthest, a hundred."""
    robot, kinematics, skeleton = drawn("irb360-6-1600")
    t, home = np.arange(241) / 30.0, np.mean(poses(robot, 20), axis=0)
    z = home + (0.02 * t * np.sin(np.outer([1.0, 1.3, 0.7, 2.0], t))).T
    figure = animation(kinematics, t, z, "").figure
    times = np.array(figure.layout.meta["times"])
    at = np.round(30 * times).astype(int)
    travelled = np.linalg.norm(np.diff(z[:, :3], axis=0), axis=1)
    first = int(np.argmax([travelled[k : k + 120].sum() for k in range(121)]))
    assert (at[0], at[-1]) == (first, first + 120)
    assert first > 60
    assert len(figure.frames) == len(times) == len(set(at)) == 100
    assert [int(frame.name) for frame in figure.frames] == at.tolist()
    ends = skeleton.evaluate(z[at])
    moving = [body for body in skeleton.bodies if body != "base"]
    for k, body in zip(figure.frames[0].traces, moving, strict=True):
        expected = with_gaps(skeleton, ends[0], body)
        np.testing.assert_allclose(points_of(figure.data[k]), expected, atol=1e-6)
    for frame, shape in zip(figure.frames, ends, strict=True):
        for body, trace in zip(moving, frame.data, strict=True):
            expected = with_gaps(skeleton, shape, body)
            np.testing.assert_allclose(points_of(trace), expected, atol=1e-6)
    still = {trace.name: points_of(trace) for trace in figure.data}
    np.testing.assert_allclose(still["path"], z[:, :3], atol=1e-6)
    np.testing.assert_allclose(still["base"], with_gaps(skeleton, ends[0], "base"), atol=1e-6)


@pytest.mark.parametrize("name", ["irb360-6-1600", "h4-linear"])
def test_a_drawing_is_a_picture_of_the_lines(name: str) -> None:
    """In one scale, up is up, and the farthest lines are drawn first."""
    robot, kinematics, skeleton = drawn(name)
    ends = skeleton.evaluate(robot.within(0.0)[0][None])[0]
    numbers = r'<line x1="([\d.-]+)" y1="([\d.-]+)" x2="([\d.-]+)" y2="([\d.-]+)" stroke='
    svg = str(drawing(robot, kinematics).svg)
    flat = np.array(re.findall(numbers, svg), dtype=float)
    eye = np.array([1.6, 1.15, 0.75]) / np.linalg.norm([1.6, 1.15, 0.75])
    ends = ends[np.argsort(np.mean(ends @ eye, axis=1), kind="stable")]
    points, seen = ends.reshape(-1, 3), flat.reshape(-1, 2)
    right = np.cross([0.0, 0.0, 1.0], eye) / np.hypot(*eye[:2])
    plane = np.column_stack([points @ right, points @ np.cross(eye, right)])
    scale = np.ptp(seen[:, 0]) / np.ptp(plane[:, 0])
    expected = scale * (plane - plane.mean(axis=0)) * [1.0, -1.0] + seen.mean(axis=0)
    np.testing.assert_allclose(seen, expected, atol=0.11)  # numbers of a tenth of a pixel
    width, height = map(int, re.findall(r'viewBox="0 0 (\d+) (\d+)"', svg)[0])
    assert np.all((seen > 0) & (seen < [width, height]))


def test_cylinders_on_a_stage_join_the_ends_of_lines() -> None:
    robot, _, skeleton = drawn("clavel-delta3")
    z = poses(robot, 1)[0]
    _, cylinders = robot_at("clavel-delta3", "", z.tolist(), z.tolist())
    turns = Rotation.from_quat(cylinders.wxyz[:, [1, 2, 3, 0]])
    half = turns.apply([0.0, 0.0, 1.0]) * 0.5 * cylinders.scales[:, 2:]
    ends = np.stack([cylinders.positions - half, cylinders.positions + half], axis=1)
    np.testing.assert_allclose(ends, skeleton.evaluate(z[None])[0], atol=1e-8)


def test_a_mechanism_of_the_users_own_has_lines_to_centres_of_mass() -> None:
    """Each body one, from its frame; unless the function gives lines: then these."""
    robot = example("heli4")
    kinematics = Kinematics(robot)
    z = robot.within(0.0)[0][None]
    plain = replace(kinematics.mechanism, drawing=())
    ends = Skeleton(robot, plain).evaluate(z)[0]
    for line, pose in zip(ends, kinematics.poses(z), strict=True):
        p = robot.bodies[pose.name].prior_parameters()
        centre = pose.r_WB[0] + pose.R_WB[0] @ (p[1:4] / p[0])
        np.testing.assert_allclose(line, [pose.r_WB[0], centre], atol=1e-9)
    given = ("base", ca.SX([0.0, 0.0, 1.0]), 2 * plain.z[:3]), ("EE", plain.z[:3], ca.SX.zeros(3))
    skeleton = Skeleton(robot, replace(plain, drawing=given))
    assert skeleton.bodies == ("base", "EE")
    expected = [[[0.0, 0.0, 1.0], 2 * z[0, :3]], [z[0, :3], np.zeros(3)]]
    np.testing.assert_allclose(skeleton.evaluate(z)[0], expected, atol=1e-12)


def test_ellipsoids_lie_where_their_bodies_are() -> None:
    """Of uniform density, with each body's mass and second moments about its centre of mass."""
    model = IdentifiedModel.load(Path(__file__).parent / "data" / "model-format-1.yaml")
    kinematics = Kinematics(model.robot)
    z = poses(model.robot, 1)
    unit = np.random.default_rng(0).standard_normal((40, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    for pose in kinematics.poses(z):
        points = placed(model, pose, model.p, unit)
        p, R = model.p[model.layout.body(pose.name)], pose.R_WB[0]
        centre = p[1:4] / p[0]
        M = pseudo_inertia(p)
        second = R @ (M[:3, :3] - p[0] * np.outer(centre, centre)) @ R.T
        away = points - (pose.r_WB[0] + R @ centre)
        # On the surface, where xᵀ S⁻¹ x = 5 / m for second moments S of a uniform ellipsoid.
        squares = np.einsum("ki,ij,kj->k", away, np.linalg.inv(second), away)
        np.testing.assert_allclose(squares, 5 / p[0], rtol=1e-6)
