"""Recordings of a robot under control, whose torques answer the noise of its encoders."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from deltaid.checks.closed_loop import checked_feedback, shaken
from deltaid.checks.evidence import Evidence, evidence
from deltaid.checks.identified import identify
from deltaid.control.control_model import ControlModel
from deltaid.control.controllers import tuned
from deltaid.control.tracking import Drives, track
from deltaid.control.trajectory import MotionTrajectory
from deltaid.dynamics.dynamics import compiled
from deltaid.model.model import Model
from deltaid.model.record import Settings
from deltaid.model.verdict import Grade, Verdict
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.memory import Recording
from deltaid.robot.load import load_robot

RATE, SECONDS = 1000.0, 5.0


@cache
def controlled(bits: int, bandwidth: float) -> tuple[Evidence, np.ndarray]:
    """What a drive logs of a robot that follows a motion, and the robot's true q."""
    robot, rng = load_robot("clavel-delta3"), np.random.default_rng(2)
    dynamics, p = compiled(robot), surrogate_parameters(robot, rng)
    motion = random_motion(dynamics.kinematics, rng)
    trajectory = MotionTrajectory(dynamics.kinematics, motion, SECONDS)
    step = 2 * np.pi / 2.0**bits
    q = trajectory.desired(np.linspace(0, SECONDS, 40)).q
    mass = np.einsum("sii->i", dynamics.mass_matrix(q, p)) / len(q)
    run = track(
        Model(robot, p, "true"),
        tuned("pd-feedforward", mass, bandwidth),
        ControlModel(robot, 0.9 * p),
        trajectory,
        Drives(RATE, step),
    )
    noise = 0.01 * np.abs(run.tau).max(axis=0) * rng.standard_normal(run.tau.shape)
    log = Recording.from_arrays(q=step * np.round(run.q / step), tau=run.tau + noise, rate=RATE)
    return evidence(robot, log, settings=Settings(lag="none", friction="described")), run.q


def said(bits: int, bandwidth: float) -> list[Verdict]:
    return list(checked_feedback(controlled(bits, bandwidth)[0]))


def test_drives_that_noise_shakes_are_told() -> None:
    (verdict,) = said(13, 30.0)
    assert verdict.key == "closed-loop"
    assert verdict.grade in (Grade.DOUBTFUL, Grade.WRONG)
    assert verdict.number > 1.0
    assert "encoder" in verdict.seen


def test_the_shake_is_as_large_as_it_is_told() -> None:
    seen, q = controlled(13, 30.0)
    shake = shaken(seen.rows, seen.surveyed, seen.fitted)
    assert shake is not None
    high = butter(4, 2 * seen.surveyed.cutoff, "high", fs=RATE, output="sos")
    speed = sosfiltfilt(high, np.gradient(q, 1 / RATE, axis=0), axis=0)
    assert shake.speed == pytest.approx(np.sqrt(np.mean(speed**2, axis=0)), rel=0.3)


def test_encoders_of_today_do_no_harm() -> None:
    assert all(one.grade is Grade.GOOD for one in said(20, 20.0))


def test_noise_that_does_not_come_back_is_no_feedback() -> None:
    """The same positions with torques of a quiet loop: what is recorded apart goes not together."""
    quiet, _ = controlled(20, 20.0)
    rng, q = np.random.default_rng(0), quiet.rows.q
    noisy = q + 2 * np.pi / 2.0**13 * rng.uniform(-0.5, 0.5, q.shape)
    log = Recording.from_arrays(q=noisy, tau=quiet.rows.tau, rate=RATE)
    one = evidence(quiet.robot, log, settings=Settings(lag="none", friction="described"))
    assert all(verdict.grade is Grade.GOOD for verdict in checked_feedback(one))


def test_a_lag_that_noise_hides_is_left_alone_and_said() -> None:
    """Noise that comes back hides the steps of friction, which tell a lag to 20 µs elsewhere: here
    it is known to 0.5 ms, more than three times what counts as hardly known, and may be none.
    `test_lag_unknown.py` has what this does to intervals."""
    seen, _ = controlled(14, 20.0)
    log = Recording.from_arrays(q=seen.rows.q, tau=seen.rows.tau, rate=RATE)
    found = identify(seen.robot, log, settings=Settings(friction="described"))
    assert found.recordings[0].repairs.delay == ()
    (lag,) = [one for one in found.verdicts if one.key == "torque-lag"]
    assert lag.grade is Grade.CANNOT_TELL
    assert "hardly known" in lag.seen
