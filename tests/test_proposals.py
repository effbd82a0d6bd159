"""Lines that verdicts propose for files: refitted, and kept where rows held out agree."""

from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
import polars as pl
import pytest

import deltaid
from checked import verdict_of
from deltaid.checks.evidence import Evidence, evidence
from deltaid.checks.proposals import HeldOut, confirmed, held_out, not_refuted
from deltaid.model.verdict import Grade, Proposal, Verdict
from drives import case
from identified import identified, simulated
from logs import tabled
from wired import recorded

LOG = "clavel-delta3"


def proposing(file: Literal["robot", "mapping"], key: str, value: object) -> Verdict:
    proposal = Proposal(file, ((key, value),))
    return Verdict("torque-sign", Grade.WRONG, "seen", proposals=(proposal,))


@cache
def shifted() -> Evidence:
    """A recording whose first position column is 20 mrad off."""
    found = identified(LOG)
    return evidence(found.robot, found.frames[0].with_columns(pl.col("q1") + 0.02))


def test_friction_by_load_is_no_zero_that_is_off() -> None:
    made = case("load-friction", "delta3", 1)
    homing = verdict_of(deltaid.check(made.robot, made.logs[0]), "homing-or-tilt")
    assert homing.grade is Grade.DOUBTFUL
    assert not homing.proposals
    assert "no change of the files explains this" in homing.cure


def test_a_verdict_that_rows_refute_hides_no_lag(monkeypatch: pytest.MonkeyPatch) -> None:
    """A proposal that rows refute is a doubt, beside which all other checks are made."""
    columns, of = recorded(LOG), "deltaid.checks.check.checked_wirings"
    refuted = replace(proposing("mapping", "torque[0].sign", -1), key="angle-unit")
    monkeypatch.setattr(of, lambda _: ((), [(refuted,)]))
    found = deltaid.check(LOG, tabled(**columns | {"tau": np.roll(columns["tau"], 3, axis=0)}))
    assert verdict_of(found, "torque-lag").grade is Grade.WRONG
    assert verdict_of(found, "angle-unit").grade is Grade.DOUBTFUL


def test_a_zero_that_is_off_is_proposed() -> None:
    found = deltaid.check(shifted().robot, shifted().source)
    (proposal,) = verdict_of(found, "homing-or-tilt").proposals
    ((key, value),) = proposal.changes
    assert key == "position[0].zero"
    np.testing.assert_allclose(float(str(value)), 0.02, atol=2e-3)


def test_a_base_far_out_of_level_is_inspected_and_not_written() -> None:
    found = identified(LOG)
    tilted = {"gravity": (0.0, 9.81 * np.sin(0.15), -9.81 * np.cos(0.15))}
    frame = simulated(found.robot.changed(**tilted), found.p, seed=3)
    verdict = verdict_of(deltaid.check(found.robot, frame), "homing-or-tilt")
    assert verdict.grade is not Grade.GOOD
    assert "base out of level" in verdict.seen
    assert not verdict.proposals


def test_what_does_not_help_is_dropped_and_no_longer_wrong() -> None:
    right = proposing("mapping", "position[0].zero", 0.02)
    wrong = proposing("mapping", "torque[1].sign", -1)
    kept, dropped = confirmed(shifted(), (right, wrong))
    assert kept is right
    assert not dropped.proposals
    assert dropped.grade is Grade.DOUBTFUL
    assert "no change of the files" in dropped.cure


def test_a_scale_of_all_torques_is_the_priors_to_judge() -> None:
    times = [(f"torque[{i}].unit", "mN*m") for i in range(3)]
    unit = Verdict("torque-unit", Grade.WRONG, "", proposals=(Proposal("mapping", tuple(times)),))
    assert confirmed(shifted(), (unit,)) == (unit,)


def test_a_description_is_changed_unless_it_explains_less() -> None:
    heavier = proposing("robot", "bodies.S.prior[0].mass", 0.2)
    tilted = proposing("robot", "gravity", [0.0, 3.0, -9.34])
    kept, dropped = not_refuted(shifted(), (heavier, tilted))
    assert kept is heavier
    assert not dropped.proposals


def errors(size: float, causes: tuple[int, ...] = (), plain: float = 1.5) -> HeldOut:
    """Of 40 stretches that scatter by a tenth; plain ones without causes."""
    scatter = 1.0 + 0.1 * np.random.default_rng(0).standard_normal((3, 40))
    return HeldOut(lambda chosen: (size if chosen else plain) * scatter, causes)


def test_errors_differ_beyond_chance_or_not() -> None:
    files = errors(1.0, (1,))
    assert not errors(1.0, (1,)).better(files)
    assert errors(0.8, (1,)).better(files)
    # As little of what explains the recording may be what first-order columns leave of it.
    assert not errors(0.8, (1,), plain=9.0).better(errors(1.0, (1,), plain=9.0))


def test_fewer_causes_explain_as_much() -> None:
    files = errors(1.0, (0, 1))
    assert errors(1.0, (), plain=1.0).better(files)
    assert not errors(1.0, (0, 1)).better(errors(1.0, (), plain=1.0))


def test_what_identify_corrects_unasked_is_in_the_fit() -> None:
    late = case("lag", "delta3", 1)
    error = held_out(evidence(late.robot, late.logs[0]))
    assert error.causes == (0,)


def test_drives_are_not_exchanged_by_friction_that_differs_by_direction() -> None:
    # The exchanged columns explain this recording better, while nothing is said of directions.
    made = case("direction", "delta4", 2)
    changes = [
        (f"{quantity}[{i}].column", f"{column}{2 - i}")
        for quantity, column in (("position", "q"), ("torque", "tau"))
        for i in (0, 1)
    ]
    proposal = Proposal("mapping", tuple(changes))
    exchanged = Verdict("drive-order", Grade.WRONG, "seen", proposals=(proposal,))
    (verdict,) = confirmed(evidence(made.robot, made.logs[0]), (exchanged,))
    assert verdict.grade is Grade.DOUBTFUL
    assert not verdict.proposals
