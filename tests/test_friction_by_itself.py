"""Friction right without options: further laws, whole curves with intervals, warmth."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import polars as pl
import pytest
from pydantic import BaseModel

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.fit import with_geometry
from deltaid.identification.friction_choice import choose_friction, chosen_friction
from deltaid.identification.friction_constants import (
    LawConstants,
    _bounded,
    curve_rows,
    freed,
    moved,
)
from deltaid.identification.friction_rows import friction_rows
from deltaid.identification.identify import Identification, identify
from deltaid.identification.setup import Setup
from deltaid.identification.uncertainty import uncertainty
from deltaid.identification.warmth import Course, Warmth, changing_friction
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.motion.random_motion import random_motion
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.recording import open_recordings
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction, HessSoom, PowerLaw, Stribeck
from deltaid.robot.friction_terms import friction_terms
from deltaid.robot.load import load_robot
from deltaid.robot.parameter import TURNING
from logs import tabled

ROBOT, SECONDS, RATE = "clavel-delta3", 10.0, 1000.0
STRIBECK = Stribeck(coefficient=1.6, speed=0.4, exponent=2.0)
# A robot's motors and gears, as they are: the first differs by direction, the second has Stribeck's
# term, the third loses a share of what its gear carries.
TRUE = {
    "drive1": Friction(viscous=1.1, coulomb=4.4, viscous_back=0.9, coulomb_back=3.6),
    "drive2": Friction(viscous=1.0, coulomb=4.0, stribeck=STRIBECK),
    "drive3": Friction(viscous=1.0, coulomb=4.0, load=0.08),
}
# What else may be put right is not looked for.
FRICTION = Settings(lag="none", compliance="none", effects="none", events=False)

Change = Callable[[np.ndarray], np.ndarray]


def recorded(
    robot: RobotDescription, seed: int, *, late: float = 0.0, warm: Change | None = None
) -> pl.DataFrame:
    """A random motion of a robot with the described parameters; torques with 2 % of noise.

    Args:
        late: by how much torques are [s].
        warm: by what share all friction grows over time.
    """
    dynamics, rng = compiled(robot), np.random.default_rng(seed)
    motion, p = random_motion(dynamics.kinematics, rng), prior_parameters(robot)
    time = np.arange(round(SECONDS * RATE)) / RATE
    z, zd, zdd = motion.evaluate(time - late)
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, p)
    if warm is not None:
        without = p.copy()
        without[dynamics.layout.friction] = 0.0
        tau += warm(time)[:, None] * (tau - dynamics.torque(z, qd, qdd, without))
    tau += 0.02 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    q = 1e-6 * np.round(dynamics.kinematics.drive_motion(*motion.evaluate(time))[0] / 1e-6)
    return tabled(t=time, q=q, tau=tau)


def curve(law: Friction, v: np.ndarray) -> np.ndarray:
    """Friction over speed without what depends on load, by the graph of each term."""
    total, x = np.zeros_like(v), ca.SX.sym("v")
    for term in friction_terms({"j": (law, TURNING)}):
        if not term.of_load:
            h = ca.Function("h", [x], [term.h(x, ca.sign(x), ca.SX(0))])
            total += term.size * np.array(h(v[None])).ravel()
    return total


@cache
def fitted_once() -> Identification:
    robot = load_robot(ROBOT)
    return identify(robot, recorded(robot.changed(friction=TRUE), 1, late=8e-4))


def further(laws: Mapping[str, Friction]) -> dict[str, set[str]]:
    """What each joint's law has beside viscous and Coulomb friction."""
    return {
        joint: set(law.model_dump(exclude_none=True)) - {"viscous", "coulomb"}
        for joint, law in laws.items()
    }


# --- the law --------------------------------------------------------------------------------------


def test_each_drive_gets_its_law_and_the_lag_is_no_part_of_it() -> None:
    """0.8 ms of lag, which ±10 % of friction by direction would otherwise be mistaken for."""
    model = fitted_once().model
    assert further(model.robot.friction) == {
        "drive1": {"viscous_back", "coulomb_back"},
        "drive2": {"stribeck"},
        "drive3": {"load"},
    }
    texts = {
        correction.subject: correction.text
        for correction in model.corrections
        if correction.kind == "friction"
    }
    assert set(texts) == set(TRUE)
    assert "Stribeck" in texts["drive2"]
    # A constant that the others may have is one by direction where the law is.
    missed = fitted_once().problem.undetected
    assert {"coulomb_back.drive1", "offset.drive2", "offset.drive3"} <= set(missed)
    assert "offset.drive1" not in missed
    assert "share of the load" in texts["drive3"]
    lags = np.array(
        [correction.value for correction in model.corrections if correction.kind == "lag"],
        dtype=float,
    )
    assert len(lags)
    np.testing.assert_allclose(lags, 8e-4, atol=1e-4)
    assert model.value("load.drive3") == pytest.approx(0.08, rel=0.1)
    law = model.robot.friction["drive2"].stribeck
    assert law.speed == pytest.approx(0.4, rel=0.15)


def test_a_plain_recording_gets_no_term_and_nothing_is_reported() -> None:
    """A temperature that goes its own way changes nothing either."""
    robot, rng = load_robot(ROBOT), np.random.default_rng(0)
    log = recorded(robot, 2)
    oil = 40 + 0.01 * np.cumsum(rng.standard_normal(len(log)))
    mapping = ColumnMapping.model_validate({"temperature": {"column": "oil"}})
    model = identify(robot, log.with_columns(pl.Series("oil", oil)), columns=mapping).model
    assert model.robot == robot
    assert not [
        correction
        for correction in model.corrections
        if correction.kind in ("friction", "temperature")
    ]
    assert model.friction_choice.steps == ()


def test_described_laws_are_left_alone_where_that_is_asked_for() -> None:
    setup = Setup(load_robot(ROBOT), (), Settings(friction="described"))
    assert chosen_friction(setup, print) is setup
    assert changing_friction(setup, print) is setup


def test_described_terms_stay_and_constants_that_are_wrong_are_moved() -> None:
    robot = load_robot(ROBOT)
    truth = dict(robot.friction) | {"drive2": TRUE["drive2"]}
    off = TRUE["drive2"].changed(stribeck=STRIBECK.changed(speed=1.2))
    power = robot.friction["drive3"].changed(power=PowerLaw(coefficient=0.05, exponent=2.0))
    dynamics = compiled(robot.changed(friction=truth | {"drive2": off, "drive3": power}))
    log = recorded(robot.changed(friction=truth), 3)
    rows = friction_rows(dynamics, open_recordings(log, dynamics.kinematics))
    laws = choose_friction(rows)[0].friction
    assert further(laws) == {"drive1": set(), "drive2": {"stribeck"}, "drive3": {"power"}}
    law = laws["drive2"].stribeck
    assert law.speed == pytest.approx(0.4, rel=0.15)


# --- the whole curve ------------------------------------------------------------------------------


def test_intervals_hold_whole_curves_and_are_of_use() -> None:
    shares = []
    for friction_curve in fitted_once().model.friction_curves:
        v = np.linspace(0.05, 1.0, 30) * max(friction_curve.speed)
        v = np.concatenate([-v[::-1], v])
        truth, (low, high) = curve(TRUE[friction_curve.joint], v), friction_curve.band(v)
        shares.append(np.mean((low <= truth) & (truth <= high)))
        largest = np.abs(truth).max()
        # What may be an offset of the torque is counted twice, for either way.
        constant = np.abs(truth + truth[::-1]).min()
        assert np.all(high - low < 0.12 * largest + 1.1 * constant), friction_curve.joint
        np.testing.assert_allclose(0.5 * (low + high), truth, atol=0.03 * largest)
    assert len(shares) == 3
    assert np.mean(shares) >= 0.85


def test_a_curve_is_less_certain_where_its_constants_are_unknown() -> None:
    fitted = fitted_once()
    problem = with_geometry(replace(fitted.problem, moves=()), fitted.recordings)
    rows = curve_rows(problem, "drive2", np.array([0.4, 5.0]))
    (constants,) = (extra for extra in problem.additions if isinstance(extra, LawConstants))
    names = [parameter.name for parameter in constants.parameters]
    assert names == ["stribeck_speed.drive2", "stribeck_exponent.drive2"]
    at = [problem.layout.names.index(name) for name in names]
    assert not np.any(problem.values[at])
    judged = freed(problem)
    np.testing.assert_array_equal(judged.values, problem.values)
    known, unknown = (uncertainty(each, rows).std for each in (problem, judged))
    assert unknown[0] > 1.05 * known[0]
    assert np.all(unknown >= 0.99 * known)
    single = np.eye(len(problem.layout.names))
    np.testing.assert_allclose(uncertainty(problem, single).std, uncertainty(problem).std)


def test_the_curve_is_the_law_of_the_model() -> None:
    result = fitted_once()
    law = result.model.robot.friction["drive2"]
    values = {t.kind: result.model.value(f"{t.kind}.drive2")
              for t in friction_terms({"drive2": (law, TURNING)})}  # fmt: skip
    settled = Friction(viscous=values["viscous"], coulomb=values["coulomb"],
        stribeck=law.stribeck.changed(coefficient=values["stribeck"]))  # fmt: skip
    drive_curve = next(
        friction_curve
        for friction_curve in result.model.friction_curves
        if friction_curve.joint == "drive2"
    )
    v = np.array(drive_curve.speed)
    np.testing.assert_allclose(
        curve(settled, v), drive_curve.friction, atol=1e-9 * max(drive_curve.friction)
    )
    saved = IdentifiedModel.model_validate(result.model.model_dump())
    assert saved.friction_curves == result.model.friction_curves


@pytest.mark.parametrize(
    ("kind", "part"),
    [
        ("power", PowerLaw(coefficient=1.0, exponent=0.6)),
        ("stribeck", Stribeck(coefficient=1.0, speed=0.3, exponent=1.4)),
        ("hess_soom", HessSoom(coefficient=1.0, speed=0.5)),
    ],
)
def test_shapes_are_those_of_the_graphs_and_slopes_their_changes(
    kind: str, part: BaseModel
) -> None:
    law = Friction.model_validate({"viscous": 1.0, "coulomb": 1.0, kind: part})
    plain, v = Friction(viscous=1.0, coulomb=1.0), np.geomspace(1e-3, 5.0, 40)

    def term(law: Friction):
        return next(t for t in friction_terms({"j": (law, TURNING)}) if t.kind == kind)

    expected = curve(law, v) - curve(plain, v)
    np.testing.assert_allclose(term(law).values(v), expected, atol=1e-8)
    np.testing.assert_allclose(term(law).values(-v), curve(law, -v) - curve(plain, -v), atol=1e-8)
    constants = set(type(part).model_fields) - {"coefficient"}
    assert set(term(law).slopes(v)) == constants
    for name, slope in term(law).slopes(v).items():
        up, down = (term(moved(law, kind, name, step)).values(v) for step in (1e-5, -1e-5))
        np.testing.assert_allclose(slope, (up - down) / 2e-5, atol=1e-7)


def test_what_columns_leave_open_of_coefficients_stays_near_the_prior() -> None:
    """As where gains stand beside all friction; what they determine is that of least squares."""
    rng = np.random.default_rng(0)
    A, prior = rng.standard_normal((200, 3)), np.array([3.0, 1.0, 2.0, 0.5])
    A, b = np.column_stack([A, A @ [1.0, 2.0, -1.0]]), rng.standard_normal(200)
    A *= [1e4, 1.0, 1.0, 0.1]
    bounds = np.full(4, -np.inf), np.full(4, np.inf)
    x = _bounded(A, b, *bounds, prior)
    left = np.linalg.norm(b - A @ np.linalg.lstsq(A, b, rcond=None)[0])
    assert np.linalg.norm(b - A @ x) == pytest.approx(left, rel=1e-9)
    norms = np.linalg.norm(A, axis=0)
    open_ = np.linalg.svd(A / norms)[2][-1]
    assert open_ @ (norms * (x - prior)) == pytest.approx(0.0, abs=1e-3)


# --- warmth ---------------------------------------------------------------------------------------


def cooling(time: np.ndarray) -> np.ndarray:
    """Friction falls by a fifth of itself, with a time constant of 4 s."""
    return 0.2 * np.exp(-time / 4.0)


def test_friction_of_a_robot_that_warms_up_is_that_of_the_mean() -> None:
    robot = load_robot(ROBOT)
    model = identify(robot, recorded(robot, 4, warm=cooling), settings=FRICTION).model
    (thermal_correction,) = (
        correction for correction in model.corrections if correction.kind == "temperature"
    )
    assert thermal_correction.value == pytest.approx(4.0, rel=0.3)
    shares = re.findall(r"drive\d ([-\d.]+) and ([-\d.]+) %", thermal_correction.text)
    assert np.array(shares, float) == pytest.approx(np.full((len(robot.drives), 2), -19.0), abs=4.0)
    assert not any(further(model.robot.friction).values())
    mean = 1 + np.mean(cooling(np.arange(0, SECONDS, 0.001)))
    for drive in robot.drives:
        law = robot.friction[drive]
        assert model.value(f"coulomb.{drive}") == pytest.approx(mean * law.coulomb, rel=0.015)
        assert model.value(f"viscous.{drive}") == pytest.approx(mean * law.viscous, rel=0.015)


def test_a_warm_up_changes_both_directions_of_a_law() -> None:
    dynamics = compiled(load_robot(ROBOT).changed(friction=TRUE))
    (recording,) = open_recordings(recorded(dynamics.robot, 1), dynamics.kinematics)
    warmth = Warmth(dynamics, (Course(recording, 0.0, 4.0, 0.2, -0.9),))
    names = [parameter.name for parameter in warmth.parameters]
    assert {f"{kind}_change.drive1" for kind in ("viscous_back", "coulomb_back")} < set(names)
    w = next(recording.windows(dynamics.kinematics)).inner
    own = dynamics.sparse_regressor(w.z, w.qd, w.qdd, 0 * w.qd).values
    drives, columns = warmth.pattern
    back = (drives == 0) & (columns == names.index("coulomb_back_change.drive1"))
    expected = -1.0 * (w.qd[:, 0] < 0) * (np.exp(-w.time / 4.0) - 0.2)
    np.testing.assert_allclose(warmth.entries(w, own, recording)[back][0], expected, atol=1e-12)
    # A clock that passes midnight comes before it began.
    assert np.all(Course(recording, 1e5, 4.0, 0.2, -0.9).values(w) == 0.8)


def test_friction_follows_a_temperature_that_is_recorded() -> None:
    """In whatever unit: its changes are per kelvin."""
    robot, rng = load_robot(ROBOT), np.random.default_rng(0)
    log = recorded(robot, 5, warm=cooling)
    oil = 50 - 100 * cooling(log["t"].to_numpy()) + 0.02 * rng.standard_normal(len(log))
    log = log.with_columns(pl.Series("oil", 32 + 1.8 * oil))
    mapping = ColumnMapping.model_validate({"temperature": {"column": "oil", "unit": "degF"}})
    result = identify(robot, log, columns=mapping, settings=FRICTION)
    problem, names = result.problem, result.problem.layout.names
    for drive in robot.drives:
        change = problem.values[names.index(f"coulomb_change.{drive}")]
        assert change == pytest.approx(-robot.friction[drive].coulomb / 100, rel=0.2)
    (thermal_correction,) = (
        correction for correction in result.model.corrections if correction.kind == "temperature"
    )
    assert "with its temperature" in thermal_correction.text
    mean = 1 + np.mean(cooling(log["t"].to_numpy()))
    law = robot.friction["drive1"]
    assert result.model.value("coulomb.drive1") == pytest.approx(mean * law.coulomb, rel=0.015)
