"""What the data itself says about a fit that cannot be right."""

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import IdentificationError
from deltaid.identification.identify import identify
from deltaid.identification.information import gather_samples
from deltaid.identification.signs import against_motion, told
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from logs import names, recorded, write

SIGNS = "check the sign of these torques and positions"


def identified(folder: Path, *flipped: str, settings: Settings | None = None) -> IdentifiedModel:
    frame = recorded(1500, derivatives=True).with_columns(*(-pl.col(name) for name in flipped))
    log = write(folder / "log.csv", frame)
    return identify(load_robot("clavel-delta3"), [log], settings=settings).model


def test_right_signs_are_not_doubted(tmp_path: Path) -> None:
    assert identified(tmp_path).warnings == ()


@pytest.mark.parametrize("drive", [1, 3])
def test_a_drive_with_the_wrong_sign_of_torque_is_named(tmp_path: Path, drive: int) -> None:
    warning = identified(tmp_path, f"tau{drive}").warnings[0]
    assert SIGNS in warning
    assert re.findall(r"drive\d", warning) == [f"drive{drive}"]
    assert re.search(r"inertia of -0\.\d+ kg m² and a friction of -\d", warning)


def test_a_drive_with_the_wrong_sign_of_its_motion_is_named(tmp_path: Path) -> None:
    text = " ".join(identified(tmp_path, "q2", "qd2", "qdd2").warnings)
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
    assert "friction" not in told(found, dynamics.robot)


@pytest.mark.parametrize(
    "settings", [Settings(gamma=1e-13), Settings(gamma=1e-12, regularizer="entropic")]
)
def test_a_solver_that_fails_on_wrong_signs_does_not_ask_for_gamma(
    tmp_path: Path, settings: Settings
) -> None:
    with pytest.raises(IdentificationError, match="drive1, drive2, drive3 contradict") as caught:
        identified(tmp_path, *names("tau"), settings=settings)
    assert caught.value.where == str(tmp_path / "log.csv")
    assert SIGNS in caught.value.cure
    assert "gamma" not in str(caught.value)
