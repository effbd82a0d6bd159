"""A turning axis whose angle starts again after one turn."""

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.errors import RecordingError
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import simulate_recording, surrogate_parameters
from deltaid.recording.log import open_log
from deltaid.robot.load import load_robot


def test_a_wrapped_fourth_axis_is_named_with_its_row(tmp_path) -> None:
    robot, rng = load_robot("irb360-6-1600"), np.random.default_rng(0)
    dynamics = compiled(robot)
    truth = surrogate_parameters(robot, rng)
    motion = random_motion(dynamics.kinematics, rng)
    recording = simulate_recording(dynamics, truth, motion, rng)
    open_log(_written(recording, tmp_path / "whole.csv"), dynamics.kinematics)
    q4 = recording["q4"].to_numpy()
    wrapped = np.mod(q4 + np.pi, 2 * np.pi) - np.pi
    row = int(np.flatnonzero(np.abs(np.diff(wrapped)) > np.pi)[0]) + 3  # header, and rows from 1
    path = _written(recording.with_columns(pl.Series("q4", wrapped)), tmp_path / "wrapped.csv")
    with pytest.raises(RecordingError, match=rf"row {row}: column q4 jumps by -?3[56]"):
        open_log(path, dynamics.kinematics)


def _written(recording: pl.DataFrame, path):
    recording.write_csv(path)
    return path
