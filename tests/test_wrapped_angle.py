"""A turning axis whose angle starts again after one turn."""

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.errors import RecordingError
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import simulate_recording, surrogate_parameters
from deltaid.recording.opening import open_log
from deltaid.robot.load import load_robot


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
