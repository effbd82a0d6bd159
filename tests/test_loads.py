"""Loads that are declared: identified with the robot, shared between recordings, told, saved."""

from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from command import run
from deltaid.checks.identify import identify as judged
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.effects.load_columns import LoadColumns
from deltaid.errors import RecordingError, UnknownNameError
from deltaid.identification.gains import Gains, gains
from deltaid.identification.identify import Identification, identify
from deltaid.identification.loads import declared_loads, held_loads, joined_loads
from deltaid.identification.prediction import validate
from deltaid.identification.setup import Setup
from deltaid.model.model import load
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.model.verdict import Grade
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.recording import open_recordings
from deltaid.robot.body import InertiaTensor
from deltaid.robot.inertia import consistency
from deltaid.robot.load import load_robot
from logs import tabled
from support import along, largest_mass_error
from sweeps import swept

RATE, DURATION, NOISE = 250.0, 10.0, 0.005
CENTRE, MASS, OWN = np.array([0.03, -0.015, -0.06]), 0.8, 1.2e-3
PLAIN = Settings(lag="none", events=False, friction="described")
LATE = Settings(events=False, friction="described")
GRIPPER = ColumnMapping(load=Load(column="gripper"))


def robot(name: str = "irb360-6-1600") -> tuple[Dynamics, np.ndarray]:
    dynamics = compiled(load_robot(name))
    return dynamics, surrogate_parameters(dynamics.robot, np.random.default_rng(4))


def body(mass: float = MASS) -> np.ndarray:
    """Ten parameters of the load about the tool's frame."""
    c, m = CENTRE, mass
    I = OWN * np.eye(3) + m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([m, *(m * c), I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[1, 2], I[0, 2]])


def table(
    seed: int,
    held: str,
    name: str = "irb360-6-1600",
    gain: float | np.ndarray = 1.0,
    late: int = 0,
    noise: float = NOISE,
) -> pl.DataFrame:
    """A recording that holds the load in cycles, always or never, and says so in a column."""
    dynamics, p = robot(name)
    rng, t = np.random.default_rng(seed), np.arange(round(DURATION * RATE)) / RATE
    _, q, qd, qdd = along(dynamics.kinematics, rng, t, period=3.917)
    with_load = p.copy()
    with_load[dynamics.layout.body(dynamics.robot.load_carrier)] += body()
    state = {"cycles": np.sin(2 * np.pi * t / 1.37) > 0.2, "always": t >= 0, "never": t < 0}[held]
    bare, loaded = (dynamics.inverse_dynamics(q, qd, qdd, x) for x in (p, with_load))
    tau = np.where(state[:, None], loaded, bare) / gain
    tau += noise * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    tau = np.roll(tau, late, axis=0)
    return tabled(t=t, q=q, tau=tau, gripper=state.astype(float))[20:-20]


def mass_error(model: IdentifiedModel, name: str = "irb360-6-1600") -> float:
    """Largest error of the mass matrix at home, as a share of √(M_ii M_jj), of limbs' drives: a
    random motion hardly tells the tool's."""
    dynamics, p = robot(name)
    home = dynamics.kinematics.inverse(dynamics.kinematics.home[None])
    return largest_mass_error(*(dynamics.mass_matrix(home, x)[:, :3, :3] for x in (model.p, p)))


@cache
def cycles() -> Identification:
    return identify(robot()[0].robot, table(1, "cycles"), columns=GRIPPER, settings=PLAIN)


def test_an_unknown_load_is_found_and_the_model_is_of_the_robot_without_it() -> None:
    model = cycles().model
    (found,) = model.loads
    true, value = body(), found.p
    assert (found.name, found.body, found.logs) == ("load", "EE", ("table",))
    for k in (0, 1, 2, 6):  # mass, what shows of its centre, inertia about the tool's axis
        parameter = found.parameters[k]
        assert parameter.determined_by == "data"
        assert parameter.low < true[k] < parameter.high
    assert abs(value[0] / true[0] - 1) < 0.003
    assert abs(value[6] / true[6] - 1) < 0.02
    assert found.mass.high - found.mass.low < 0.02 * MASS
    assert found.parameters[3].determined_by != "data"
    assert consistency(value) > 0
    assert mass_error(model) < 0.003
    (load_correction,) = [
        correction for correction in model.corrections if correction.kind == "load"
    ]
    assert load_correction.value == found.mass.value
    assert load_correction.low == found.mass.low
    assert "was identified" in load_correction.text


def test_what_is_left_of_the_torques_is_noise() -> None:
    model = cycles().model
    alone = PLAIN.changed(effects="none")
    plain = identify(robot()[0].robot, table(1, "cycles"), settings=alone).model
    assert max(model.fit.nrmse) < 0.35 * max(plain.fit.nrmse)
    assert mass_error(plain) > 10 * mass_error(model)


def test_a_load_is_one_thing_in_all_recordings_that_name_it() -> None:
    tables = [table(2, "never"), table(3, "always"), table(4, "cycles")]
    part = Load(column="gripper", name="part")
    mappings = [None, ColumnMapping(load=Load(always=True, name="part")), ColumnMapping(load=part)]
    model = identify(robot()[0].robot, tables, columns=mappings, settings=PLAIN).model
    (found,) = model.loads
    assert found.logs == ("table 2", "table 3")
    assert found.mass.low < MASS < found.mass.high
    alone = cycles().model.loads[0].mass
    assert found.mass.std < 0.8 * alone.std
    assert mass_error(model) < 0.003


def test_two_loads_are_distinguished() -> None:
    both = table(5, "cycles").with_columns(late=(pl.col("t") > 6).cast(pl.Float64))
    dynamics, _ = robot()
    more = Load(column="late", name="ghost")
    model = identify(
        dynamics.robot,
        both,
        columns=ColumnMapping(load=(Load(column="gripper"), more)),
        settings=PLAIN,
    ).model
    first, ghost = model.loads
    assert abs(first.mass.value / MASS - 1) < 0.003
    assert ghost.mass.value < 0.01 * MASS


@pytest.mark.parametrize("known", swept(["mass and centre", "all", "tolerance"], "tolerance"))
def test_what_is_known_of_a_load_stays(known: str) -> None:
    given = {"mass": MASS, "centre": tuple(CENTRE)}
    if known in ("all", "tolerance"):
        given |= {"inertia": InertiaTensor(xx=OWN, yy=OWN, zz=OWN)}
    if known == "tolerance":
        given |= {"mass": 1.05 * MASS, "mass_tolerance": 0.05}
    held = ColumnMapping(load=Load.model_validate({"column": "gripper"} | given))
    model = identify(robot()[0].robot, table(1, "cycles"), columns=held, settings=PLAIN).model
    (found,) = model.loads
    (load_correction,) = [
        correction for correction in model.corrections if correction.kind == "load"
    ]
    assert ("its mass is known" in load_correction.text) == (known != "tolerance")
    if known == "tolerance":
        assert found.mass.determined_by == "data"
        assert found.mass.value == pytest.approx(MASS, rel=0.01)
        np.testing.assert_allclose(found.p[1:4] / found.p[0], CENTRE, rtol=1e-9)
    else:
        assert found.p[0] == pytest.approx(MASS, rel=1e-12)
        np.testing.assert_allclose(found.p[1:3], MASS * CENTRE[:2], rtol=0.1)
        assert found.p[6] == pytest.approx(body()[6], rel=0.05)
    assert mass_error(model) < 0.003


def test_a_load_that_is_held_all_the_time_is_hardly_distinguished_from_the_tool() -> None:
    held = ColumnMapping(load=Load(always=True))
    model = identify(robot()[0].robot, table(1, "always"), columns=held, settings=PLAIN).model
    (load_correction,) = [
        correction for correction in model.corrections if correction.kind == "load"
    ]
    assert load_correction.low < MASS < load_correction.high
    assert "hardly separate it from EE itself" in load_correction.text


def test_a_platform_shows_the_mass_only() -> None:
    name = "clavel-delta3"
    model = identify(
        robot(name)[0].robot, table(1, "cycles", name), columns=GRIPPER, settings=PLAIN
    ).model
    (found,) = model.loads
    assert found.body == "P"
    assert abs(found.mass.value / MASS - 1) < 0.003
    assert [parameter.determined_by for parameter in found.parameters].count("data") == 1
    assert mass_error(model, name) < 0.003


def test_a_lag_and_a_load_are_found_together() -> None:
    model = identify(
        robot()[0].robot, table(1, "cycles", late=1), columns=GRIPPER, settings=LATE
    ).model
    lags = [correction.value for correction in model.corrections if correction.kind == "lag"]
    assert lags
    for value in lags:
        assert value == pytest.approx(4e-3, abs=1e-4)
    assert abs(model.loads[0].mass.value / MASS - 1) < 0.015
    assert mass_error(model) < 0.003


def test_a_known_load_in_one_of_two_recordings_tells_gains() -> None:
    dynamics, _ = robot()
    gain = np.array([1.07, 0.94, 1.03, 0.96])
    known = Load(always=True, mass=MASS, centre=tuple(CENTRE), name="kilogram")
    tables = [table(2, "never", gain=gain), table(3, "always", gain=gain)]
    opened = open_recordings(tables, dynamics.kinematics, [None, ColumnMapping(load=known)])
    setup = declared_loads(Setup(dynamics.robot, tuple(opened), Settings()), lambda _: None)
    found = gains(setup, lambda _: None).additions[-1]
    assert isinstance(found, Gains)
    np.testing.assert_allclose(found.gain[:3], gain[:3], rtol=0.005)


def test_a_model_with_loads_is_saved_and_verified_with_them(tmp_path: Path) -> None:
    model = cycles().model
    model.save(tmp_path / "model.yaml")
    again = IdentifiedModel.load(tmp_path / "model.yaml")
    assert again.loads == model.loads
    other = table(7, "cycles")
    held, _ = validate(again, other, columns=GRIPPER)
    bare, _ = validate(again, other)
    known = {"column": "gripper", "name": "kilo", "mass": MASS, "centre": tuple(CENTRE)}
    stated, _ = validate(again, other, columns=ColumnMapping(load=Load.model_validate(known)))
    assert held.nrmse.max() < 0.35 * bare.nrmse.max()
    np.testing.assert_allclose(stated.nrmse, held.nrmse, rtol=0.1)
    strange = ColumnMapping(load=Load(column="gripper", name="other"))
    with pytest.raises(RecordingError, match="holds load other, which is not one of the model's"):
        validate(again, other, columns=strange)


def test_a_model_takes_a_load_up() -> None:
    model = load(cycles().model)
    loaded = model.with_load("load")
    part = model.layout.body("EE")
    np.testing.assert_allclose(loaded.p[part] - model.p[part], model.identified.loads[0].p)  # pyright: ignore[reportOptionalMemberAccess]
    np.testing.assert_allclose(model.with_load(body(), "EE").p[part] - model.p[part], body())
    with pytest.raises(UnknownNameError, match=r"(?s)no load 'ghost'.* there are: load"):
        model.with_load("ghost")


def test_an_export_takes_a_load_by_its_name(tmp_path: Path) -> None:
    path, out = tmp_path / "model.yaml", tmp_path / "held.npz"
    cycles().model.save(path)
    asked = ("export", path, "--to", "npz", "-o", out, "--payload")
    assert run(*asked, "load").code == 0
    assert (np.load(out)["p"] == load(path).with_load("load").p).all()
    outcome = run(*asked, "ghost")
    assert outcome.code == 2
    assert "--payload: 'ghost' is no mass" in outcome.err
    assert "give kilograms, as 1.5, or one of load" in outcome.err


@pytest.mark.slow
def test_a_load_that_nobody_declares_is_detected_and_is_no_gear_that_winds_up() -> None:
    found = judged(robot()[0].robot, table(1, "cycles"))
    assert [verdict.grade for verdict in found.verdicts if verdict.key == "load-change"] == [
        Grade.DOUBTFUL
    ]
    assert [correction.kind for correction in found.model.corrections] == ["load"]
    (study,) = found.detected.values()
    assert study.is_disturbed


def test_contradictions_about_a_load_are_refused() -> None:
    dynamics, _ = robot()
    tables = [table(2, "never"), table(3, "always")]

    def opened(first: Load, second: Load) -> tuple[Load, ...]:
        columns = [ColumnMapping(load=load) for load in (first, second)]
        return joined_loads(held_loads(open_recordings(tables, dynamics.kinematics, columns)))

    gripped, other = Load(column="gripper", mass=1.0), Load(always=True, mass=2.0)
    with pytest.raises(RecordingError, match="load load has another mass"):
        opened(gripped, other)
    (both,) = opened(Load(column="gripper"), other)
    assert both.mass == 2.0
    with pytest.raises(RecordingError, match="X is no body of the robot"):
        _ = LoadColumns(dynamics, Load(always=True, body="X"), 0.5, np.zeros(10)).body


def test_a_tolerance_is_the_standard_deviation_of_a_mass() -> None:
    """Scales of parameters are in units of the fit's spread."""
    load = Load(always=True, mass=2.0, mass_tolerance=0.03)
    columns = LoadColumns(compiled(load_robot("clavel-delta3")), load, 0.4, np.zeros(10))
    assert columns.parameters[0].scale * 0.4 == pytest.approx(0.03)
