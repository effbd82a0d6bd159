"""What is warned of: logs that can be used and yet are doubtful, fits that no robot explains."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from bad_logs import GOOD, ROWS, changed, with_field
from deltaid.dynamics.dynamics import Dynamics
from deltaid.identification.identify import identify
from deltaid.recording.opening import open_log
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from logs import names, recorded, text, write

Torques = Callable[[np.ndarray, np.ndarray], np.ndarray]


@pytest.fixture
def warnings(tmp_path: Path) -> Callable[[Torques], tuple[str, ...]]:
    """Warnings of the fit to a recording whose torques are a function of τ and q̇, with noise."""
    frame = recorded(1500, derivatives=True)
    qd, tau = (frame.select(names(kind)).to_numpy() for kind in ("qd", "tau"))

    def of(changed: Torques, light: str = "") -> tuple[str, ...]:
        noisy = changed(tau, qd) * (1 + 0.01 * np.random.default_rng(0).standard_normal(tau.shape))
        columns = dict(zip(names("tau"), noisy.T, strict=True))
        log = write(tmp_path / "log.parquet", frame.with_columns(pl.from_dict(columns)))
        robot = load_robot("clavel-delta3")
        if light:
            data = robot.model_dump(mode="json", exclude_none=True)
            for shape in data["bodies"][light]["prior"]:
                shape["mass"] *= 0.1
            robot = RobotDescription.model_validate(data)
        return identify(robot, [log]).model.warnings

    return of


def test_a_healthy_recording_raises_no_doubts(warnings) -> None:
    assert warnings(lambda tau, _: tau) == ()


def test_noise_alone_raises_no_doubts(warnings) -> None:
    rng = np.random.default_rng(1)
    assert warnings(lambda tau, _: tau * (1 + 0.3 * rng.standard_normal(tau.shape))) == ()


def test_a_drive_that_friction_pushes_is_of_no_robot(warnings) -> None:
    (told,) = warnings(lambda tau, qd: tau - [4.0, 0.0, 0.0] * qd)
    assert "the torque error that is possible without physical consistency" in told


def test_torques_of_another_scale_are_told_with_it_and_not_by_what_had_to_grow(warnings) -> None:
    (told,) = warnings(lambda tau, _: 30 * tau)
    assert float(re.search(r"torques are ([\d.]+) times", told)[1]) == pytest.approx(30, rel=0.3)
    assert "unit, torque constant or gear" in told
    assert "had to grow" not in told


def test_a_mass_that_had_to_grow_is_named_where_nothing_better_is_known(warnings) -> None:
    """One body alone is far too light in its prior, so that torques are of the right scale."""
    (told,) = warnings(lambda tau, _: tau, light="U")
    assert re.match(r"U\.m had to grow from 0\.\d+ to \d", told)
    assert "the prior is too light" in told


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
