"""Torques that no effect explains: their free functions, what is kept beside them, what is said."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.at_drives import DriveSpring
from deltaid.effects.point import Added, TracePoint
from deltaid.effects.unexplained import (
    KINDS,
    UNEXPLAINED,
    FreeTorque,
    Unexplained,
    shares_of_torque,
)
from deltaid.estimation.causes import CauseColumns, NoiseBlock
from deltaid.estimation.drive_rows import TraceRows
from deltaid.estimation.information import entries_at
from deltaid.estimation.shrinkage import Shrunk
from deltaid.estimation.traces import Trace
from deltaid.identification import contest_stage, contest_sweeps
from deltaid.identification.contest import Contest
from deltaid.identification.contest_applied import with_effects, without_contest
from deltaid.identification.contest_outcome import doubted, overtaken, refuted
from deltaid.identification.selection import reduced
from deltaid.identification.setup import ContestOutcome, Setup
from deltaid.model.settings import Settings
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.repairs import TorqueDrift
from deltaid.recording.windows import SampleBlock
from deltaid.robot.load import load_robot
from drives import Case, case
from drives.identify import identified
from drives.judge import judge

PLACE = f"{UNEXPLAINED} its place"
# Effects that the contest of causes corrects.
NAMED = {"zero", "gear-ratio", "tilt", "length", "torque-constant", "torque-drift", "structure",
         "ripple", "drive-spring", "platform-force", "platform-spring", "platform-drag",
         "gain"}  # fmt: skip


def weaker_at_speed(made: Case) -> Case:
    """A case whose drives record up to 6 % more torque the faster they move."""

    def changed(log: pl.DataFrame) -> pl.DataFrame:
        time, more = log["t"].to_numpy(), list[pl.Series]()
        for name in (name for name in log.columns if name.startswith("tau")):
            q, tau = log[name.replace("tau", "q")].to_numpy(), log[name].to_numpy()
            speed = np.abs(np.gradient(q, time))
            more.append(pl.Series(name, tau * (1.0 + 0.06 * speed / speed.max())))
        return log.with_columns(more)

    return replace(made, logs=tuple(changed(log) for log in made.logs))


def free(kind: str) -> FreeTorque:
    dynamics = compiled(load_robot("clavel-delta3"))
    count = 3 * (len(KINDS[kind]) or {"time": 3}.get(kind, 2))
    return FreeTorque(
        dynamics, (), prior_parameters(dynamics.robot), kind, (0.2, 0.3, 0.4), (1.0, 0.5, 2.0),
        (3.0, 4.0, 5.0), (10.0, 20.0, 40.0), tuple(np.arange(1.0, count + 1)),
    )  # fmt: skip


def chebyshev(degree: int, values: np.ndarray) -> np.ndarray:
    return np.cos(degree * np.arccos(values))


def test_kinds_have_all_products_but_those_of_speed_alone_and_of_a_factor() -> None:
    degrees = [d for degrees in KINDS.values() for d in degrees]
    every = {(a, b, k) for a in range(4) for b in range(4 - a) for k in range(4 - a - b)}
    assert set(degrees) == every - {(0, b, 0) for b in range(4)} - {(0, 0, 1)}
    assert len(degrees) == len(set(degrees))
    assert KINDS["its speed and torque"] == ((0, 1, 1), (0, 1, 2), (0, 2, 1))


@pytest.mark.parametrize("kind", KINDS)
def test_free_functions_are_products_of_chebyshev_polynomials(kind: str) -> None:
    torque, rng = free(kind), np.random.default_rng(0)
    x, u, s = rng.uniform(-1, 1, (3, 50, 3))
    q, qd, tau = x * torque.half + torque.middle, u * torque.fastest, s * torque.strongest
    passed = np.linspace(-1.0, 1.0, 50)
    expected = [
        chebyshev(a, x[:, i]) * chebyshev(b, u[:, i]) * chebyshev(k, s[:, i])
        for i in range(3) for a, b, k in KINDS[kind]
    ]  # fmt: skip
    if kind == "torques of other drives":
        expected = [s[:, j] for i in range(3) for j in range(3) if j != i]
    if kind == "time":
        expected = [chebyshev(m, passed) for m in (1, 2, 3)] * 3
    assert torque.along(q, qd, tau, passed) == pytest.approx(np.array(expected), abs=1e-12)
    rows, columns = torque.pattern
    assert rows.tolist() == np.repeat([0, 1, 2], len(expected) // 3).tolist()
    assert columns.tolist() == list(range(len(expected)))
    stated = [entry.scale * entry.spread for entry in torque.parameters]
    assert stated == pytest.approx(torque.deviation)


@pytest.mark.parametrize("kind", ["its place and torque", "torques of other drives", "time"])
def test_columns_of_recordings_have_their_largest_values_and_weights(kind: str) -> None:
    rng, recording = np.random.default_rng(2), Mock(spec=PreparedRecording)
    recording.drifting.return_value = TorqueDrift(5.0, 2.0)
    points = [
        Mock(
            spec=TracePoint, dynamics=free(kind).dynamics, p=np.zeros(1), dof=3,
            q=rng.uniform(-1, 1, (30, 3)), model=rng.standard_normal((3, 30)),
            largest=rng.uniform(2, 3, 3),
            motion=Mock(qd=rng.standard_normal((30, 3)), weights=rng.uniform(0, 1, (30, 3)),
                        time=np.linspace(5.0, 7.0, 30)),
            trace=Mock(recording=recording),
        )
        for _ in range(2)
    ]  # fmt: skip
    effect = Unexplained(points, kind)
    torque, q = effect.addition, np.vstack([point.q for point in points])
    assert np.subtract(torque.middle, torque.half) == pytest.approx(q.min(axis=0))
    assert np.add(torque.middle, torque.half) == pytest.approx(q.max(axis=0))
    fastest = np.abs(np.vstack([point.motion.qd for point in points])).max(axis=0)
    assert torque.fastest == pytest.approx(fastest)
    strongest = np.max([point.largest for point in points], axis=0)
    assert torque.strongest == pytest.approx(strongest)
    deviations = effect.deviations(points[0], np.zeros((3, 1, 1)))
    assert deviations.reshape(3, -1) == pytest.approx(
        np.tile(0.05 * strongest, (len(deviations) // 3, 1)).T
    )
    point = points[1]
    columns = effect.columns(point)
    passed = np.linspace(-1.0, 1.0, 30)
    entries = torque.along(point.q, point.motion.qd, point.model.T, passed)
    for k, (drive, entry) in enumerate(zip(torque.pattern[0], entries, strict=True)):
        assert columns[drive, :, k] == pytest.approx(entry * point.motion.weights[:, drive])
        assert not np.delete(columns[:, :, k], drive, axis=0).any()


def test_entries_along_a_motion_take_the_torques_of_the_model() -> None:
    torque, rng = free("its speed and torque"), np.random.default_rng(1)
    dynamics = torque.dynamics
    z = dynamics.kinematics.home + 0.05 * rng.standard_normal((20, 3))
    qd, qdd = rng.standard_normal((2, 20, 3))
    time = np.linspace(5.0, 7.0, 20)
    w = Mock(spec=SampleBlock, z=z, qd=qd, qdd=qdd, time=time, carried=np.zeros((20, 3)))
    own = entries_at(dynamics, z, qd, qdd, np.zeros((20, 3)))
    tau = dynamics.torque(z, qd, qdd, torque.p)
    expected = torque.along(dynamics.kinematics.inverse(z), qd, tau, time)
    recording = Mock(spec=PreparedRecording)
    recording.drifting.return_value = TorqueDrift(5.0, 2.0)
    assert torque.entries(w, own, recording) == pytest.approx(expected, abs=1e-9)


def test_what_is_smaller_than_the_unexplained_is_dropped() -> None:
    """It may be a part of that; both are far beyond chance."""
    rng = np.random.default_rng(2)
    A = rng.standard_normal((400, 4))
    numbers, deviation = np.array([[1, 2], [3, 3]]), np.full(1, 1.0)

    def kept_causes(name: str, small: float) -> tuple[str, ...]:
        b = A @ np.array([1.0, 0.5, 0.5, small]) + 0.1 * rng.standard_normal(400)
        block = NoiseBlock(A, b, np.repeat(np.arange(40), 10), 5.0)
        groups = [
            CauseColumns(name, numbers[0], np.ones(2), np.zeros(2)),
            CauseColumns("cause", numbers[1, :1], deviation, np.zeros(1)),
        ]
        full = Shrunk.fitted([block], np.eye(4)[:1] / 10, np.zeros(1), groups)
        return reduced(full, 6.0).candidates

    assert kept_causes("other", 0.2) == ("other", "cause")
    assert kept_causes(UNEXPLAINED, 0.2) == (UNEXPLAINED,)
    assert kept_causes(UNEXPLAINED, 2.0) == (UNEXPLAINED, "cause")


def test_unexplained_torques_are_what_no_other_effect_can_take_of_the_first_recording() -> None:
    rng = np.random.default_rng(3)
    A = rng.standard_normal((3, 400, 3))
    A[:, :, 2] += A[:, :, 1]  # half of it is like the named cause
    x, stretches = np.array([1.0, 0.5, 0.8]), np.repeat(np.arange(40), 10)
    blocks = [NoiseBlock(a, a @ x + 0.3 * rng.standard_normal(400), stretches, 5.0) for a in A]
    groups = [
        CauseColumns(name, np.array([k]), np.ones(1), np.zeros(1))
        for k, name in ((1, "tilt"), (2, PLACE))
    ]
    shrunk = Shrunk.fitted(blocks, np.eye(3)[:1] / 10, np.zeros(1), groups)
    contest = Contest(Mock(spec=TraceRows), (Mock(spec=TracePoint, dof=2),), (), shrunk)
    torques = contest.unexplained_torques()
    span = np.linalg.qr(np.vstack(A[:, :, :2]))[0]
    part = 0.8 * np.concatenate(A[:, :, 2])
    expected = (part - span @ (span.T @ part)).reshape(3, 400)[:2]
    assert torques == pytest.approx(expected, abs=0.15)
    bare = replace(contest, shrunk=shrunk.of_candidates(["tilt"]))
    assert bare.unexplained_torques() is None


def test_a_warning_says_how_much_is_unexplained_and_intervals_count_it_as_a_scale() -> None:
    robot = load_robot("clavel-delta3")
    names, p = compiled(robot).layout.names, prior_parameters(robot)
    time = np.linspace(0, 20, 400)
    model = np.stack([3.0 * np.sin(time), np.sin(2 * time), np.sin(3 * time)])
    torques = 0.1 * model * np.array([[1.0], [2.0], [0.5]])
    point = Mock(spec=TracePoint, model=model, drives=robot.drives)
    last = Mock(spec=Contest, estimate=p, points=(point,))
    last.named.side_effect = compiled(robot).layout.named
    last.unexplained_torques.return_value, last.follows.return_value = torques, []
    prices = {"unexplained its place": 10.0, "unexplained its speed": 20.0, "zero": 30.0}
    groups = [CauseColumns(name, np.arange(1), np.ones(1), np.zeros(1)) for name in prices]
    last.shrunk = Mock(spec=Shrunk, droppable=groups)
    last.shrunk.price.side_effect = lambda group: prices[group.name]
    full, suspect = Mock(spec=Contest), Mock(spec=Contest, estimate=1.5 * p)
    full.rivals.return_value, full.suspects.return_value = {}, {"ripple": suspect}
    suspect.follows.return_value, suspect.odds.return_value = [], 100.0
    outcome = doubted(ContestOutcome(robot), full, last)
    (text,) = outcome.doubts.values()  # suspects may be a part of it
    assert text.startswith("unexplained: 20 % of drive2's torque, it varies with its speed; no kn")
    assert shares_of_torque(point, torques) == pytest.approx([0.1, 0.2, 0.05])
    by_suspect, scale = outcome.moves
    assert [by_suspect[name] for name in names] == pytest.approx((0.5 * p).tolist())
    assert [scale[name] for name in names] == pytest.approx((0.2 * p).tolist())


@pytest.mark.parametrize(("amount", "prefers_named"), [(0.0, True), (1.0, False)])
def test_rows_prefer_a_named_effect_to_free_functions_that_explain_no_more(
    amount: float, prefers_named: bool
) -> None:
    rng = np.random.default_rng(5)
    A = rng.standard_normal((3, 400, 3))
    tau, stretches = A @ [1.0, 0.5, amount], np.repeat(np.arange(40), 10)
    blocks = [
        NoiseBlock(a[:, :2], t + 0.3 * rng.standard_normal(400), stretches, 5.0)
        for a, t in zip(A, tau, strict=True)
    ]
    named = CauseColumns("tilt", np.array([1]), np.ones(1), np.zeros(1))
    shrunk = Shrunk.fitted(blocks, np.eye(2)[:1] / 10, np.zeros(1), [named])
    point, free = Mock(spec=TracePoint), Mock(spec=Added)
    free.name, free.columns.return_value = PLACE, A[:, :, 1:]
    free.deviations.return_value = np.ones(2)
    full = Contest(Mock(spec=TraceRows), (point,), (), shrunk)
    other = full._with([free])
    other = replace(other, shrunk=other.shrunk.of_candidates([PLACE]))
    assert full.prefers(full, other) is prefers_named
    assert full.prefers(other, full) is not prefers_named


@pytest.mark.parametrize(
    ("prefers_free", "noise", "refuted", "stands"),
    [
        (True, -0.01, (), True),
        (True, 0.01, (), False),
        (False, -0.01, (), False),
        (True, -0.01, ("named", "free"), True),
        (False, -0.01, ("named", "free"), False),
        (False, -0.01, ("named",), True),
        (False, 0.01, ("named",), False),
        (True, -0.01, ("free",), False),
        (True, -0.01, ("overtaken",), False),
        (True, -0.01, ("overtaken", "named"), True),
        (False, -0.01, ("led",), True),
        (False, -0.01, ("led", "overtaken"), True),
        (False, -0.0039, ("led",), False),
        (True, -0.01, ("led", "free"), False),
    ],
)
def test_free_functions_stand_where_rows_are_more_probable_and_leave_less_noise(
    prefers_free: bool,
    noise: float,
    refuted: tuple[str, ...],
    stands: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where none of them is kept, they only led to another end, which may be the better one."""
    robot = load_robot("clavel-delta3")
    kept = {"named": ("tilt",), "free": ("tilt",) if "led" in refuted else ("tilt", PLACE)}
    setup = Setup(robot, (), Settings())
    p = prior_parameters(robot)
    named, other = (
        Mock(spec=Contest, estimate=values, noise=n, shrunk=Mock(spec=Shrunk, noise_spread=2e-3))
        for values, n in ((1.1 * p, 0.0), (p, noise))
    )
    for contest in (named, other):
        contest.named.side_effect = compiled(robot).layout.named
    end, beside = (
        contest_sweeps.Sweeps(
            setup,
            ContestOutcome(robot, kept[name]),
            last,
            last,
            p,
            (),
            frozenset(),
            "why" if name in refuted else "",
            False,
            name == "free",
        )
        for name, last in (("named", named), ("free", other))
    )
    named.unexplained.return_value = free = (Mock(spec=Unexplained),)
    named.prefers.side_effect = lambda *ends: prefers_free if ends == (other, named) else None
    monkeypatch.setattr(contest_stage, "sweeps", lambda bare, free, **_: beside if free else None)
    why = {(named, other): "theirs" if "overtaken" in refuted else ""}
    monkeypatch.setattr(contest_stage, "overtaken", lambda *ends: why[ends])
    result = contest_stage._beside_unexplained(setup, end)
    assert result.last is (other if stands else named)
    theirs = {"free"} if "led" in refuted else {"free", "overtaken"}
    assert bool(result.why_not) == bool((theirs if stands else {"named"}) & {*refuted})
    (move,) = (list(move.values()) for move in result.outcome.moves)
    assert move == pytest.approx(((0.1 if stands else -0.1) * p).tolist(), abs=1e-12)
    named.unexplained.return_value = free[:0]
    assert contest_stage._beside_unexplained(setup, end) is end


@pytest.mark.parametrize(("moved", "why"), [(0.09, ""), (0.11, "they would explain 11 %")])
def test_free_functions_that_take_much_of_the_model_are_refuted(moved: float, why: str) -> None:
    """Of what varies: constants are no part of it."""
    model = np.array([[1.0, -1.0, 3.0, -3.0], [2.0, 2.0, -2.0, -2.0]])
    trace = Mock(spec=Trace, model=lambda p: p[0] * model + p[1] + model[0] * [[0.0], [0.01]])
    point = Mock(spec=TracePoint, trace=trace, model=model)
    last, beside = (
        Mock(spec=Contest, p=np.array([factor, constant]), points=(point,))
        for factor, constant in ((1.0, 0.0), (1.0 - moved, 3.0))
    )
    assert overtaken(last, beside)[: len(why) or None] == why


def test_free_functions_join_the_fit_with_the_priors_of_what_nobody_described() -> None:
    """Springs beside them give friction laws an offset, which their torques have too."""
    robot = load_robot("clavel-delta3")
    spring = DriveSpring(compiled(robot), (0, 1, 2), (1.0,) * 3)
    added = {"drive-spring": Added("drive-spring", spring),
             PLACE: Added(PLACE, free("its place"))}  # fmt: skip
    groups = {
        name: CauseColumns(name, np.arange(n), np.full(n, 2.0), np.zeros(n))
        for name, n in (("drive-spring", 3), (PLACE, 9))
    }
    shrunk = Mock(spec=Shrunk, groups=list(groups.values()), alpha=np.array([0.5, 0.2]))
    last = Mock(spec=Contest, unknown=added.get, group=groups.get, shrunk=shrunk)
    outcome = ContestOutcome(robot, kept=tuple(added))
    setup = with_effects(Setup(robot, (), Settings()), outcome, last)
    springs, place = setup.additions
    assert isinstance(springs, DriveSpring)
    assert isinstance(place, FreeTorque)
    assert (springs.deviation, place.deviation) == ((1.0,) * 3, (2.0,) * 9)
    assert place.dynamics is setup.dynamics
    assert "offset.drive1" in setup.dynamics.layout.names
    assert len(place.p) == len(setup.dynamics.layout.names)
    assert not without_contest(setup).additions


@pytest.mark.parametrize(
    ("kept", "words"),
    [((PLACE, "tilt"), "with corrections of tilt "), ((PLACE,), "with free functions of the d")],
)
def test_a_refuted_contest_names_effects_alone(kept: tuple[str, ...], words: str) -> None:
    outcome = refuted(ContestOutcome(load_robot("clavel-delta3"), kept=kept), "2 % is left", [])
    (text,) = outcome.doubts.values()
    assert words in text


@pytest.mark.slow
def test_torque_that_grows_with_speed_becomes_no_other_cause() -> None:
    """Springs, a force and ripples imitate it; beside free functions nothing is needed."""
    made = weaker_at_speed(case("clean", "delta3"))
    result = identified(made)
    assert not NAMED & {correction.kind for correction in result.model.corrections}
    (text,) = (text for text in result.model.warnings if "no known effect explains it" in text)
    assert "'s torque, it varies with its speed and torque; no known effect" in text
    judged = judge(made, result)
    assert judged.M_shape < 0.003  # 0.01 to 0.02 where others stand in
    assert not {"torque-constant", "drive-gain", "residual"} & set(judged.verdicts)
