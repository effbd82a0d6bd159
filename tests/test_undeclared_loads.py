"""Loads that come and go and that no mapping declares are identified with the robot."""

from dataclasses import replace
from functools import cache
from unittest.mock import Mock

import numpy as np
import pytest

from deltaid.checks.evidence import evidence
from deltaid.checks.identify import Judged
from deltaid.checks.residual import checked_residual
from deltaid.effects import load_change
from deltaid.effects.effect import Cause, causes_of
from deltaid.effects.load import LoadChange
from deltaid.effects.load_columns import LoadColumns
from deltaid.estimation.drive_rows import DriveRows
from deltaid.identification.loads import _is_filled, _leaves_more
from deltaid.identification.setup import Setup
from deltaid.identification.stages import idle
from deltaid.identification.study import studied
from deltaid.model.settings import Settings
from deltaid.model.verdict import Grade
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.repairs import LeftSpan, Repairs
from drives import Case, case
from drives.happening import Load, within
from drives.identify import identified
from drives.judge import judge
from drives.rows import unit
from oracle.tree import Array
from plants import Truth


@cache
def identified_case(row: str, kind: str) -> tuple[Case, Judged]:
    made = case(row, kind)
    return made, identified(made)


@pytest.mark.parametrize(
    ("row", "kind", "right"),
    [
        pytest.param("load-half-undeclared", "delta4", 0.999, marks=pytest.mark.slow),
        ("load-cycles-undeclared", "linear", 0.99),
        # Friction that the description lacks explains more than the load.
        pytest.param("production-undeclared", "h4", 0.9, marks=pytest.mark.slow),
    ],
)
def test_the_robot_is_right_without_its_load(row: str, kind: str, right: float) -> None:
    made, result = identified_case(row, kind)
    judged = judge(made, result)
    assert judged.M < 0.005  # 2 to 24 % where nothing is corrected
    (verdict,) = (v for v in result.verdicts if v.key == "load-change")
    assert verdict.grade is Grade.DOUBTFUL
    assert (judged.changes.right or 0.0) > right
    (load,) = result.model.loads
    (true,) = (h.load for h in made.happenings if h.load)
    assert load.p[0] == pytest.approx(true.mass, rel=0.03)
    (said,) = (c for c in result.model.corrections if c.kind == "load")
    assert "no mapping declares" in said.text


def test_rows_about_its_changes_do_not_count() -> None:
    made, result = identified_case("load-half-undeclared", "delta4")
    (recording,) = result.recordings
    out = [span for span in recording.repairs.left_out if span.reason == "load changes"]
    spans = [(span.first, span.last) for span in out]
    inside = within(made.happenings[0].time, spans)
    changes = np.ravel(made.happenings[0].held)
    shown = changes[(changes > 0) & (changes < made.happenings[0].duration)]
    assert len(spans) == 2 * len(recording.log.columns.loads[0].spans or ())
    for change in shown:
        for shift in (-0.02, 0.0, 0.02):
            assert inside[np.searchsorted(made.happenings[0].time, change + shift)]
    assert inside.mean() < 0.02


def test_when_it_is_held_is_known_from_all_of_a_recording_only() -> None:
    _, result = identified_case("load-half-undeclared", "delta4")
    (whole,) = result.detected.values()
    recording = whole.fit.trace.recording
    some = studied(whole.fit.trace.dynamics, replace(recording, excerpt=None), seconds=5.0)
    assert some is not None
    for study, is_known in ((whole, True), (some, False)):
        (cause,) = (c for c in causes_of(study.fit, study.account) if c.kind == "load-change")
        assert (LoadChange().held(cause, recording) is not None) == is_known


@pytest.mark.parametrize(
    ("kind", "course", "seed"),
    [
        ("delta3", "empties", 0),
        pytest.param("delta4", "empties", 0, marks=pytest.mark.slow),
        pytest.param("linear", "fills", 1, marks=pytest.mark.slow),
    ],
)
def test_a_load_that_runs_out_or_fills_is_corrected(kind: str, course: str, seed: int) -> None:
    """Torque constants of all drives that drift were corrected in its place: M 8 to 11 %."""
    made, body = case("clean", kind, seed), Load(0.3, np.array([0.0, 0.0, -0.03]))
    (h,), (sensors,) = made.happenings, made.sensors

    class Steadily:
        def torque(self, truth: Truth) -> Array:
            share = truth.time / h.duration
            share = 1.0 - share if course == "empties" else share
            return share[:, None] * body.torque(truth, h.machine.plant.oracle.gravity)

    log = sensors.recorded(replace(h, pulls=(Steadily(),)))
    result = identified(replace(made, logs=(log,)))
    assert judge(made, result).M < 0.005
    (load,), (said,) = (
        result.model.loads,
        (c for c in result.model.corrections if c.kind == "load"),
    )
    assert load.p[0] == pytest.approx(body.mass, rel=0.05)
    assert f"it {course} steadily" in said.text
    (verdict,) = (v for v in result.verdicts if v.key == "load-change")
    assert "steadily" in verdict.seen
    (proposal,) = verdict.proposals
    assert dict(proposal.changes)["load.course"] == course


@pytest.mark.parametrize("kind", ["delta4", pytest.param("linear", marks=pytest.mark.slow)])
def test_a_force_that_swings_is_no_load(kind: str) -> None:
    """As a load of 0.1 and 0.37 kg it made M 3 and 7 % wrong."""
    made = case("clean", kind, 0 if kind == "delta4" else 1)
    (h,), (sensors,) = made.happenings, made.sensors

    class Swings:
        def torque(self, truth: Truth) -> Array:
            turn = 2 * np.pi * 1.7 * truth.time
            force = 3 * unit(made.machine) * np.column_stack([np.sin(turn), np.cos(turn), 0 * turn])
            return -np.einsum("szd,sz->sd", truth.hand[:, :3], force)

    result = identified(replace(made, logs=(sensors.recorded(replace(h, pulls=(Swings(),))),)))
    assert not result.model.loads
    assert judge(made, result).M < 0.02
    (verdict,) = (v for v in result.verdicts if v.key == "load-change")
    assert verdict.grade is Grade.DOUBTFUL
    assert "it is no load: it weighs" in verdict.seen
    assert "swings" in verdict.cause
    assert "declare" not in verdict.cure
    assert not verdict.proposals


@pytest.mark.parametrize(
    ("weight", "inertia", "spread", "together", "expected"),
    [
        (1.0, 0.6, 0.01, 0.0, True),  # other causes act too, but it is nearer to a load
        (1.0, 0.4, 0.01, 0.0, False),
        (0.0, 0.1, 0.01, 0.0, False),
        (-0.1, -0.35, 0.01, 0.0, False),
        (0.0, 0.1, 0.04, 0.0, True),  # the recording determines neither
        (1.0, 0.4, 0.2, 0.039, False),  # but their difference
    ],
)
def test_a_load_weighs_as_it_resists(
    weight: float, inertia: float, spread: float, together: float, expected: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    covariance = np.array([[spread**2, together], [together, spread**2]])
    monkeypatch.setattr(
        load_change, "weighed", lambda cause: (np.array([weight, inertia]), covariance)
    )
    assert load_change.is_weight(Mock(spec=Cause)) is expected


@pytest.mark.parametrize("kind", ["delta4", "par4"])
def test_a_tool_that_shifts_is_named_and_is_no_load(kind: str) -> None:
    """Its mass stays, so it is no body that is picked up: a load in its place is 0.5 to 0.9 kg."""
    made, tool = case("clean", kind), Load(1.0, np.array([0.02, -0.01, -0.05]))
    moved = replace(tool, centre=np.array([0.05, 0.01, -0.07]))
    (h,), (sensors,) = made.happenings, made.sensors

    class Shift:
        def torque(self, truth: Truth) -> Array:
            gravity = h.machine.plant.oracle.gravity
            more = moved.torque(truth, gravity) - tool.torque(truth, gravity)
            return more * (truth.time > 0.5 * h.duration)[:, None]

    log = sensors.recorded(replace(h, pulls=(Shift(),)))
    looked_at = evidence(made.robot, log)
    (cause,) = (c for c in causes_of(looked_at.study.fit, looked_at.study.account))
    assert LoadChange().held(cause, looked_at.surveyed) is None
    (verdict,) = (v for v in checked_residual(looked_at) if v.key == "load-change")
    assert f"EE's centre or inertia changes, and its mass does not, at {h.duration / 2:.1f}" in (
        verdict.seen
    )
    assert "loose" in verdict.cause
    assert "declare" not in verdict.cure


@pytest.mark.slow
def test_gears_that_wind_up_are_no_load() -> None:
    result = identified(case("gear-5000", "h4", 1))  # a study of which detects one
    assert not result.model.loads
    assert not result.detected


@pytest.mark.slow
def test_contacts_that_let_go_of_a_load_for_a_moment_are_contacts() -> None:
    """A load that is held but for six times 0.1 s, all beside contacts, has no certain mass."""
    made = case("contacts", "par4", 0)
    result = identified(made)
    assert not result.model.loads
    assert {correction.kind for correction in result.model.corrections} == {"contact", "prior"}
    assert judge(made, result).M < 0.002


@pytest.mark.parametrize(
    ("held", "is_filled"),
    [
        ([(0.0, 1.0), (2.0, 3.0)], False),
        ([(0.0, 1.0)], False),
        ([(0.5, 0.9), (2.0, 2.2)], True),  # 0.4 of 0.6 s
        ([(0.5, 0.9), (2.0, 2.45)], False),  # 0.4 of 0.85 s
        ([(0.0, 0.6), (1.0, 3.0)], True),  # between them 0.35 of 0.4 s
        ([(0.0, 0.1), (1.0, 3.0)], False),  # 0.4 of 0.9 s
    ],
)
def test_times_that_are_excluded_show_no_load(
    held: list[tuple[float, float]], is_filled: bool
) -> None:
    """Spans that overlap are counted once."""
    times = [(0.8, 0.95), (0.55, 0.85), (2.15, 2.2)]
    excluded = tuple(LeftSpan(first, last, "contact") for first, last in times)
    recording = Mock(spec=PreparedRecording, repairs=Repairs(left_out=excluded))
    assert _is_filled(recording, held) == is_filled


@pytest.mark.parametrize(
    ("scales", "more"), [([1.1, 1.1], True), ([1.0, 1.1], False), ([1.2, 0.8], False), ([], False)]
)
def test_noise_that_grows_beyond_chance_decides_between_explanations(
    scales: list[float], more: bool
) -> None:
    """Twice 400 samples: 1.96/√800 is 7 %."""
    before, after = (
        Mock(spec=Setup, studies=(Mock(fit=Mock(rows=DriveRows(scale, 400))),))
        for scale in (np.ones(2), np.array(scales))
    )
    assert _leaves_more(after, before if scales else Mock(spec=Setup, studies=())) is more


def test_a_load_whose_mass_may_be_zero_is_idle() -> None:
    """As one that is detected in place of another cause and hardly weighs anything."""
    _, result = identified_case("load-half-undeclared", "delta4")
    problem, (load,) = result.problem, result.model.loads
    setup = Setup(result.robot, result.recordings, Settings())
    assert not idle(setup, problem).effects
    weightless = tuple(
        replace(a, taken=a.taken - load.p) if isinstance(a, LoadColumns) else a
        for a in problem.additions
    )
    assert idle(setup, replace(problem, additions=weightless)).effects == {load.name}
    returned = replace(problem)  # what is fitted takes back what was subtracted from the torques
    vars(returned)["values"] = problem.values.copy()
    returned.values[len(problem.p)] -= load.p[0]
    assert idle(setup, returned).effects == {load.name}
