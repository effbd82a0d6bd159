"""What is warned of: doubtful logs, signs that are wrong, fits that no robot explains."""

import re
from collections.abc import Callable
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import polars as pl
import pytest

from bad_logs import GOOD, ROWS, changed, with_field
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.unexplained import FreeTorque
from deltaid.errors import IdentificationError
from deltaid.estimation.conic import minimise
from deltaid.estimation.information import gather_samples
from deltaid.estimation.objective import Objective, Solution, Solver
from deltaid.identification.doubts import doubts
from deltaid.identification.fit import against_motion, contradiction, fit
from deltaid.identification.identify import identify
from deltaid.model.record import Settings
from deltaid.recording.opening import open_log
from deltaid.recording.recording import open_recordings
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from logs import names, recorded, text, write
from poor_priors import PLAIN
from support import along

Torques = Callable[[np.ndarray, np.ndarray], np.ndarray]


def warnings_of(changed: Torques, light: str = "", gamma: float | None = None) -> tuple[str, ...]:
    """Warnings of the fit to a recording whose torques are a function of τ and q̇, with noise."""
    frame = recorded(1500, derivatives=True)
    qd, tau = (frame.select(names(kind)).to_numpy() for kind in ("qd", "tau"))
    noisy = changed(tau, qd) * (1 + 0.01 * np.random.default_rng(0).standard_normal(tau.shape))
    columns = dict(zip(names("tau"), noisy.T, strict=True))
    robot = load_robot("clavel-delta3")
    if light:
        data = robot.model_dump(mode="json", exclude_none=True)
        for shape in data["bodies"][light]["prior"]:
            shape["mass"] *= 0.1
        robot = RobotDescription.model_validate(data)
    frame = frame.with_columns(pl.from_dict(columns))
    return identify(robot, frame, settings=Settings(gamma=gamma)).model.warnings


def test_a_healthy_recording_raises_no_doubts() -> None:
    assert warnings_of(lambda tau, _: tau) == ()


def test_noise_alone_raises_no_doubts() -> None:
    rng = np.random.default_rng(1)
    assert warnings_of(lambda tau, _: tau * (1 + 0.3 * rng.standard_normal(tau.shape))) == ()


def test_a_drive_that_friction_pushes_is_of_no_robot() -> None:
    (warning,) = warnings_of(lambda tau, qd: tau - [4.0, 0.0, 0.0] * qd)
    assert "the torque error that is possible without physical consistency" in warning


def test_a_prior_that_is_asked_to_weigh_much_is_the_likeliest_cause_of_a_poor_fit() -> None:
    warnings = warnings_of(lambda tau, _: tau, light="U", gamma=1.0)
    assert any("the given γ of 1 weighs the prior too much" in text for text in warnings)
    assert not any("only negative masses" in text for text in warnings)


def test_torques_of_another_scale_are_reported_with_it_and_not_by_what_had_to_grow() -> None:
    (warning,) = warnings_of(lambda tau, _: 30 * tau)
    assert float(re.search(r"torques are ([\d.]+) times", warning)[1]) == pytest.approx(30, rel=0.3)
    assert "unit, torque constant or gear" in warning
    assert "had to grow" not in warning


def test_a_mass_that_had_to_grow_is_named_where_nothing_better_is_known() -> None:
    """One body alone is far too light in its prior, so that torques are of the right scale."""
    (warning,) = warnings_of(lambda tau, _: tau, light="U")
    assert re.match(r"U\.m had to grow from 0\.\d+ to \d", warning)
    assert "the prior is too light" in warning


def test_a_mass_that_grew_beside_what_is_unexplained_is_no_wrong_prior() -> None:
    frame = recorded(1500, derivatives=True)
    data = load_robot("clavel-delta3").model_dump(mode="json", exclude_none=True)
    for shape in data["bodies"]["U"]["prior"]:
        shape["mass"] *= 0.1
    problem = identify(RobotDescription.model_validate(data), frame).problem
    (doubt,) = doubts(replace(problem, additions=(Mock(spec=FreeTorque, is_held=False),)))
    assert "U.m had to grow" in doubt
    assert "mistaken for these moments" in doubt
    assert "prior" not in doubt


SWAPPED = recorded(1500, derivatives=True).rename({"qd1": "qd2", "qd2": "qd1"})


@pytest.mark.parametrize(
    ("content", "warning"),
    [
        (changed(q1=pl.lit(0.1)), "column q1 is constant"),
        ("Scope\n" + GOOD, "row 2 is taken for the column names"),
        (GOOD + "END\n", r"ends with text after its data \('END'\)"),
        (GOOD.replace("\n", "\ns,rad,rad,rad,Nm,Nm,Nm\n", 1), r"row 2 is taken for units \(s, rad"),
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


SIGNS = "check the sign of these torques and positions"


def flipped(*columns: str) -> pl.DataFrame:
    return recorded(1500, derivatives=True).with_columns(*(-pl.col(name) for name in columns))


def warned(*columns: str) -> tuple[str, ...]:
    return identify(load_robot("clavel-delta3"), flipped(*columns), settings=PLAIN).model.warnings


def test_right_signs_are_not_doubted() -> None:
    assert warned() == ()


@pytest.mark.parametrize("drive", [1, 3])
def test_a_drive_with_the_wrong_sign_of_torque_is_named(drive: int) -> None:
    warning = warned(f"tau{drive}")[0]
    assert SIGNS in warning
    assert re.findall(r"drive\d", warning) == [f"drive{drive}"]
    assert re.search(r"inertia of -0\.\d+ kg m² and a friction of -\d", warning)


def test_a_drive_with_the_wrong_sign_of_its_motion_is_named() -> None:
    text = " ".join(warned("q2", "qd2", "qdd2"))
    assert "motion of drive2 contradict" in text


def test_inertia_alone_tells_where_there_is_no_friction() -> None:
    dynamics = compiled(load_robot("clavel-delta3").changed(friction={}))
    rng = np.random.default_rng(0)
    z, _, qd, qdd = along(dynamics.kinematics, rng, 500)
    tau = dynamics.torque(z, qd, qdd, prior_parameters(dynamics.robot))
    tau = (tau + 0.05 * rng.standard_normal(tau.shape)) * [1, -1, 1]
    found = against_motion(dynamics, gather_samples(dynamics, z, qd, qdd, tau))
    assert [ripple.drive for ripple in found] == ["drive2"]
    assert "friction" not in contradiction(found, dynamics.robot)


def stopped(objective: Objective, solver: Solver) -> Solution:
    """The solver's own end where no certificate is good enough."""
    return minimise(objective, replace(solver, largest_gap=-1.0))


def outside(objective: Objective, solver: Solver) -> Solution:
    """An end outside the cone, as rounding may leave one where masses grow beyond measure."""
    return replace(minimise(objective, solver), x=-objective.reduction.prior)


@pytest.mark.parametrize("end", [stopped, outside])
def test_a_solver_that_fails_on_wrong_signs_does_not_ask_for_gamma(
    monkeypatch: pytest.MonkeyPatch, end: Callable[[Objective, Solver], Solution]
) -> None:
    """Whether it fails by itself, rounding decides; with right signs the same end asks for it."""
    monkeypatch.setattr("deltaid.identification.fit.minimise", end)
    dynamics, settings = compiled(load_robot("clavel-delta3")), Settings(gamma=1e-4)
    right, wrong = (
        open_recordings(flipped(*which), dynamics.kinematics) for which in ((), names("tau"))
    )
    with pytest.raises(IdentificationError, match="larger --gamma"):
        fit(dynamics, right, settings)
    with pytest.raises(IdentificationError, match="drive1, drive2, drive3 contradict") as caught:
        fit(dynamics, wrong, settings)
    assert caught.value.where == str(wrong[0].path)
    assert SIGNS in caught.value.cure
    assert "gamma" not in str(caught.value)


@pytest.mark.parametrize("rows", [(), (700,), (700, 1200)])
def test_a_plan_that_jumps_is_warned_of_with_row_and_size(rows: tuple[int, ...]) -> None:
    size = np.sum([0.01 * (1 + (row > 1000)) * (np.arange(1500) >= row) for row in rows], axis=0)
    plan = recorded().select(*names("t", "q")).with_columns(q2=pl.col("q2") + size)
    kinematics = compiled(load_robot("clavel-delta3")).kinematics
    warned = [
        text for text in open_log(plan, kinematics, need_torque=False).warnings if "jumps" in text
    ]
    expected = {
        (700,): "0.01 rad at row 701;",
        (700, 1200): "0.02 rad at row 1201, the largest of 2",
    }
    assert len(warned) == bool(rows)
    assert all(f"column q2 jumps by {expected[rows]}" in text for text in warned)
