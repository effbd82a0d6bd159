"""Arms about ±180° and axes that start again after a turn: angles are continuous there."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from command import run
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import RecordingError
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import simulate_recording, surrogate_parameters
from deltaid.recording.opening import open_log
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot


def turned(angle_deg: tuple[float, float] | None) -> RobotDescription:
    """Clavel's Delta with its arms folded inwards and level, elbows behind their motors."""
    data = load_robot("clavel-delta3").model_dump(exclude_none=True)
    data["name"] = "turned"
    data["limbs"]["working_mode"] = "inwards"
    data["workspace"] = {"shape": "cylinder", "radius": 0.15, "z": [-1.08, -0.96]}
    own = {"torque": 150.0} | ({"angle_deg": angle_deg} if angle_deg else {})
    data["drive_limits"] = {f"drive{i}": own for i in (1, 2, 3)}
    data |= {"strut_swing_deg": 60.0}
    return RobotDescription.model_validate(data)


@pytest.mark.parametrize(
    ("angle_deg", "middle"), [((150.0, 230.0), 190.0), ((-220.0, -140.0), -180.0), (None, -178.9)]
)
def test_angles_are_continuous_around_half_a_turn(angle_deg, middle) -> None:
    kinematics = compiled(turned(angle_deg)).kinematics
    motion = random_motion(kinematics, np.random.default_rng(0))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, 4000))
    q, qd, _ = kinematics.drive_motion(z, zd, zdd)
    assert np.abs(np.diff(q, axis=0)).max() < np.deg2rad(1.0)
    assert (q.min(axis=0) < np.pi * np.sign(middle)).all()  # both sides of ±180° are visited
    assert (q.max(axis=0) > np.pi * np.sign(middle)).all()
    assert np.abs(q - np.deg2rad(middle)).max() < np.deg2rad(60)
    slope = np.gradient(q, motion.period / 3999, axis=0)
    assert np.abs(slope - qd)[1:-1].max() < 1e-3 * np.abs(qd).max()


@pytest.mark.parametrize("name", ["clavel-delta3", "h4"])
def test_an_encoder_that_counts_whole_turns_more_is_read_the_same(name: str) -> None:
    kinematics = compiled(load_robot(name)).kinematics
    motion = random_motion(kinematics, np.random.default_rng(0))
    z = motion.evaluate(np.linspace(0, 1, 100))[0]
    q = kinematics.inverse(z)
    q[:, 1] += 2 * np.pi
    q[:, 2] -= 2 * np.pi
    np.testing.assert_allclose(kinematics.forward(q), z, atol=1e-9)


def test_a_log_is_read_with_any_count_of_turns(tmp_path: Path) -> None:
    kinematics = compiled(turned((150.0, 230.0))).kinematics
    motion, time = random_motion(kinematics, np.random.default_rng(0)), np.arange(400) / 1000
    moved = zip(("q", "qd", "qdd"), kinematics.drive_motion(*motion.evaluate(time)), strict=True)
    columns = {f"{name}{i + 1}": x[:, i] for name, x in moved for i in range(3)}
    columns |= {f"tau{i}": np.sin(time + i) for i in (1, 2, 3)}
    frame = pl.DataFrame({"t": time} | columns)
    for turns in (0, -1):
        frame.with_columns(pl.col("q1", "q2", "q3") + turns * 2 * np.pi).write_csv(
            tmp_path / "log.csv"
        )
        assert open_log(tmp_path / "log.csv", kinematics).samples == 400


@pytest.mark.slow
def test_a_planned_motion_can_be_simulated_and_read_with_any_count_of_turns(tmp_path: Path) -> None:
    robot, motion, log = (tmp_path / name for name in ("r.yaml", "motion.csv", "log.csv"))
    robot.write_text(turned((150.0, 230.0)).model_dump_json(exclude_none=True))
    plan = ("excite", robot, "--starts", 1, "--duration", 2, "--harmonics", 2, "-o", motion)
    assert run(*plan).code == 0
    planned = pl.read_csv(motion)
    angles = planned.select("q1", "q2", "q3").to_numpy()
    assert np.abs(np.diff(angles, axis=0)).max() < np.deg2rad(5)
    assert angles.min() < np.pi < angles.max()
    assert np.deg2rad(150) <= angles.min() <= angles.max() <= np.deg2rad(230)
    done = run("simulate", robot, motion, "-o", log)
    assert done.code == 0, done.err
    turns = [(pl.col(f"q{i}") - 2 * np.pi).alias(f"q{i}") for i in (1, 2, 3)]
    other = tmp_path / "other.csv"
    pl.read_csv(log).with_columns(turns).write_csv(other)
    kinematics = compiled(turned((150.0, 230.0))).kinematics
    assert open_log(log, kinematics).samples == open_log(other, kinematics).samples


def test_a_wrapped_fourth_axis_goes_on(tmp_path) -> None:
    robot, rng = load_robot("irb360-6-1600"), np.random.default_rng(0)
    dynamics = compiled(robot)
    truth = surrogate_parameters(robot, rng)
    motion = random_motion(dynamics.kinematics, rng)
    recording = simulate_recording(dynamics, truth, motion, rng)
    whole = _written(recording, tmp_path / "whole.csv")
    q4 = recording["q4"].to_numpy()
    wrapped = np.mod(q4 + np.pi, 2 * np.pi) - np.pi
    rows = np.flatnonzero(np.abs(np.diff(wrapped)) > np.pi) + 3  # header, and rows from 1
    path = _written(recording.with_columns(pl.Series("q4", wrapped)), tmp_path / "wrapped.csv")
    log = open_log(path, dynamics.kinematics)
    (told,) = log.warnings
    assert told.startswith(
        f"column q4 starts again after 6.28319, one turn, in {len(rows)} rows, the first row "
        f"{rows[0]}: taken to go on; likeliest cause: the controller keeps angles within one turn"
    )
    a, b = (
        np.concatenate([batch.values for batch in open_log(one, dynamics.kinematics).batches()])
        for one in (whole, path)
    )
    shift = b[0, 4] - a[0, 4]
    assert abs(shift / (2 * np.pi) - round(shift / (2 * np.pi))) < 1e-12
    np.testing.assert_allclose(b[:, 4] - shift, a[:, 4], rtol=0, atol=1e-12)
    # A step of five sixths of a turn is neither motion nor a new round.
    leap = np.where(np.arange(len(q4)) < 700, q4, q4 + np.deg2rad(295) * np.sign(np.diff(q4)[699]))
    path = _written(recording.with_columns(pl.Series("q4", leap)), tmp_path / "leap.csv")
    with pytest.raises(RecordingError, match=r"row 702: column q4 jumps by -?29"):
        open_log(path, dynamics.kinematics)


def _written(recording: pl.DataFrame, path):
    recording.write_csv(path)
    return path
