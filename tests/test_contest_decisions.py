"""What a contest of causes decides: which ends stand, what is unexplained, suspected or doubted."""

import re
from dataclasses import replace
from itertools import count
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.effect import Cause
from deltaid.effects.lag_columns import LagColumns
from deltaid.effects.lag_groups import LagGroup
from deltaid.estimation.causes import CauseColumns
from deltaid.estimation.shrinkage import Shrunk
from deltaid.identification import contest_stage, contest_sweeps
from deltaid.identification.contest import Contest
from deltaid.identification.contest_outcome import SUSPECTED, decided, doubted, refuted
from deltaid.identification.fit import fit
from deltaid.identification.friction_constants import LawConstants
from deltaid.identification.identify import _moves_of_laws
from deltaid.identification.setup import REFUTED, WIND_UP, ContestOutcome, Setup
from deltaid.identification.study import Study, left_of_a_drive
from deltaid.levels import SWEEPS
from deltaid.model.settings import Settings
from deltaid.robot.friction import Stribeck
from deltaid.robot.load import load_robot
from drives import case, mixture
from drives.absent import SPRINGS, without
from drives.identify import described as described_in
from drives.identify import identified
from drives.judge import judge

FORCES = {"platform-force", *SPRINGS}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "kind", "seed", "missing"),
    [
        ("askew", "delta4", 3, {"structure"}),
        ("falling-gain", "delta3", 0, {"torque-constant"}),
        ("ripple", "delta3", 0, {"ripple"}),
        ("spring", "delta3", 0, FORCES),
    ],
)
def test_a_cause_that_no_effect_is_of_ends_as_unexplained(
    row: str, kind: str, seed: int, missing: set[str]
) -> None:
    made = case(row, kind, seed)
    with without(missing):
        result = identified(made)
    others = {"contact", "friction", "lag", "prior", "temperature"}
    assert {correction.kind for correction in result.model.corrections} <= others
    (doubt,) = (text for text in result.model.warnings if "no known effect explains" in text)
    assert doubt.startswith(("unexplained: ", "something acts on the robot"))
    assert np.mean(judge(made, result).base) > 0.65  # 0.55 to 0.65 where others stand in


@pytest.mark.parametrize(
    ("place", "drift", "unexplained", "left"),
    [(0.02, 0.01, 0.0, 0.02), (0.02, 0.03, 0.0, 0.0), (0.02, 0.03, 0.01, 0.01), (0, 0.03, 0, 0)],
)
def test_what_a_contest_leaves_is_more_than_what_later_stages_leave_of_theirs(
    place: float, drift: float, unexplained: float, left: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = {"geometry-or-cogging": place, "drift": drift}
    causes = [
        Mock(spec=Cause, kind=kind, shares=np.array([0.0, size])) for kind, size in sizes.items()
    ]
    rest = Mock(part=unexplained, is_unexplained=True)
    monkeypatch.setattr("deltaid.identification.study.causes_of", lambda *_: causes)
    monkeypatch.setattr("deltaid.identification.study.rest_of_each_drive", lambda _: [rest])
    assert left_of_a_drive(Mock(spec=Study, fit=None, account=None)) == left


@pytest.mark.parametrize(
    ("noise", "why_not", "stands"),
    [(0.035, "", True), (0.045, "", False), (-1.0, "zero", False)],  # 1.96 · 0.02 is 0.039
)
def test_another_end_stands_if_it_leaves_no_more_but_for_chance(
    noise: float, why_not: str, stands: bool
) -> None:
    robot = load_robot("clavel-delta3")
    setup, outcome = Setup(robot, (), Settings()), ContestOutcome(robot)
    last, other = (
        Mock(spec=Contest, noise=n, shrunk=Mock(spec=Shrunk, noise_spread=0.02))
        for n in (0.0, noise)
    )
    end = contest_sweeps.Sweeps(
        setup, outcome, last, last, np.zeros(0), (), frozenset(), "length", False
    )
    other = replace(end, last=other, why_not=why_not)
    assert contest_stage._is_better(other, end) == stands


def test_a_setup_that_has_been_through_a_contest_stays_as_it_is() -> None:
    """Where a load is detected, a contest takes place before the stage."""
    robot = load_robot("clavel-delta3")
    setup = Setup(robot, (), Settings(), outcome=ContestOutcome(robot))
    assert contest_stage.contested(setup, pytest.fail) is setup  # which says nothing either


@pytest.mark.parametrize(
    ("decades", "size", "may", "applied", "winds_up"),
    [(10.0, 1e-3, True, False, True), (10.0, 1e-3, False, True, True),
     (10.0, 1e-3, False, False, False), (1.0, 1e-3, True, True, False),
     (10.0, 1e-4, True, True, False)],
)  # fmt: skip
def test_gears_found_stiff_among_rows_that_compliant_ones_leave_stay_so(
    decades: float, size: float, may: bool, applied: bool, winds_up: bool
) -> None:
    robot = load_robot("clavel-delta3")
    group = CauseColumns(WIND_UP, np.arange(3), np.ones(3), np.zeros(3))
    shrunk = Mock(spec=Shrunk, candidates=(), x=np.array([1e-5, 2e-5, 3e-5]), covariance=np.eye(3))
    shrunk.surprise.return_value, shrunk.level.return_value = decades, 1.0
    shrunk.deviation.return_value, shrunk.size.return_value = np.full(3, 1e-6), size
    last = Mock(spec=Contest, shrunk=shrunk, points=())
    last.group.return_value = group
    values = {WIND_UP: np.full(3, 1e-5)} if applied else {}
    outcome = decided(ContestOutcome(robot, values=values), last, may_wind_up=may)
    assert outcome.winds_up is winds_up


def test_sweeps_go_on_until_they_settle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torque constants that fall beside friction that warms up need some thirty."""
    sweeps = list[ContestOutcome]()

    def settled_late(before: ContestOutcome, after: ContestOutcome) -> bool:
        if not any(after is outcome for outcome in sweeps):
            sweeps.append(after)
        return len(sweeps) == SWEEPS + 3

    monkeypatch.setattr(contest_sweeps, "is_settled", settled_late)
    identified(case("clean", "delta3"))
    first = sweeps[: SWEEPS + 3]
    assert [outcome.winds_up for outcome in first] == [False] * (SWEEPS + 3)


def test_sweeps_that_alternate_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names of ripples hold their orders, of which two may take turns."""
    robot, number = load_robot("clavel-delta3"), count()
    zero = np.zeros(1)
    sweep = Mock(spec=Contest, p=zero, points=[Mock(p=zero)])
    sweep.shrunk = Mock(spec=Shrunk, candidates=())
    sweep.reduced.return_value = sweep

    def alternating(before: ContestOutcome, *_: Contest, may_wind_up: bool) -> ContestOutcome:
        return replace(before, kept=(f"ripple of drive1, 12.0{next(number) % 2}",))

    for name, stub in {
        "decided": alternating, "traces_of": lambda setup: [None], "_swept": lambda *_: sweep,
        "_unbarred": lambda *_: (),
        "with_readings": lambda setup, *_: setup, "doubted": lambda outcome, *_: outcome,
        "_judged": lambda bare, end, fast: end,
    }.items():  # fmt: skip
        monkeypatch.setattr(contest_sweeps, name, stub)
    contest_sweeps.sweeps(Setup(robot, (), Settings()))
    assert next(number) == 3


def test_effects_that_sweeps_dropped_may_act_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where many sweeps had only kept effects; those that explain nothing do not."""
    odds = list[dict[str, float]]()

    def spied(outcome: ContestOutcome, full: Contest, last: Contest) -> ContestOutcome:
        suspects = full.suspects(last)
        odds.append({name: suspect.odds(last) for name, suspect in suspects.items()})
        assert set(last.shrunk.candidates) <= set(outcome.kept)
        return doubted(outcome, full, last)

    monkeypatch.setattr(contest_sweeps, "doubted", spied)
    identified(case("falling-gain", "delta3"))
    for of_effect in odds:
        assert all(abs(of_effect[name]) < 3 for name in ("tilt", "length", "gear-ratio"))


@pytest.mark.slow
def test_torque_constants_that_are_not_certain_widen_intervals() -> None:
    """Ripples as long as the stroke hide them from the scatter of stretches."""
    made = case("realistic", "linear")
    judged = judge(made, identified(made))
    assert np.mean(judged.base) > 0.9  # 69 % without dropped effects
    assert any("torque constant" in text and "may also act" in text for text in judged.texts)


def test_gears_become_compliant_in_the_first_sweeps_only(monkeypatch: pytest.MonkeyPatch) -> None:
    flags = list[str]()

    def spied(*args: Any, may_wind_up: bool) -> ContestOutcome:
        flags.append("may " if may_wind_up else "keep ")
        return decided(*args, may_wind_up=may_wind_up)

    monkeypatch.setattr(contest_sweeps, "decided", spied)
    identified(case("falling-gain", "delta3"))
    assert re.fullmatch("((may ){2}(keep )+)+", "".join(flags))


def test_intervals_count_described_laws_where_a_cause_is_unexplained() -> None:
    """Chosen ones may stand for a part of it; columns of torques go with the laws."""
    result = identified(case("clean", "delta3"))
    robot, plain = result.robot, Settings(lag="none", friction="described")
    more = Stribeck(coefficient=0.1, speed=0.3)
    laws = {drive: law.changed(load=0.02, stribeck=more) for drive, law in robot.friction.items()}
    dynamics = compiled(robot.changed(friction=laws))
    p = dict(zip(result.problem.layout.names, result.problem.p.tolist(), strict=False))
    p = np.array([p.get(name, 0.0) for name in dynamics.layout.names])
    constants = LawConstants(dynamics)
    late = LagColumns(
        dynamics, (constants,), np.pad(p, (0, len(constants.parameters))), result.recordings[0],
        (LagGroup((0, 1, 2), 0.0),)
    )  # fmt: skip
    outcome = ContestOutcome(robot, doubts={REFUTED: "something acts on the robot"})
    setup = Setup(dynamics.robot, result.recordings, plain, (late,), outcome=outcome)
    problem = fit(setup.dynamics, setup.recordings, plain, additions=setup.additions)
    (move,) = _moves_of_laws(setup, robot.friction, problem)
    moved = dict(zip(setup.dynamics.layout.names, problem.p + list(move.values()), strict=True))
    late = replace(late, dynamics=compiled(robot), others=(), p=result.problem.p)
    expected = fit(compiled(robot), setup.recordings, plain, additions=(late,))
    names = expected.dynamics.layout.names
    assert [moved.pop(name) for name in names] == pytest.approx(expected.p.tolist(), abs=1e-12)
    assert set(moved.values()) == {0.0}
    explained = setup.changed(outcome=ContestOutcome(robot))
    assert not _moves_of_laws(explained, robot.friction, problem)


@pytest.mark.slow
def test_a_wrong_gear_ratio_is_not_mistaken_for_lengths_or_a_load(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Far from where it is, slopes of its effect leave what lengths at their bound, or a load of
    40 g that comes and goes, explain better. A share common to all ratios is hardly identifiable:
    errors of lengths imitate it."""
    monkeypatch.setitem(mixture.MIXED, "falling-gain", (lambda made, *_: made, 1.0, 2.0))
    made = case("mixture", "par4", 1)
    result = identified(made)
    corrections = result.model.corrections
    first, *others = [
        c.value for c in corrections if c.kind == "gear-ratio" and c.value is not None
    ]
    assert first - np.mean(others) == pytest.approx(-0.5, abs=0.03)
    assert others == pytest.approx([0.0, 0.0, 0.0], abs=0.1)
    assert not {c.kind for c in corrections} & {"length", "load"}
    assert judge(made, result).M < 0.005


@pytest.mark.parametrize("limb_lengths", ["all", "strut"])
def test_what_is_stated_to_be_off_is_not_dropped(limb_lengths: str) -> None:
    """Zeros and lengths are stated to be off by more than usual; zeros alone explain most."""
    made = case("homing", "delta3", 0)
    if limb_lengths == "strut":
        robot = described_in(made)
        stated = robot.tolerances.changed(lengths={"strut": robot.tolerances.of_length("strut")})
        made = replace(made, robot=robot.changed(tolerances=stated), tells=())
    result = identified(made)
    kinds = {correction.kind for correction in result.model.corrections}
    assert kinds == {"zero", "length"}
    assert judge(made, result).M < 0.004


@pytest.mark.slow
def test_what_is_within_parts_stands_in_place_of_what_is_not() -> None:
    """Zeros are beyond what parts are off by, where sweeps lead to what no robot can reach; dry
    friction of the platform steps elsewhere than described."""
    made = case("homing-0.3", "h4", 7)
    result = identified(made)
    kinds = {correction.kind for correction in result.model.corrections}
    assert "zero" in kinds
    assert not kinds & {"length", "ripple", *FORCES, "platform-spring"}
    assert judge(made, result).M < 0.005


@pytest.mark.parametrize(
    ("parts", "lost", "expected"),
    [
        ({"length", "zero"}, set(), [-2.0, -1.5, -1.0]),
        ({"length", "zero"}, {"length"}, [-2.0, -1.0]),
        ({"length"}, set(), [-1.5]),
        ({"length"}, {"length"}, []),
        (set(), {"length"}, []),
    ],
)
def test_sweeps_are_repeated_without_errors_of_parts_least_noise_first(
    parts: set[str], lost: set[str], expected: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without all errors -1.0 is left, without lengths -1.5, without zeros -2.0."""
    robot = load_robot("clavel-delta3")
    bare = Setup(robot, (), Settings())
    noise = {frozenset({"length"}): -1.5, frozenset({"zero"}): -2.0}

    def swept(_: Setup, barred: frozenset[str]) -> contest_sweeps.Sweeps:
        last = Mock(spec=Contest, noise=noise.get(barred, -1.0))
        return contest_sweeps.Sweeps(
            bare, ContestOutcome(robot), last, last, np.zeros(0), (), frozenset(parts), "",
            is_lost=barred == lost,
        )  # fmt: skip

    monkeypatch.setattr(contest_stage, "sweeps", swept)
    ends = contest_stage._barred(bare, frozenset(parts))
    assert [end.last.noise for end in ends] == expected


@pytest.mark.parametrize(("odds", "weight"), [(100.0, 1.0), (0.0, np.sqrt(1 / 3)), (-100.0, 0.0)])
def test_a_suspect_is_named_and_intervals_count_it(odds: float, weight: float) -> None:
    """By what parameters move by with it, and with its coefficients as they may be, as far as it is
    probable of two; only one that is certain is named."""
    robot = load_robot("clavel-delta3")
    names, fitted = compiled(robot).layout.names, prior_parameters(robot)
    moved, more = np.zeros((2, len(names)))
    moved[3], more[5] = 0.02, 0.01
    last = Mock(spec=Contest, estimate=fitted)
    last.named.side_effect = compiled(robot).layout.named
    last.follows.return_value, last.unexplained_torques.return_value = [], None
    shrunk = Mock(spec=Shrunk)
    shrunk.surprise.return_value = 4.0
    suspect = Mock(spec=Contest, estimate=fitted + moved, shrunk=shrunk)
    suspect.follows.return_value = [more]
    suspect.odds.return_value, suspect.is_certain.return_value = odds, odds > 0
    full = Mock(spec=Contest)
    full.rivals.return_value = {}
    other = Mock(spec=Contest, estimate=fitted)
    other.follows.return_value, other.odds.return_value = [], -np.inf
    other.is_certain.return_value = False
    full.suspects.return_value = {"drive-spring": suspect, "ripple": other}
    before = ContestOutcome(robot, doubts={"tilt": "leans", SUSPECTED: "of sweeps before"})
    outcome = doubted(before, full, last)
    assert outcome.doubts["tilt"] == "leans"
    named = "springs at drives may also act: chance explains as much in one of 10,000 "
    assert (named in outcome.doubts.get(SUSPECTED, "")) == (odds > 0)
    by_suspect, by_coefficients, by_other = (
        np.array([move[name] for name in names]) for move in outcome.moves
    )
    assert not by_other.any()
    assert by_suspect == pytest.approx(weight * moved, abs=1e-12)
    assert by_coefficients == pytest.approx(weight * more, abs=1e-12)
    full.suspects.return_value = {}
    assert doubted(outcome, full, last).doubts == {"tilt": "leans"}
    assert SUSPECTED not in refuted(outcome, "zeros are", []).doubts
    # 10⁸⁶⁶ is no floating-point number.
    full.suspects.return_value, shrunk.surprise.return_value = {"drive-spring": suspect}, 866.0
    rare = doubted(before, full, last).doubts.get(SUSPECTED, "")
    assert ("in one of more than 1,000,000,000 recordings" in rare) == (odds > 0)


def test_intervals_count_gains_that_rows_do_not_decide() -> None:
    """Torque constants 1 to 2 % off change a linear Delta's torques hardly more than chance."""
    made = case("mixture", "linear", 103)
    result = identified(made)
    assert "gain" not in {correction.kind for correction in result.model.corrections}
    assert np.mean(judge(made, result).base) > 0.8  # 0.69 without
