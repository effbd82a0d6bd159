"""What the data itself says about a fit that cannot be right."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import IdentificationError
from deltaid.estimation.information import gather_samples
from deltaid.estimation.objective import Objective, Solution, Solver
from deltaid.estimation.posing import minimise
from deltaid.identification.fit import fit
from deltaid.identification.identify import identify
from deltaid.identification.signs import against_motion, contradiction
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.recording.recording import open_recordings
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from logs import names, recorded

SIGNS = "check the sign of these torques and positions"


PLAIN = Settings(friction="described", lag="none", compliance="none", effects="none", events=False)


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
    data = load_robot("clavel-delta3").model_dump(exclude_none=True) | {"friction": {}}
    dynamics = compiled(RobotDescription.model_validate(data))
    rng = np.random.default_rng(0)
    motion = random_motion(dynamics.kinematics, rng)
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, 500, endpoint=False))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, prior_parameters(dynamics.robot))
    tau = (tau + 0.05 * rng.standard_normal(tau.shape)) * [1, -1, 1]
    found = against_motion(dynamics, gather_samples(dynamics, z, qd, qdd, tau))
    assert [one.drive for one in found] == ["drive2"]
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
