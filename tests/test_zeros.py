"""What is said of a zero that is off and of a base out of level: numbers, units, cures."""

from functools import cache

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

from deltaid.check.evidence import Evidence, evidence
from deltaid.check.wiring.cures import Entries
from deltaid.check.wiring.homing import BLOCKS, Shifts
from deltaid.check.wiring.zeros import _good, _verdict
from deltaid.dynamics.geometry import across
from deltaid.model.verdict import Grade, Verdict
from deltaid.recording.mapping import ColumnMapping, DriveColumn
from deltaid.robot.load import load_robot

# A zero of 30 mrad (or mm), and a tilt of 10 mrad, whose direction is (0.6, 0.8).
ZERO, TILT = 0.03, (0.006, 0.008)
# What columns explain for each unit, and standard deviations of the zero and of the tilt.
H, OF_ZERO, OF_TILT = 100.0, 1e-3, 2e-3


@cache
def seen(name: str, unit: str) -> Evidence:
    t = np.arange(400) / 100.0
    moved = 0.1 * np.sin(2.0 * t)
    table = {"t": t} | {f"q{i}": moved / (np.pi / 180 if unit == "deg" else 1) for i in (1, 2, 3)}
    table |= {f"tau{i}": moved for i in (1, 2, 3)}
    columns = tuple(DriveColumn(column=f"q{i}", unit=unit) for i in (1, 2, 3))
    return evidence(load_robot(name), pl.DataFrame(table), ColumnMapping(position=columns))


def told() -> Shifts:
    """Of three drives; scores of blocks scatter as the standard deviations ask for."""
    means, signs = np.zeros(11), (-1.0) ** (np.arange(BLOCKS)[:, None] // [1, 1, 2, 1, 2])
    means[1], means[3:5] = ZERO, TILT
    scores = np.tile(H * means / BLOCKS, (BLOCKS, 1))
    # Of n blocks n s² / (n − k) is the variance of their sum, k the columns that are looked at.
    scores[:, 1] += signs[:, 1] * H * OF_ZERO * np.sqrt((BLOCKS - 1) / BLOCKS**2)
    scores[:, 3:5] += signs[:, 3:] * H * OF_TILT * np.sqrt((BLOCKS - 2) / BLOCKS**2)
    return Shifts(H * np.eye(11), scores, left=0.1, rows=1000, drives=3, angles=2)


def verdict(name: str = "clavel-delta3", unit: str = "rad", **which: bool) -> Verdict:
    looked_at, rivals = seen(name, unit), [1] if which["zero"] else [1, 2]
    way = -ZERO, 2 * OF_ZERO
    return _verdict(looked_at, told(), Entries(looked_at), rivals, way, grade=Grade.WRONG, **which)


def test_a_zero_that_is_off() -> None:
    found = verdict(zero=True, either=False)
    assert found.cause == "homing: a zero of drive2 that is 30 ± 2 mrad off"
    assert "explains 90 % of what is left" in found.seen
    assert (found.number, found.unit) == (pytest.approx(-30.0), "mrad")
    assert found.subject == "drive2"


@pytest.mark.parametrize(
    ("name", "unit", "zero"),
    [("clavel-delta3", "rad", ZERO), ("clavel-delta3", "deg", np.rad2deg(ZERO)),
     ("linear-delta", "mm", 1e3 * ZERO)],
)  # fmt: skip
def test_the_zero_that_is_proposed_is_in_the_unit_of_the_column(
    name: str, unit: str, zero: float
) -> None:
    """Joint values are 30 mrad too large: that much is to be taken off."""
    (proposal,) = verdict(name, unit, zero=True, either=False).proposals
    assert dict(proposal.changes) == {"position[1].zero": pytest.approx(zero, rel=1e-5)}


def test_a_zero_of_a_linear_drive_is_in_millimetres() -> None:
    found = verdict("linear-delta", "mm", zero=True, either=False)
    assert "a zero of drive2 that is 30 ± 2 mm off" in found.cause
    assert (found.number, found.unit) == (pytest.approx(-30.0), "mm")


def test_a_base_out_of_level() -> None:
    """Gravity is proposed as it is: of the same size, turned by 6 and 8 mrad about x and y."""
    found = verdict(zero=False, either=False)
    assert found.cause == "a tilted base: a base out of level by 10 ± 4 mrad"
    assert "explains 10 % of what is left" in found.seen
    assert (found.number, found.unit, found.subject) == (pytest.approx(10.0), "mrad", "")
    (proposal,) = found.proposals
    g = np.array(load_robot("clavel-delta3").gravity)
    turned = Rotation.from_rotvec(TILT @ across(g)).apply(g)
    # To five digits, and to first order in the tilt.
    np.testing.assert_allclose(dict(proposal.changes)["gravity"], turned, atol=1e-4)
    assert np.linalg.norm(dict(proposal.changes)["gravity"]) == pytest.approx(9.81, rel=2e-5)


def test_where_it_may_be_either_both_are_told() -> None:
    found = verdict(zero=False, either=True)
    zero = "a zero of drive2 that is 30 ± 2 mrad off (or one of drive3"
    assert "a base out of level by 10 ± 4 mrad, or " + zero in found.cause


def test_of_right_zeros_the_tilt_that_may_be_is_told() -> None:
    found = _good(told())
    assert found.seen.endswith("a tilt of 10 ± 4 mrad")
    assert found.number == pytest.approx(10.0)
