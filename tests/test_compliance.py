"""Gears that wind up: rows of the link in the place of the motor's, and compliances found."""

from bisect import bisect_left
from dataclasses import replace
from functools import cache
from unittest.mock import Mock

import numpy as np
import polars as pl
import pytest

import deltaid
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.compliance import compliances
from deltaid.effects.windings import Windings, motors_of
from deltaid.errors import DeltaidError, IdentificationError, RecordingError
from deltaid.estimation.drive_rows import TraceRows
from deltaid.estimation.traces import LARGEST_LAG, Trace, trace
from deltaid.identification.contest_stage import contested
from deltaid.identification.fit import fit
from deltaid.identification.lags_and_gears import _better_than_loads, gears_turned_back
from deltaid.identification.setup import REFUTED, ContestOutcome, Setup
from deltaid.identification.sources import model_filtered
from deltaid.identification.study import Study
from deltaid.model.record import Settings
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.opening import open_log
from deltaid.recording.recording import open_recordings
from deltaid.recording.repairs import SPIKE, Gears, LeftSpan, Repairs
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from identified import simulated
from logs import tabled
from support import along, largest_mass_error

RATE = 1000.0
STIFFNESS = np.array([4e3, 6e3, 5e3])


@cache
def wound(
    share: float = 1.0, noise: float = 0.01, load: float = 0.0
) -> tuple[Dynamics, np.ndarray, pl.DataFrame]:
    """A recording of motors behind gears with a share of the compliance 1 / STIFFNESS; p is true.
    The platform holds a load [kg] from 4 s on.

    τ_g = Y p without the drives' friction; q_m = q + τ_g / k; τ = τ_g + friction(q̇_m).
    """
    dynamics, rng = compiled(load_robot("clavel-delta3")), np.random.default_rng(6)
    p = surrogate_parameters(dynamics.robot, rng)
    time = np.arange(-500, 8500) / RATE
    z, q, qd, qdd = along(dynamics.kinematics, rng, time, period=3.7, harmonics=7)
    held, loaded = np.where(time < 4, 0.0, 1.0), p.copy()
    loaded[dynamics.layout.names.index("P.m")] += load
    more = held[:, None] * (dynamics.carried(z, qd, qdd, loaded) - dynamics.carried(z, qd, qdd, p))
    carried = dynamics.carried(z, qd, qdd, p) + more
    named = dict(zip((parameter.name for parameter in dynamics.layout.parameters), p, strict=True))
    viscous, coulomb = (
        np.array([named[f"{kind}.{drive}"] for drive in dynamics.robot.drives])
        for kind in ("viscous", "coulomb")
    )
    own = dynamics.torque(z, qd, qdd, p) + more - carried - viscous * qd - coulomb * np.sign(qd)
    ahead = share * carried / STIFFNESS
    faster = np.gradient(ahead, 1 / RATE, axis=0)
    tau = carried + own + viscous * (qd + faster) + coulomb * np.sign(qd + faster)
    inner, size = slice(500, -500), np.abs(tau).max(axis=0)
    steps = 1e-6 * np.round(1e6 * (q + ahead))
    tau = tau + noise * size * rng.standard_normal(tau.shape)
    columns = {"q": steps, "tau": tau, "link": q}
    table = tabled(t=time[inner], **{name: values[inner] for name, values in columns.items()})
    return dynamics, p, table.with_columns(held=pl.Series(held[inner]))


@cache
def fitted(share: float) -> deltaid.Identification:
    dynamics, _, table = wound(share)
    only = Settings(friction="described", events=False)
    return deltaid.identify(dynamics.robot, table.drop("link1", "link2", "link3"), settings=only)


def test_stretches_too_short_for_the_gears_filter_give_no_compliance() -> None:
    """A logger that loses some rows each second leaves stretches that are long enough for a fit."""
    dynamics, p, table = wound()
    (recording,) = open_recordings(table.drop("link1", "link2", "link3"), dynamics.kinematics)
    whole = trace(dynamics, recording, p, cutoff=recording.cutoff)
    run, rows = whole.stretches[0], TraceRows.for_dynamics(dynamics, (), 0.5)
    lengths = range(len(run.time))
    cut = (replace(whole, stretches=(run.part(slice(length)),)) for length in lengths)
    short = next(record for record in cut if record.is_long(0))
    for traces in [short], [whole, short]:
        gears = compliances(traces, traces, rows, np.full(3, np.nan))
        assert gears.values.any() == (len(traces) > 1)


def mass_error(dynamics: Dynamics, p: np.ndarray, true: np.ndarray) -> float:
    z = dynamics.kinematics.home + 0.1 * np.random.default_rng(1).uniform(-1, 1, (20, 3))
    q = dynamics.kinematics.inverse(z)
    return largest_mass_error(dynamics.mass_matrix(q, p), dynamics.mass_matrix(q, true))


def gears(p: np.ndarray, dynamics: Dynamics) -> Gears:
    named = dict(
        zip((parameter.name for parameter in dynamics.layout.parameters), p.tolist(), strict=True)
    )
    viscous, coulomb, rotor = (
        tuple(named.get(f"{kind}.{drive}", 0.0) for drive in dynamics.robot.drives)
        for kind in ("viscous", "coulomb", "rotor")
    )
    return Gears(tuple((1 / STIFFNESS).tolist()), viscous, coulomb, rotor, 40.0)


def test_rows_become_those_of_the_link() -> None:
    dynamics, p, table = wound(1.0, 0.0)
    log = open_log(table, dynamics.kinematics, keep_all=True)
    rows = np.concatenate(list(log.batches()))
    found = gears(p, dynamics)
    back = np.concatenate(list(found.turned_back(iter([rows]), log.columns, RATE)))
    at = np.searchsorted(rows[:, 0], back[:, 0])
    link = table.select("link1", "link2", "link3").to_numpy()[at]
    before, after = (np.abs(x[:, 1:4] - link).max(axis=0) for x in (rows[at], back))
    assert np.all(after < 0.05 * before)
    cut = np.array_split(rows, [3, 700, 701, 5000])
    again = np.concatenate(list(found.turned_back(iter(cut), log.columns, RATE)))
    np.testing.assert_array_equal(again, back)
    repaired = Repairs(gears=found).apply(iter([rows]), log.columns, RATE)
    np.testing.assert_array_equal(np.concatenate(list(repaired)), back)
    short = found.turned_back(iter([rows[:100]]), log.columns, RATE)
    assert not list(short)


def test_rows_near_brakes_do_not_count() -> None:
    """While brakes hold, drives say nothing of what gears carry, nor does a filter about it."""
    dynamics, p, table = wound(1.0, 0.0)
    log = open_log(table, dynamics.kinematics, keep_all=True)
    rows = np.concatenate(list(log.batches()))
    rows[4000:4200, log.columns.torque_places] = 0.0
    rows[4000:4200, -3:] = 0.0
    rows[6000:6200, -1:] = 0.0  # of one drive alone, such as at its reversal
    back = np.concatenate(list(gears(p, dynamics).turned_back(iter([rows]), log.columns, RATE)))
    at = np.searchsorted(rows[:, 0], back[:, 0])
    q = table.select("link1", "link2", "link3").to_numpy()
    qdd = np.gradient(np.gradient(back[:, 1:4] - q[at], axis=0), axis=0) * RATE**2
    left_out = at[back[:, -3:].max(axis=1) == 0.0]
    assert (left_out[0], left_out[-1]) == (4000 - 50, 4199 + 50)  # two periods of 40 Hz
    assert np.array_equal(at[back[:, -1] == 0.0], [*left_out, *range(6000, 6200)])
    counted, near = back[:, -3] > 0.0, np.abs(at - 4100) < 400
    assert np.abs(qdd[near & ~counted]).max() > 20 * np.abs(qdd[near & counted]).max()


def test_compliances_are_detected_and_corrected() -> None:
    dynamics, p, table = wound()
    found = fitted(1.0)
    corrections = [
        correction for correction in found.model.corrections if correction.kind == "compliance"
    ]
    assert [correction.subject for correction in corrections] == list(dynamics.robot.drives)
    values = np.array([correction.value for correction in corrections])
    np.testing.assert_allclose(values, 1 / STIFFNESS, rtol=0.1)
    low, high = (
        np.array([getattr(correction, side) for correction in corrections])
        for side in ("low", "high")
    )
    assert np.all((low > 0) & (low < values) & (values < high))
    assert {correction.unit for correction in corrections} == {"rad/(N m)"}
    assert mass_error(dynamics, found.model.p, p) < 0.005
    stiff = replace(found.recordings[0], repairs=Repairs())
    wrong = fit(dynamics, [stiff], found.model.settings)
    assert mass_error(dynamics, wrong.p, p) > 2 * mass_error(dynamics, found.model.p, p)
    again = model_filtered(found.model, open_log(table, dynamics.kinematics))
    np.testing.assert_allclose(again.repairs.gears.compliance, values)


def test_gears_wind_up_under_a_load_as_well() -> None:
    """The torque of a load that is subtracted belongs to the link's motion."""
    dynamics, p, table = wound(load=0.6)
    held = ColumnMapping(load=Load(column="held"))
    only = Settings(friction="described", events=False)
    model = deltaid.identify(dynamics.robot, table, columns=held, settings=only).model
    *gears, load = model.corrections
    values = np.array([correction.value for correction in gears])
    np.testing.assert_allclose(values, 1 / STIFFNESS, rtol=0.1)
    assert load.value == pytest.approx(0.6, rel=0.004)
    assert mass_error(dynamics, model.p, p) < 0.002


def test_a_held_load_moves_with_the_link() -> None:
    """Its torque is that of the link's motion, and with it torques are those without a load."""
    dynamics, p, table = wound(load=0.6)
    held = ColumnMapping(load=Load(column="held"))
    (recording,) = open_recordings(table.drop("link1", "link2", "link3"), dynamics.kinematics, held)
    holding = recording.repaired(loads=((0.6, *9 * (0.0,)),))
    motors, burden = motors_of(dynamics.robot, p, 30.0, RATE), holding.burden(dynamics.robot)
    (empty,), (after,) = (
        Windings.measured(trace(dynamics, each, p, cutoff=each.cutoff), motors)
        .turned(1 / STIFFNESS)
        .stretches
        for each in (recording, holding)
    )
    expected = burden(after.time, after.z, after.qd, after.qdd, after.extra)
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(after.carried, expected)
    np.testing.assert_allclose(after.tau + after.carried, empty.tau, atol=1e-9)
    np.testing.assert_allclose(after.qdd, empty.qdd, atol=1e-6)


@pytest.mark.slow
def test_an_undeclared_load_behind_soft_gears_is_no_drift_of_torque_constants() -> None:
    dynamics, p, table = wound(load=0.3)
    only = Settings(friction="described", events=False)
    model = deltaid.identify(dynamics.robot, table.drop("held"), settings=only).model
    assert [c.kind for c in model.corrections] == [*3 * ["compliance"], "load"]
    assert model.corrections[-1].value == pytest.approx(0.3, rel=0.01)
    assert mass_error(dynamics, model.p, p) < 0.002  # 3 % with constants that drift


def test_stiff_gears_stay_stiff() -> None:
    found = fitted(0.0)
    assert not [
        correction for correction in found.model.corrections if correction.kind == "compliance"
    ]
    assert found.recordings[0].repairs.gears is None
    assert model_filtered(found.model, found.recordings[0].log).repairs.gears is None


@pytest.mark.parametrize("seed", [101, 102])
def test_noise_of_a_short_recording_is_no_gear_that_winds_up(seed: int) -> None:
    """Turned back by measured torques, the link takes away their noise where M s ω² is one."""
    robot = load_robot("clavel-delta3")
    p = surrogate_parameters(robot, np.random.default_rng(0))
    table = simulated(robot, p, seed, duration=6.0)
    settings = Settings(cutoff=15.0, friction="described", lag="none", events=False)
    found = at_stage(robot, table, settings)
    assert all(recording.repairs.gears is None for recording in found.recordings)


def at_stage(
    robot: RobotDescription,
    table: pl.DataFrame,
    settings: Settings,
    outcome: ContestOutcome | None = None,
) -> Setup:
    """What the stage makes of a recording that nothing else is done to."""
    kinematics = compiled(robot).kinematics
    table = table.drop("link1", "link2", "link3", strict=False)
    recordings = tuple(open_recordings(table, kinematics, cutoff=settings.cutoff))
    setup = Setup(robot, recordings, settings, outcome=outcome)
    return gears_turned_back(setup, lambda _: None)


def short_of_rows(stated: dict[str, float] | None = None) -> Setup:
    """A recording of compliant gears with an outlier every 0.12 s: what gears carry is unknown
    for 0.08 s before and after each."""
    dynamics, _, table = wound()
    settings = Settings(cutoff=10.0, friction="described")
    robot = dynamics.robot.model_copy(update={"gear_stiffness": stated or {}})
    kinematics = compiled(robot).kinematics
    (recording,) = open_recordings(table, kinematics, cutoff=settings.cutoff)
    starts = np.arange(0.1, len(table) / RATE, 0.12).tolist()
    spans = [LeftSpan(start, start + 0.005, SPIKE) for start in starts]
    recordings = (recording.repaired(left_out=tuple(spans)),)
    return Setup(robot, recordings, settings)


def test_gears_stay_stiff_where_no_row_would_be_left() -> None:
    setup = gears_turned_back(short_of_rows(), lambda _: None)
    assert setup.recordings[0].repairs.gears is None


def test_a_stated_stiffness_that_leaves_no_row_is_refused() -> None:
    with pytest.raises(IdentificationError, match="no row whose links' motion is known"):
        gears_turned_back(short_of_rows({"drive1": 4e3}), lambda _: None)


def test_a_contest_does_not_follow_gears_to_where_no_row_is_left() -> None:
    setup = contested(short_of_rows(), lambda _: None)
    assert setup.outcome is not None
    why = "gears that wind up, no row would be left whose links' motion is known"
    assert why in setup.outcome.doubts[REFUTED]
    assert not setup.barred_effects  # a later contest may need what this one did not try
    assert setup.recordings[0].repairs.gears is None


def test_a_stiffness_that_is_stated_is_applied() -> None:
    dynamics, p, table = wound()
    named = dict(zip(dynamics.robot.drives, STIFFNESS.tolist(), strict=True))
    robot = dynamics.robot.model_copy(update={"gear_stiffness": named})
    setup = at_stage(robot, table, Settings(compliance="none", effects="none"))
    corrections = [
        correction for correction in setup.corrections if correction.kind == "compliance"
    ]
    np.testing.assert_allclose(
        [correction.value or 0.0 for correction in corrections], 1 / STIFFNESS
    )
    assert all(
        "as stated" in correction.text and correction.low is None for correction in corrections
    )
    assert mass_error(dynamics, fit(dynamics, setup.recordings, Settings()).p, p) < 0.003


def test_a_stiffness_that_lets_gears_wind_up_by_their_whole_range_is_refused() -> None:
    """As numbers per minute of arc are, or thousands."""
    dynamics, _, table = wound(0.0)
    robot = dynamics.robot.changed(gear_stiffness={"drive2": 5.0})
    with pytest.raises(DeltaidError, match="is 5 N m/rad: recorded torques would wind the gear of"):
        at_stage(robot, table, Settings(cutoff=15.0, friction="described", events=False))


def test_nothing_is_looked_for_unless_asked() -> None:
    dynamics, _, table = wound()
    setup = at_stage(dynamics.robot, table, Settings(compliance="none", effects="none"))
    assert not setup.corrections
    assert setup.recordings[0].repairs.gears is None


def test_gears_that_a_contest_has_weighed_are_not_estimated_anew() -> None:
    dynamics, _, table = wound()
    robot = dynamics.robot.model_copy(update={"gear_stiffness": {"drive3": float(STIFFNESS[2])}})
    sizes, deviation = 0.7 / STIFFNESS, np.array([1e-6, 2e-6, 3e-6])
    weighed = ContestOutcome(
        robot, values={"compliance": sizes}, deviations={"compliance": deviation}
    )
    setup = at_stage(robot, table, Settings(), weighed)
    values = [*sizes[:2].tolist(), 1 / STIFFNESS[2]]
    gears = setup.recordings[0].repairs.gears
    assert gears is not None
    assert gears.compliance == pytest.approx(values)
    assert [correction.value for correction in setup.corrections] == pytest.approx(values)
    first, second, stated = setup.corrections
    assert stated.low is None
    halves = [(c.high or 0.0) - (c.value or 0.0) for c in (first, second)]
    assert halves[1] == pytest.approx(2.0 * halves[0])
    assert halves[0] == pytest.approx(deviation[0] * 2.05, rel=0.05)
    stiff = at_stage(dynamics.robot, table, Settings(), ContestOutcome(robot))
    assert not stiff.corrections


def test_a_law_that_is_missing_is_no_compliance() -> None:
    dynamics, p, table = wound(0.0)
    coulomb = p[dynamics.layout.coulomb][: dynamics.dof]
    link = table.select("link1", "link2", "link3").to_numpy()
    speed = np.gradient(link, 1 / RATE, axis=0)
    knee = 0.05 * np.abs(speed).max(axis=0)
    more = coulomb * (0.4 * np.exp(-((speed / knee) ** 2)) * np.sign(speed) + 0.1 * np.abs(speed))
    tau = table.select("tau1", "tau2", "tau3").to_numpy() + more
    log = table.with_columns(tabled(tau=tau))
    assert not at_stage(dynamics.robot, log, Settings()).corrections


def test_a_stiffness_is_of_a_drive_that_is_there() -> None:
    robot = load_robot("clavel-delta3")
    uniform = robot.changed(gear_stiffness=2e4)
    assert [uniform.stiffness(drive) for drive in uniform.drives] == [2e4, 2e4, 2e4]
    two = robot.changed(gear_stiffness={"drive2": 5e3})
    assert [two.stiffness(drive) for drive in two.drives] == [np.inf, 5e3, np.inf]
    with pytest.raises(
        DeltaidError, match="gear_stiffness: has unknown drive9; choose from drive1"
    ):
        robot.changed(gear_stiffness={"drive9": 5e3})


def test_motors_lose_as_much_as_both_directions_on_average() -> None:
    robot = load_robot("clavel-delta3")
    friction = {
        joint: law.changed(viscous_back=1.2 * law.viscous, coulomb_back=1.4 * law.coulomb)
        for joint, law in robot.friction.items()
    }
    plain = motors_of(robot, prior_parameters(robot), 30.0, RATE)
    by_direction = robot.changed(friction=friction)
    motors = motors_of(by_direction, prior_parameters(by_direction), 30.0, RATE)
    np.testing.assert_allclose(motors.viscous, 1.1 * np.array(plain.viscous))
    np.testing.assert_allclose(motors.coulomb, 1.2 * np.array(plain.coulomb))
    assert motors.rotor == plain.rotor


@pytest.mark.parametrize("motor", ["viscous", "coulomb", "rotor"])
def test_torques_become_those_of_a_motor_at_the_link(motor: str) -> None:
    values = {name: (2.0 if name == motor else 0.0,) for name in ("viscous", "coulomb", "rotor")}
    drive_gears = Gears((1e-4,), **values, cutoff=30.0)
    qd, qdd, ahead, faster = (np.array([[x]]) for x in (0.3, 5.0, 0.5, 7.0))
    expected = {"viscous": 2.0 * 0.5, "coulomb": 4.0, "rotor": 2.0 * 7.0}[motor]
    np.testing.assert_allclose(drive_gears.less(qd, qdd, ahead, faster), [[expected]])


@pytest.mark.parametrize(("gears_leave", "believed"), [(0.2, True), (0.8, False)])
def test_gears_stand_in_the_place_of_a_load_where_they_leave_less(
    gears_leave: float, believed: bool
) -> None:
    def study(scale: float, load: float) -> Mock:
        mock = Mock(spec=Study, fit=Mock(), account=Mock())
        mock.fit.rows.scale = np.full(3, scale)
        mock.account.left = np.full(4, np.sqrt((1.0 - load) / 4))
        mock.account.detected = [Mock(gain=load, candidate=Mock(kind="load-change"))]
        return mock

    before, after = study(1.0, 0.5), study(float(np.sqrt(gears_leave)), 0.0)
    setup = Mock(spec=Setup, studies=(before,))
    before.is_disturbed = True
    assert _better_than_loads(setup, (after,)) == believed
    before.is_disturbed = False
    assert _better_than_loads(setup, (after,))


def test_the_shortest_traces_may_be_read_at_lags_in_both_directions() -> None:
    """Then drives lose rows at both ends of a stretch."""
    dynamics, p, table = wound()
    recorded = table.drop("link1", "link2", "link3").with_row_index()
    lags = np.array([LARGEST_LAG, -LARGEST_LAG, 0.0])

    def between_gaps(rows: int) -> Trace | None:
        columns = recorded.filter(pl.col("index") % 1000 < rows).drop("index")
        try:
            (recording,) = open_recordings(columns, dynamics.kinematics)
            return trace(dynamics, recording, p, cutoff=20.0)
        except RecordingError:
            return None

    lengths = range(100, 900, 5)
    shortest = bisect_left(lengths, True, key=lambda rows: between_gaps(rows) is not None)
    record = between_gaps(lengths[shortest])
    assert record is not None
    assert record.shifted(lags).stretches
