"""What a log that can be used is warned of."""

import re

import polars as pl
import pytest

from bad_logs import GOOD, ROWS, changed, with_field
from deltaid.dynamics.dynamics import Dynamics
from deltaid.recording.opening import open_log
from logs import names, recorded, text, write

SWAPPED = recorded(1500, derivatives=True).rename({"qd1": "qd2", "qd2": "qd1"})


@pytest.mark.parametrize(
    ("content", "warning"),
    [
        (changed(q1=pl.lit(0.1)), "column q1 is constant"),
        ("Scope\n" + GOOD, "row 2 is taken for the column names"),
        (GOOD + "END\n", r"ends with text after its data \('END'\)"),
        (
            GOOD.replace("\n", "\ns,rad,rad,rad,Nm,Nm,Nm\n", 1),
            r"row 2 is taken for units \(s, rad, ",
        ),
        (GOOD.rstrip("\n"), "the last line has no line break"),
        (with_field(150, "t", "0.1484"), "stamps of t jitter by .* positions are even, so rows"),
        (
            GOOD.replace("tau3", "tau3,q4,tau4").replace("\n", ",0,0\n"),
            r"\(q4, tau4\), but the robot",
        ),
        (text(SWAPPED), "qd1 hardly goes with .* q1"),
    ],
)
def test_doubts_are_warned_of(tmp_path, opened, content: str, warning: str) -> None:
    if ",0,0\n" in content:
        content = content.replace("tau4,0,0\n", "tau4\n")
    log = opened(write(tmp_path / "log.csv", content))
    assert any(re.search(warning, text) for text in log.warnings), log.warnings


def test_leaving_the_workspace_is_warned_of(tmp_path, clavel: Dynamics) -> None:
    robot = clavel.robot
    small = robot.workspace.changed(radius=1e-3)
    narrow = Dynamics(robot.changed(workspace=small))
    log = open_log(write(tmp_path / "log.csv", GOOD), narrow.kinematics)
    pattern = rf"{ROWS} of {ROWS} samples lie outside .* first in row 2 at \[.*\] m; likeliest"
    assert re.match(pattern, log.warnings[0])


def test_planned_motions_need_no_torques(tmp_path, clavel: Dynamics) -> None:
    for frame in (
        recorded(ROWS).drop(names("tau")),
        recorded(ROWS).with_columns(tau1=pl.lit(0.0), tau2=None),
    ):
        path = write(tmp_path / "log.csv", frame)
        assert not open_log(path, clavel.kinematics, need_torque=False).columns.torque
