"""`deltaid show`: readings equal kinematics, reach ends at limits, page, errors."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from command import accepted, refused, run
from deltaid import libraries
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.limits import AtRest
from deltaid.dynamics.parameters import prior_parameters
from deltaid.model.model import load
from deltaid.robot.load import load_robot
from deltaid.view.animation import outward_faces
from deltaid.view.at_pose import moved, standing
from deltaid.view.drawing import along
from deltaid.view.live import cylinder
from deltaid.view.reach import good, reach, survey
from deltaid.view.robots import percent_of, rest_page
from identified import identified

ROBOTS = ("clavel-delta3", "irb360-6-1600")


@cache
def at_rest(name: str) -> AtRest:
    found = load(name)
    return AtRest(found.dynamics, found.p)


@pytest.mark.parametrize("name", ROBOTS)
def test_readings_are_those_of_kinematics_and_dynamics(name: str) -> None:
    robot, rng = at_rest(name), np.random.default_rng(0)
    z = robot.home + rng.uniform(-0.15, 0.15, (50, robot.dynamics.dof))
    poses, kinematics = robot(z), robot.dynamics.kinematics
    still = np.zeros_like(z)
    assert poses.stands.all()
    np.testing.assert_allclose(poses.q, kinematics.inverse(z), rtol=0, atol=1e-12)
    np.testing.assert_allclose(poses.condition, kinematics.condition(z), rtol=1e-12)
    torque = robot.dynamics.torque(z, still, still, robot.p)
    np.testing.assert_allclose(poses.torque, torque, rtol=0, atol=1e-10)
    limits = robot.robot.drive_limits["drive2"]
    low, high = limits.range
    used = np.abs(poses.q[:, 1] - 0.5 * (low + high)) / (0.5 * (high - low))
    np.testing.assert_allclose(poses.shares[:, robot.limits.index("drive2 angle")], used)
    effort = poses.shares[:, robot.limits.index("drive2 torque")]
    np.testing.assert_allclose(effort, np.abs(torque[:, 1]) / limits.torque, atol=1e-12)


def test_out_of_reach_the_robot_stays_and_says_why() -> None:
    robot = at_rest("clavel-delta3")
    asked = np.array([0.1, 0.2, -1.0])
    view = moved(robot, standing(robot, robot.home), asked)
    asked[:] = 0  # views keep no one else's array
    assert view.message == ""
    stayed = moved(robot, view, np.array([0.1, 0.2, -3.0]))
    np.testing.assert_array_equal(stayed.z, [0.1, 0.2, -1.0])
    assert stayed.drives == view.drives
    assert "limb 1 cannot reach" in stayed.message
    assert "stays" in stayed.message
    again = moved(robot, stayed, np.array([0.0, 0.0, -1.0]))
    np.testing.assert_array_equal(again.z, [0.0, 0.0, -1.0])
    assert again.message == ""
    assert "no number" in moved(robot, again, np.array([np.nan, 0.0, -1.0])).message


def test_a_pose_beyond_limits_is_shown_and_they_are_named() -> None:
    robot = at_rest("clavel-delta3")
    view = moved(robot, standing(robot, robot.home), np.array([-0.75, 0.0, -1.0]))
    np.testing.assert_array_equal(view.z, [-0.75, 0.0, -1.0])
    over = {name for name, share in view.limits.items() if share > 1}
    assert "workspace radius" in over
    assert view.message == "beyond " + ", ".join(n for n in robot.limits if n in over)
    assert list(view.limits) == list(robot.limits)


@pytest.mark.parametrize("name", ROBOTS)
def test_ways_end_where_a_limit_does(name: str) -> None:
    robot = at_rest(name)
    found = reach(robot)
    unit = found.points - robot.home[:3]
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    rows = found.distance.size
    z = np.tile(robot.home, (rows, 1))
    z[:, :3] = found.points.reshape(-1, 3)
    inside = robot(z)
    assert good(robot, inside).all()
    ended_by = found.ended_by.ravel()
    fullest = inside.shares[np.arange(rows), ended_by]
    np.testing.assert_allclose(fullest, 1.0, atol=1e-4)
    z[:, :3] += 1e-5 * unit.reshape(-1, 3)
    assert not good(robot, robot(z)).any()
    assert sum(found.shares.values()) == pytest.approx(1.0)


def test_volume_is_that_of_points_inside() -> None:
    robot = at_rest("clavel-delta3")
    found, rng = reach(robot), np.random.default_rng(1)
    points = found.points.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    inside = good(robot, robot(rng.uniform(low, high, (200_000, 3)))).mean()
    assert found.volume == pytest.approx(inside * np.prod(high - low), rel=0.03)


def test_limits_that_cut_the_workspace_are_warned_of() -> None:
    described = load_robot("clavel-delta3")
    tight = {**described.drive_limits}
    tight["drive1"] = tight["drive1"].changed(angle_deg=(0.0, 30.0))
    robot = described.changed(drive_limits=tight)
    rest = AtRest(compiled(robot), prior_parameters(robot))
    surveyed = survey(rest)
    z = surveyed.poses.z
    turned = np.rad2deg(rest.dynamics.kinematics.inverse(z)[:, 0])
    assert 0 < surveyed.within < 1
    assert surveyed.within == pytest.approx(np.mean((turned >= 0) & (turned <= 30)), abs=0.02)
    (warning,) = rest_page(rest, "").warnings
    assert warning.startswith(
        f"{percent_of(1 - surveyed.within)} of the described workspace cannot be used; likeliest "
        "cause: poses lie beyond drive1 angle; "
    )


def test_cylinders_join_the_ends_of_segments() -> None:
    rng = np.random.default_rng(2)
    segments = rng.uniform(-1, 1, (20, 2, 3))
    segments[0, 1] = segments[0, 0] - [0, 0, 0.5]  # straight down
    segments[1, 1] = segments[1, 0]  # no length
    placed, corners = along(segments, 0.01), cylinder()
    w, v = placed.wxyz[:, :1], placed.wxyz[:, 1:]
    half = np.array([0, 0, 0.5]) * placed.scales
    turned = half + 2 * np.cross(v, np.cross(v, half) + w * half)
    np.testing.assert_allclose(placed.positions + turned, segments[:, 1], atol=1e-8)
    np.testing.assert_allclose(placed.positions - turned, segments[:, 0], atol=1e-8)
    a, b, c = (corners[outward_faces(corners)[:, k]] for k in range(3))
    sides = np.einsum("ti,ti->t", np.cross(b - a, c - a), a + b + c)
    assert (sides > 0).all()  # all face outwards


def test_page_and_tables(tmp_path: Path) -> None:
    printed = accepted("show", "irb360-6-1600", "--full")
    for text in ("condition in the workspace", "telescope length", "at x, y, z [m]", "-50 … 80"):
        assert text in printed.out
    path = tmp_path / "robot.html"
    assert run("show", "irb360-6-1600", "-o", path).code == 0
    page = path.read_text(encoding="utf-8")
    for text in ("ends at: strut swing", "Nothing ends the turning", "prior parameters"):
        assert text in page


def test_a_model_is_shown_with_its_own_parameters() -> None:
    found = load(str(identified("clavel-delta3").model_file))
    assert found.origin.startswith("identified from")
    model, prior = AtRest(found.dynamics, found.p), at_rest("clavel-delta3")
    assert np.abs(model(model.home[None]).torque - prior(prior.home[None]).torque).max() > 0.01


def test_errors_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "must end in .html" in refused("show", "clavel-delta3", "-o", "a.png", folder=tmp_path)
    assert "clavel-delta3" in refused("show", "clavel", folder=tmp_path)
    monkeypatch.setattr(libraries, "find_spec", lambda _: None)
    message = refused("show", "clavel-delta3", "--live", folder=tmp_path)
    assert "pip install viser" in message
