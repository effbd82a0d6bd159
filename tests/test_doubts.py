"""What a fit says of recordings that no consistent robot explains, and of healthy ones nothing."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.identification.identify import identify
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from logs import names, recorded, write

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
