"""A zero that is off and a base out of level: how far they are, and what is said of them."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

from deltaid.checks.evidence import Evidence, evidence
from deltaid.checks.identify import identify
from deltaid.checks.wiring.residual import motion, residual
from deltaid.checks.wiring.search import explained
from deltaid.checks.wiring.wiring import checked_wiring
from deltaid.checks.wiring.zeros import BLOCKS, Shifts, _good, _verdict, _zero, shifts
from deltaid.dynamics.geometry import across
from deltaid.model.record import Settings
from deltaid.model.verdict import Grade, Verdict
from deltaid.recording.mapped_columns import DriveColumn
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.load import load_robot
from logs import tabled
from wired import bad, evidence_of, only_verdict, recorded, without

# A zero of 30 mrad (or mm), and a tilt of 10 mrad, whose direction is (0.6, 0.8).
ZERO, TILT = 0.03, (0.006, 0.008)
OFFSETS = Settings(lag="none", compliance="none", effects="none", events=False)
# What columns explain for each unit, and standard deviations of the zero and of the tilt.
H, OF_ZERO, OF_TILT = 100.0, 1e-3, 2e-3


@cache
def blank(name: str, unit: str) -> Evidence:
    t = np.arange(400) / 100.0
    moved = 0.1 * np.sin(2.0 * t)
    table = {"t": t} | {f"q{i}": moved / (np.pi / 180 if unit == "deg" else 1) for i in (1, 2, 3)}
    table |= {f"tau{i}": moved for i in (1, 2, 3)}
    columns = tuple(DriveColumn(column=f"q{i}", unit=unit) for i in (1, 2, 3))
    return evidence(load_robot(name), pl.DataFrame(table), ColumnMapping(position=columns))


def scores() -> Shifts:
    """Of three drives; scores of blocks scatter as the standard deviations ask for."""
    means, signs = np.zeros(11), (-1.0) ** (np.arange(BLOCKS)[:, None] // [1, 1, 2, 1, 2])
    means[1], means[3:5] = ZERO, TILT
    scores = np.tile(H * means / BLOCKS, (BLOCKS, 1))
    # Of n blocks n s² / (n − k) is the variance of their sum, k the columns that are looked at.
    scores[:, 1] += signs[:, 1] * H * OF_ZERO * np.sqrt((BLOCKS - 1) / BLOCKS**2)
    scores[:, 3:5] += signs[:, 3:] * H * OF_TILT * np.sqrt((BLOCKS - 2) / BLOCKS**2)
    return Shifts(H * np.eye(11), scores, squares=0.1, rows=1000, drives=3, angles=2)


def verdict(name: str = "clavel-delta3", unit: str = "rad", **which: bool) -> Verdict:
    empty, rivals = blank(name, unit), [1] if which["zero"] else [1, 2]
    way = -ZERO, 2 * OF_ZERO
    return _verdict(empty, scores(), rivals, way, grade=Grade.WRONG, **which)


@pytest.mark.parametrize(
    ("name", "unit", "unit_text"), [("clavel-delta3", "rad", "mrad"), ("linear-delta", "mm", "mm")]
)
def test_a_zero_that_is_off(name: str, unit: str, unit_text: str) -> None:
    found = verdict(name, unit, zero=True, either=False)
    assert found.cause == f"homing: a zero of drive2 that is 30 ± 2 {unit_text} off"
    assert "explains 90 % of the residual" in found.seen
    assert (found.number, found.unit) == (pytest.approx(-30.0), unit_text)
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


def test_a_base_out_of_level() -> None:
    """Gravity is proposed as it is: of the same size, turned by 6 and 8 mrad about x and y."""
    found = verdict(zero=False, either=False)
    assert found.cause == "a tilted base: a base out of level by 10 ± 4 mrad"
    assert "explains 10 % of the residual" in found.seen
    assert (found.number, found.unit, found.subject) == (pytest.approx(10.0), "mrad", "")
    (proposal,) = found.proposals
    g = np.array(load_robot("clavel-delta3").gravity)
    turned = Rotation.from_rotvec(TILT @ across(g)).apply(g)
    # To five digits, and to first order in the tilt.
    np.testing.assert_allclose(dict(proposal.changes)["gravity"], turned, atol=1e-4)
    assert np.linalg.norm(dict(proposal.changes)["gravity"]) == pytest.approx(9.81, rel=2e-5)


def test_where_it_may_be_either_both_are_reported() -> None:
    found = verdict(zero=False, either=True)
    zero = "a zero of drive2 that is 30 ± 2 mrad off (or one of drive3"
    assert "a base out of level by 10 ± 4 mrad, or " + zero in found.cause


def test_of_right_zeros_the_tilt_that_may_be_is_reported() -> None:
    found = _good(scores())
    assert found.seen.endswith("a tilt of 10 ± 4 mrad")
    assert found.number == pytest.approx(10.0)


def test_homing() -> None:
    columns = recorded("clavel-delta3")
    verdict = only_verdict("clavel-delta3", columns | {"q": columns["q"] + [0.0, 0.04, 0.0]})
    assert (verdict.key, verdict.grade) == ("homing-or-tilt", Grade.DOUBTFUL)
    assert "drive2" in verdict.subject
    assert dict(verdict.proposals[0].changes)["position[1].zero"] == pytest.approx(0.04, rel=0.1)
    assert (verdict.number, verdict.unit) == (pytest.approx(-40.0, rel=0.1), "mrad")
    value, half = re.findall(r"drive2 that is ([\d.]+) ± ([\d.]+) mrad off", verdict.cause)[0]
    assert abs(float(value) - 40.0) <= float(half)


def test_a_zero_has_twice_its_standard_deviation_as_interval() -> None:
    """Of slopes and scatter where it has been corrected."""
    rows = recorded("linear-delta")
    looked_at = evidence_of("linear-delta", rows | {"q": rows["q"] + [0.01, 0.0, 0.0]})
    fine, dynamics = motion(looked_at.rows), looked_at.dynamics
    assert fine is not None
    best = explained(dynamics, fine, fine)[0]
    value, half = _zero(looked_at, fine, best, shifts(dynamics, fine, best), 0)
    assert value == pytest.approx(-0.01, abs=half)
    corrected = residual(dynamics, fine, replace(best.map, shift=(value, 0.0, 0.0)))
    assert corrected is not None
    again = shifts(dynamics, fine, replace(best, residual=corrected))
    assert half == pytest.approx(2 * np.sqrt(again.estimate([0])[1][0, 0]))
    assert abs(again.estimate([0])[0][0]) < half


def test_tilt() -> None:
    columns = recorded("linear-delta-45", tilt=0.03)
    verdict = only_verdict("linear-delta-45", columns, cured=False)
    assert (verdict.key, verdict.subject) == ("homing-or-tilt", "")
    assert "out of level" in verdict.cause
    assert (verdict.number, verdict.unit) == (pytest.approx(30.0, abs=3.0), "mrad")
    gravity = dict(verdict.proposals[0].changes)["gravity"]
    assert gravity == pytest.approx([0, 9.81 * 0.03, -9.81], abs=0.05)


def test_zeros_are_inspected_again_beside_what_a_fit_has_corrected() -> None:
    name, columns = "linear-delta", recorded("linear-delta")
    pushed = columns | {"tau": columns["tau"] + [5.0, -5.0, 0.0]}  # like a base out of level
    (verdict,) = bad(checked_wiring(evidence_of(name, pushed)))
    assert (verdict.key, verdict.grade) == ("homing-or-tilt", Grade.DOUBTFUL)
    result = identify(load_robot(name), tabled(**without(pushed, "qd")), settings=OFFSETS)
    assert "offset" in " ".join(correction.text for correction in result.model.corrections)
    assert "homing-or-tilt" not in [verdict.key for verdict in bad(result.verdicts)]
    off = columns | {"q": columns["q"] + [0.01, 0.0, 0.0]}
    result = identify(load_robot(name), tabled(**without(off, "qd")), settings=OFFSETS)
    (zero,) = (verdict for verdict in bad(result.verdicts) if verdict.key == "homing-or-tilt")
    assert (zero.number, zero.unit) == (pytest.approx(-10.0, rel=0.1), "mm")


def test_zeros_that_are_far_off() -> None:
    columns = recorded("clavel-delta3")
    q = columns["q"] + np.array([0.0, 2.5, -2.5])
    verdicts = bad(checked_wiring(evidence_of("clavel-delta3", columns | {"q": q})))
    assert verdicts
    # Next to nothing is left of angles divided by 57, so that these explain gravity at least.
    assert ("angle-unit", Grade.WRONG) not in {(verdict.key, verdict.grade) for verdict in verdicts}
