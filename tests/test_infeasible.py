"""Motions that a robot cannot run are said so, each in its own words; the demo's are not."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command import accepted, json_of
from deltaid.control.comparison import ControllerRun
from deltaid.control.infeasible import motion_problems, tracking_problems
from deltaid.control.tracking import Drives, Tracking
from deltaid.control.trajectory import MotionTrajectory
from deltaid.dynamics.limits import LimitsAlong
from deltaid.model.model import Model, load
from deltaid.motion.fourier import FourierMotion
from deltaid.motion.random_motion import random_motion, tamed
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.view.tracking import comparison_page, infeasible_lines
from logs import tabled, write
from sweeps import slow

TELESCOPE = "irb360-6-1600"
TIME = np.linspace(0.0, 10.0, 2000)


@pytest.fixture(scope="module")
def robot() -> Model:
    """A robot with a fourth axis, as the demonstration's truth."""
    model = load(TELESCOPE)
    return replace(model, p=surrogate_parameters(model.robot, np.random.default_rng(0)))


@pytest.fixture(scope="module")
def wild(robot: Model) -> FourierMotion:
    """A motion that is too fast for its tool."""
    return random_motion(robot.dynamics.kinematics, np.random.default_rng(0))


def use_of(model: Model, motion: FourierMotion) -> dict[str, float]:
    """Largest use of every limit along a motion."""
    limits = LimitsAlong(model.dynamics)
    z, zd, zdd = motion.evaluate(TIME)
    shares = (*limits.kinematic(z, zd, zdd).T, *limits.effort(z, zd, zdd, model.p).T)
    return dict(zip((*limits.names, *limits.efforts), (s.max() for s in shares), strict=True))


@pytest.mark.parametrize("name", [TELESCOPE, "linear-delta-45", slow("h4")])
def test_the_demonstrations_motions_keep_every_limit(name: str) -> None:
    model, rng = load(name), np.random.default_rng(0)
    model = replace(model, p=surrogate_parameters(model.robot, rng))
    motion = tamed(model.dynamics, model.p, random_motion(model.dynamics.kinematics, rng))
    use = use_of(model, motion)
    assert max(use.values()) <= 1.005
    assert max(v for k, v in use.items() if k.endswith((" torque", " force"))) <= 0.81
    assert motion_problems(model, MotionTrajectory(model.dynamics.kinematics, motion, 10.0)) == ()


def test_only_what_is_too_fast_is_tamed(robot: Model, wild: FourierMotion) -> None:
    assert use_of(robot, wild)["drive4 torque"] > 2
    tame = tamed(robot.dynamics, robot.p, wild)
    assert tame.period == wild.period
    np.testing.assert_array_equal(tame.sine[:3], wild.sine[:3])
    weaker = {f"drive{i}": {"torque": 21.0} for i in (1, 2, 3)}
    slow = load(robot.robot.changed(drive_limits=weaker))
    assert tamed(slow.dynamics, robot.p, wild).period > 1.05 * wild.period


def test_torque_beyond_a_limit_has_drive_size_time_and_share(
    robot: Model, wild: FourierMotion
) -> None:
    (problem,) = motion_problems(robot, MotionTrajectory(robot.dynamics.kinematics, wild, 10.0))
    z, zd, zdd = wild.evaluate(TIME)
    _, qd, qdd = robot.dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = np.abs(robot.dynamics.torque(z, qd, qdd, robot.p)[:, 3])
    assert (problem.kind, problem.what) == ("torque", "drive4")
    assert problem.size == pytest.approx(tau.max() / 10, rel=0.01)
    assert problem.time == pytest.approx(TIME[tau.argmax()], abs=0.02)
    assert problem.share == pytest.approx((tau > 10).mean(), abs=0.01)
    assert f"{tau.max():.3g} N m of 10 N m" in problem.text


FASTER = {"drive_limits": {"drive2": {"speed_deg_s": 60.0}}}
SMALLER = {"workspace": {"shape": "cylinder", "radius": 0.2, "z": [-1.25, -0.9]}}
GENTLE = {"platform_acceleration": 4.0}


@pytest.mark.parametrize(
    ("change", "kind", "what"),
    [
        (FASTER, "speed", "drive2 speed"),
        (SMALLER, "range", "workspace radius"),
        (GENTLE, "acceleration", "platform acceleration x"),
    ],
)
def test_speed_and_workspace_have_words_of_their_own(
    robot: Model, wild: FourierMotion, change: dict[str, object], kind: str, what: str
) -> None:
    narrow = load(robot.robot.changed(**change))
    trajectory = MotionTrajectory(narrow.dynamics.kinematics, wild, 10.0)
    found = {p.what: p for p in motion_problems(narrow, trajectory)}
    assert found[what].kind == kind
    assert found[what].size == pytest.approx(use_of(narrow, wild)[what], rel=0.01)


def followed(robot: Model, samples: int = 1000) -> Tracking:
    """A motion at rest, followed to the letter."""
    z = np.tile(robot.robot.home, (samples, 1))
    q = robot.dynamics.kinematics.inverse(z)
    blank = np.zeros_like(q)
    return Tracking(
        time=np.arange(samples) / 1000,
        q_desired=q,
        z_desired=z,
        q=q,
        z=z,
        tau=blank,
        saturated=blank > 0,
        ended=None,
        task=robot.robot.task,
        qd=blank,
    )


def test_what_a_controller_loses(robot: Model) -> None:
    good = followed(robot)
    assert tracking_problems(robot, good) == ()
    cut = good.saturated.copy()
    cut[200:600, 1] = True
    (problem,) = tracking_problems(robot, replace(good, saturated=cut))
    assert (problem.kind, problem.what, problem.share) == ("saturated", "drive2", 0.4)
    assert "torque limit of drive2 for 40 % of the time, from 0.2 s on" in problem.text
    turned = good.z.copy()
    turned[500:, 3] += 4 * np.pi
    (problem,) = tracking_problems(robot, replace(good, z=turned))
    assert (problem.kind, problem.short) == ("turn", "tool off by 2 turns")
    away = good.z.copy()
    away[700:, 0] += 0.1
    (problem,) = tracking_problems(robot, replace(good, z=away))
    assert (problem.kind, problem.share) == ("diverged", pytest.approx(0.3))
    assert "100 mm from where it should be" in problem.text
    (problem,) = tracking_problems(robot, replace(good, ended=0.25))
    assert (problem.kind, problem.time) == ("lost", 0.25)


def test_a_comparison_praises_nobody_on_a_motion_that_cannot_be_run(
    robot: Model, wild: FourierMotion
) -> None:
    of_it = motion_problems(robot, MotionTrajectory(robot.dynamics.kinematics, wild, 1.0))
    good = followed(robot)
    shaken = replace(good, saturated=np.ones_like(good.saturated))
    runs = tuple(
        ControllerRun("computed-torque", name, result, "", tracking_problems(robot, result))
        for name, result in (("prior", good), ("identified", shaken))
    )
    page = comparison_page(robot.robot, runs, "a", Drives(), 10.0, of_it)
    assert [fact.label for fact in page.facts] == ["no comparison"]
    assert page.verdict.grade == "poor"
    assert page.verdict.sentence == f"Not feasible: {of_it[0].text}."
    page = comparison_page(robot.robot, runs, "a", Drives(), 10.0)
    assert [fact.note for fact in page.facts] == ["rms; computed-torque, prior"]
    lines = infeasible_lines((), runs)
    assert len(lines) == 4
    assert all(line.startswith("computed-torque, identified: ") for line in lines)


def write_motion(model: Model, time: np.ndarray, moved: tuple[np.ndarray, ...], path: Path) -> None:
    q, qd, qdd = model.dynamics.kinematics.drive_motion(*moved)
    write(path, tabled(t=time, q=q, qd=qd, qdd=qdd))


def test_simulate_says_in_red_what_cannot_be_run(
    robot: Model, wild: FourierMotion, tmp_path: Path
) -> None:
    time = np.arange(1500) / 1000
    z, zd, zdd = wild.evaluate(time)
    z[:, 3] *= 3
    zd[:, 3], zdd[:, 3] = 3 * zd[:, 3], 3 * zdd[:, 3]
    write_motion(robot, time, (z, zd, zdd), tmp_path / "wild.csv")
    report = tmp_path / "wild.html"
    outcome = accepted("simulate", TELESCOPE, tmp_path / "wild.csv", "--report", report, "--json")
    assert "not feasible: the motion is too fast for drive4" in outcome.err
    page = report.read_text(encoding="utf-8")
    assert '<div class="verdict poor"' in page
    assert "Not feasible: the motion is too fast for drive4" in page
    answer = json.loads(outcome.out)
    assert {"kind", "what", "text", "size", "time", "share"} <= set(answer["infeasible"][0])


def test_a_robot_that_is_lost_has_numbers_in_json(tmp_path: Path) -> None:
    model, time = load("clavel-delta3"), np.arange(1500) / 1000
    moved = random_motion(model.dynamics.kinematics, np.random.default_rng(0)).evaluate(time)
    write_motion(model, time, moved, tmp_path / "m.csv")
    answer = json_of("simulate", "clavel-delta3", tmp_path / "m.csv", "--delay", 60)
    assert answer["ended"] is not None
    assert all(np.isfinite(answer["torque_rms"]))
    assert "lost" in {problem["kind"] for problem in answer["infeasible"]}
