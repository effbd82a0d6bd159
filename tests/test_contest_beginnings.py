"""From which beginnings sweeps of the contest are repeated, and which end stands."""

from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.point import points_of
from deltaid.effects.windings import Windup
from deltaid.estimation.drive_rows import TraceRows
from deltaid.estimation.shrinkage import Shrunk
from deltaid.identification import contest_stage, contest_sweeps, stages
from deltaid.identification.contest import Contest, contest
from deltaid.identification.contest_applied import without_contest
from deltaid.identification.contest_sweeps import Sweeps
from deltaid.identification.setup import WIND_UP, ContestOutcome, Setup
from deltaid.model.record import Settings
from deltaid.recording.masks.masks import Mask
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.repairs import Gears, Repairs
from deltaid.robot.load import load_robot
from drives import case
from drives.identify import identified
from drives.judge import judge
from test_lag import frame, traced

ROBOT = load_robot("clavel-delta3")
BARE = Setup(ROBOT, (), Settings())
SOFT = Gears((1e-4,) * 3, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, 30.0)


def ended(noise: float, why_not: str = "", *, winds_up: bool = False, kept: str = "zero") -> Sweeps:
    """The end of sweeps that leave this noise, 0.02 of it by chance."""
    last = Mock(spec=Contest, noise=noise, shrunk=Mock(spec=Shrunk, noise_spread=0.01))
    last.unexplained.return_value = ()
    values = {WIND_UP: np.ones(3)} if winds_up else {}
    outcome = ContestOutcome(ROBOT, tuple(kept.split()), values, values)
    return Sweeps(BARE, outcome, last, last, np.zeros(0), (), frozenset(), why_not, is_lost=False)


@pytest.mark.parametrize(
    ("kept", "noise", "why_not", "stands"),
    [
        ("zero", -2.99, "", True),  # as little, up to chance
        ("zero", -2.97, "", False),
        ("zero", -3.1, "length", False),
        ("", -3.1, "", False),  # compliance alone may not mimic what is not there
    ],
)
def test_gears_stay_stiff_where_that_leaves_no_more_noise(
    kept: str, noise: float, why_not: str, stands: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    end, stiff = ended(-3.0, winds_up=True, kept=kept), ended(noise, why_not)

    def swept(_: Setup, *, may_wind_up: bool) -> Sweeps:
        assert not may_wind_up
        return stiff

    monkeypatch.setattr(contest_stage, "sweeps", swept)
    assert contest_stage._without_windup(BARE, end) is (stiff if stands else end)


def test_gears_that_were_compliant_before_stay_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contest_stage, "sweeps", pytest.fail)
    recording = Mock(spec=PreparedRecording, repairs=Repairs(gears=SOFT))
    end = ended(-3.0, winds_up=True)
    bare = BARE.changed(recordings=(recording,))
    assert contest_stage._without_windup(bare, end) is end
    stiff = ended(-3.0)
    assert contest_stage._without_windup(BARE, stiff) is stiff


def test_compliances_agree_with_others_within_chance() -> None:
    """Those of all rows count unless fast rows of passive joints contradict them."""
    groups = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    covariance = np.diag([1e-6, 4e-6]) ** 2
    sizes = np.array([2e-4, 1e-4])
    certain = Windup(groups @ sizes, groups, sizes, covariance, 0 * sizes, np.zeros(0))
    for change, agrees in (
        ([4e-6, -4e-6, 19e-6], True),
        ([6e-6, 0.0, 0.0], False),
        ([0.0, -6e-6, 0.0], False),
        ([0.0, 0.0, 21e-6], False),
    ):
        assert certain.agrees(certain.values + change) is agrees


@pytest.mark.parametrize(
    ("cutoff", "reason", "sharp"),
    [
        (None, "saturated torque", True),
        (None, "standing still", False),
        (12.0, "saturated torque", False),
    ],
)
def test_recordings_with_saturated_torques_are_fitted_at_a_higher_cutoff(
    cutoff: float | None, reason: str, sharp: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    masks = [Mock(spec=Mask, reason=reason)]
    recording = Mock(
        spec=PreparedRecording, repairs=Repairs(), low_pass=Mock(), log=Mock(masks=masks)
    )
    sharper = recording.changed.return_value = Mock(spec=PreparedRecording)
    monkeypatch.setattr(stages, "cutoff_of", lambda _: 50.0)
    setup = Setup(ROBOT, (recording,), Settings(cutoff=cutoff))
    assert stages.sharpened(setup, pytest.fail).recordings == (sharper if sharp else recording,)
    assert recording.changed.call_args_list == [((50.0,),)] * sharp


@pytest.mark.parametrize(
    ("refuted", "turns", "noise", "refuted_from_fast", "begins_fast"),
    [
        ("", (0.3,), -3.7, "", False),
        ("length", (0.3,), -3.7, "", True),
        ("length", (0.3,), -3.68, "", False),  # more than half of the noise
        ("length", (0.3,), -3.7, "zero", False),
        ("length", (), -3.7, "", False),  # no passive joint has friction
    ],
)
def test_a_refuted_result_is_tried_again_where_passive_joints_are_fast(
    refuted: str,
    turns: tuple[float, ...],
    noise: float,
    refuted_from_fast: str,
    begins_fast: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    over_all, from_fast = ended(-3.0, refuted), ended(noise, refuted_from_fast)

    def swept(_: Setup, **begin: Any) -> Sweeps:
        assert begin in ({}, {"turns": (0.3,)})
        return from_fast if begin else over_all

    monkeypatch.setattr(contest_stage, "sweeps", swept)
    monkeypatch.setattr(contest_stage, "usual_turns", lambda _: turns)
    expected = from_fast if begins_fast else over_all
    assert contest_stage._from_certain_turns(BARE) is expected


@pytest.mark.parametrize(
    ("refuted", "noise", "refuted_beside", "takes_part"),
    [
        ("", -2.99, "", True),  # as little, up to chance
        ("", -2.97, "", False),
        ("", -3.1, "mounting", False),
        ("length", -2.99, "", True),
        ("length", -2.99, "mounting", False),
        ("length", -3.01, "mounting", True),  # further sweeps begin elsewhere
    ],
)
def test_mounting_takes_part_where_it_leaves_less_noise(
    refuted: str,
    noise: float,
    refuted_beside: str,
    takes_part: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    end, beside = ended(-3.0, refuted), ended(noise, refuted_beside)
    end.full.needs.return_value = True
    ends = {frozenset({"mounting"}): end, frozenset(): beside}
    monkeypatch.setattr(
        contest_stage, "_from_certain_turns", lambda setup: ends[setup.barred_effects]
    )
    stands, setup = contest_stage._with_late(BARE)
    assert stands is (beside if takes_part else end)
    assert ("mounting" in setup.barred_effects) is not takes_part


def test_excluded_rows_do_not_change_the_noise() -> None:
    """So noise can be compared between sweeps that exclude different rows."""
    record, noise = traced(frame(np.zeros(3))), list[float]()
    (run,) = record.stretches
    half = run.weights * (np.arange(len(run.time)) % 1000 < 500)[:, None]
    p, rows = prior_parameters(ROBOT), TraceRows.for_dynamics(record.dynamics, (), 1.0)
    for weights in (run.weights, half):
        part = replace(record, stretches=(replace(run, weights=weights),))
        swept = contest(rows, points_of([part], p), (), {})
        noise.append(swept.noise)
    assert abs(noise[1] - noise[0]) < 3 * swept.shrunk.noise_spread < 0.15  # half is 0.35


def test_behind_compliant_gears_only_fast_rows_count_to_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If sweeps began with these; otherwise errors of the speeds decide, as behind stiff gears."""
    par4, last = Setup(load_robot("par4"), (), Settings()), Mock(spec=Contest)
    monkeypatch.setattr(contest_sweeps, "speed_errors", lambda *_: (0.1,))
    soft, stiff = (ended(0.0, winds_up=winds_up).outcome for winds_up in (True, False))
    for fast, after, expected in (
        ((0.3,), soft, (0.3,)), ((), soft, (0.1,)), ((0.3,), stiff, (0.1,)),
    ):  # fmt: skip
        assert contest_sweeps._turns(par4, fast, last, after, {}, {}) == expected
    assert contest_sweeps._turns(BARE, (), last, soft, {}, {}) == ()  # nothing passive has friction


def test_another_contest_begins_with_rows_beside_reversals() -> None:
    recording = Mock(spec=PreparedRecording, repairs=Repairs(turns=(0.3,)))
    recording.repaired.return_value = recording
    without_contest(Setup(ROBOT, (recording,), Settings()))
    assert recording.repaired.call_args.kwargs["turns"] == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "kind", "kept"),
    [
        ("gear-ratio", "par4", {"gear-ratio"}),  # M 16 % where the platform's joint steps elsewhere
        ("falling-gain", "delta4", {"torque-constant"}),  # M 13 % with a gear of 12 N m/rad
        ("mounting", "par4", {"mounting"}),  # M 72 % where excluded rows make noise smaller
    ],
)
def test_one_cause_is_found_from_another_beginning(row: str, kind: str, kept: set[str]) -> None:
    made = case(row, kind, 2)
    result = identified(made)
    judged = judge(made, result)
    assert judged.M < 0.01
    assert {name for name, _ in judged.said} - {"contact", "prior"} == kept
