"""A robot with its parameters: loaded from a name, a robot file, a model file; taken everywhere."""

import json
import math
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import deltaid
from command import accepted, refused
from deltaid.dynamics.limits import effort_limits
from deltaid.dynamics.parameters import inertia_scale, least_margin, with_prior
from deltaid.errors import DescriptionError
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import simulate_recording, surrogate_parameters, write_recording
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.robot.own import OwnMechanism
from identified import identified
from logs import write
from support import KINDS

NAME = "clavel-delta3"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot file, a model file and two recordings of the same robot."""
    folder, found = tmp_path_factory.mktemp("model"), identified(NAME)
    rng = np.random.default_rng(3)
    shutil.copytree(found.folder, folder, dirs_exist_ok=True)
    motion = random_motion(found.dynamics.kinematics, rng)
    made = simulate_recording(found.dynamics, found.p, motion, rng, duration=4.0, rate=500.0)
    write_recording(made, folder / "other.csv")
    return folder


def test_name_robot_file_and_model_file(folder: Path) -> None:
    prior = deltaid.prior_parameters(deltaid.load_robot(NAME))
    for source in (NAME, folder / "robot.yaml", str(folder / "robot.yaml")):
        model = deltaid.load(source)
        assert model.identified is None
        assert model.origin == "the prior of its description"
        np.testing.assert_array_equal(model.p, prior)
    model = deltaid.load(folder / "model.yaml")
    assert model.identified is not None
    assert model.origin == "identified from log.csv"
    np.testing.assert_array_equal(model.p, deltaid.IdentifiedModel.load(folder / "model.yaml").p)
    assert not np.allclose(model.p, prior)
    assert deltaid.load(model) is model
    assert deltaid.load(model.identified).p.tolist() == model.p.tolist()
    assert deltaid.load(model.robot).source == NAME


@pytest.mark.parametrize(
    ("pattern", "new", "message"),
    [
        (r"(?ms)^parameters:.*?(?=^base_parameters)", "", "line 1, parameters: is missing"),
        (r"(?ms)^parameters:.*?(?=^base_parameters)", "parameters: []\n", "parameters: "),
        (r"unit: kg$", "unit: g", r"line \d+, parameters\[1\]\.unit: is g, but U\.m is in kg"),
        (r"\n# deltaid-sha256.*|unit: kg$", "", r"line \d+, parameters\[1\]\.unit: is missing"),
        (r"name: U\.m$", "name: U.mcx", "parameters: are not those of the robot, in its order"),
    ],
)
@pytest.mark.parametrize("reader", [deltaid.load, deltaid.Dynamics, deltaid.load_robot])
def test_a_damaged_model_file_is_no_description(
    folder: Path, tmp_path: Path, pattern: str, new: str, message: str, reader: Callable
) -> None:
    text = (folder / "model.yaml").read_text(encoding="utf-8")
    damaged = re.sub(pattern, new, text, count=1, flags=re.M)
    assert damaged != text
    path = tmp_path / "model.yaml"
    path.write_text(damaged, encoding="utf-8")
    if reader is deltaid.load_robot and "\nparameters:\n" in damaged:
        assert reader(path).name == NAME  # reads the robot alone
        return
    with pytest.raises(DescriptionError, match=message) as refused:
        reader(path)
    assert "take back what `deltaid identify` wrote" in str(refused.value)


def test_a_base_parameter_in_another_unit_is_refused(folder: Path, tmp_path: Path) -> None:
    head, key, rest = (folder / "model.yaml").read_text(encoding="utf-8").partition("\nbase_par")
    path = tmp_path / "model.yaml"
    path.write_text(head + key + rest.replace("unit: kg m\n", "unit: g m\n", 1), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"base_parameters\[\d+\]\.unit: is g m, but U"):
        deltaid.load(path)


def test_functions_take_names_files_and_values(folder: Path) -> None:
    model = deltaid.load(folder / "model.yaml")
    for source in (NAME, folder / "robot.yaml", folder / "model.yaml", model, model.dynamics):
        assert deltaid.Kinematics(source).dof == 3
        assert deltaid.Dynamics(source).robot == model.robot
        assert deltaid.ForwardDynamics(source).robot == model.robot
        assert deltaid.ConstraintForces(source).struts == ("strut1", "strut2", "strut3")
    for source in (NAME, folder / "robot.yaml", folder / "model.yaml", model, model.robot):
        error, _ = deltaid.validate(source, folder / "other.csv")
        assert (error.nrmse.max() < 0.1) == (deltaid.load(source).identified is not None)


def test_a_body_without_thickness_can_exist() -> None:
    model = deltaid.load(NAME)
    p = model.p.copy()
    p[model.layout.body("P")] = [0.8, 0, 0, 0, 0.1 / 3, 0.1 / 3, 0.1 / 3 + 0.1 / 3, 0, 0, 0]
    assert replace(model, p=p).body("P")[0] == 0.8


@pytest.mark.parametrize(
    "command",
    ["torque", "validate", "forces", pytest.param("compare-controllers", marks=pytest.mark.slow)],
)
def test_commands_take_a_robot_and_say_so(command: str, folder: Path, tmp_path: Path) -> None:
    options = {
        "torque": ("-o", tmp_path / "tau.csv"),
        "compare-controllers": ("--plant", folder / "model.yaml", "--bandwidth", 5),
    }
    rows = (folder / "other.csv").read_text().splitlines(keepends=True)
    short = tmp_path / "short.csv"
    short.write_text("".join(rows[: 200 if command == "compare-controllers" else 2000]))
    for source in (NAME, folder / "robot.yaml"):
        outcome = accepted(command, source, short, *options.get(command, ()), width=200)
        name = Path(source).name
        assert f"{name} is a robot: it stands for its prior parameters" in outcome.err
    outcome = accepted(command, folder / "model.yaml", short, *options.get(command, ()))
    assert "stands for its prior" not in outcome.err


def test_identify_takes_the_robot_of_a_model_and_says_so(folder: Path, tmp_path: Path) -> None:
    new = tmp_path / "m.yaml"
    outcome = accepted("identify", folder / "model.yaml", folder / "other.csv", "-o", new)
    assert "model.yaml is a model: its robot is identified anew, from its prior" in outcome.err
    again = deltaid.identify(NAME, [folder / "other.csv"]).model
    assert deltaid.IdentifiedModel.load(new).parameters == again.parameters


def test_excite_plans_with_the_identified_parameters(folder: Path) -> None:
    outcome = accepted("excite", folder / "model.yaml", "--starts", 1, "--harmonics", 2, "--json")
    assert "model.yaml is a model: planned with its masses and friction" in outcome.err
    known = deltaid.load(folder / "model.yaml")
    values = [each["prior"] for each in json.loads(outcome.out)["predictions"]]
    problem = identified(NAME).result.problem
    assert sorted(values) == pytest.approx(sorted(problem.base.values(known.p)), rel=1e-6)


def test_a_model_as_description_has_its_parameters_as_prior() -> None:
    robot = laws_of_all_kinds()
    p = surrogate_parameters(robot, np.random.default_rng(1))
    prior = deltaid.prior_parameters(with_prior(robot, p))
    layout = deltaid.load(robot).layout
    signed = [layout.names.index("offset.drive2")]
    np.testing.assert_allclose(np.delete(prior, signed), np.delete(p, signed), rtol=1e-12)
    assert prior[signed] == 0


def laws_of_all_kinds() -> deltaid.RobotDescription:
    """A Delta with every term of friction, a spring and a rotor."""
    data = deltaid.load_robot(NAME).model_dump()
    plain = {"viscous": 1.5, "coulomb": 4.0}
    stribeck = {"coefficient": 1.0, "speed": 0.3, "exponent": 2.0}
    data["friction"] = {
        "drive1": plain | {"viscous_back": 1.2, "coulomb_back": 3.0, "load": 0.05},
        "drive2": plain | {"offset": 0.4, "power": {"coefficient": 0.7, "exponent": 0.5}},
        "drive3": plain | {"stribeck": stribeck, "hess_soom": {"coefficient": 0.6, "speed": 0.4}},
    }
    data["springs"] = {"drive1": {"stiffness": 2.0, "rest_deg": 10.0}}
    data["rotor_inertia"] = {"drive3": 0.01}
    return deltaid.RobotDescription.model_validate(data)


@pytest.mark.parametrize(("value", "possible"), [(0.3, True), (1.2, False), (-0.1, False)])
def test_a_share_of_the_torque_lies_between_its_bounds(value: float, possible: bool) -> None:
    model = deltaid.load(laws_of_all_kinds())
    p = model.p.copy()
    p[model.layout.names.index("load.drive1")] = value
    worst, margin = least_margin(model.layout, p)
    assert (margin > 0) == possible
    assert possible or worst == "load.drive1"


def test_entries_that_are_zero_have_the_scale_of_their_body() -> None:
    m, r = 2.0, 0.3  # a thin ring about z, whose Σ has the trace m r²
    p = np.array([m, 0, 0, 0, 0.5 * m * r**2, 0.5 * m * r**2, m * r**2, 0, 0, 0])
    expected = np.array([m, *[m * r] * 3, *p[4:7], *[m * r**2] * 3])
    np.testing.assert_allclose(inertia_scale(p), expected, rtol=1e-12)


def test_a_drive_without_a_limit_may_have_any_torque() -> None:
    robot = deltaid.load_robot(NAME).changed(drive_limits={"drive2": {"torque": 12.0}})
    limits = effort_limits(robot)
    np.testing.assert_array_equal(limits, [np.inf, 12.0, np.inf])


def test_a_report_of_a_prior_says_so(folder: Path, tmp_path: Path) -> None:
    for command in ("validate", "forces"):
        page = tmp_path / f"{command}.html"
        accepted(command, NAME, folder / "other.csv", "--report", page)
        assert "the prior of its description" in page.read_text(encoding="utf-8")


def test_ranges_need_an_identified_model(folder: Path, tmp_path: Path) -> None:
    message = refused(
        "forces", NAME, folder / "other.csv", "--logs", folder / "log.csv", folder=tmp_path
    )
    assert "comes from no recordings" in message


CLAVEL = load_robot("clavel-delta3")
LIMBS = CLAVEL.limbs
MECHANISM = OwnMechanism(drives=("rotary",) * 3, bodies=("viscous", "rotor"))


@pytest.mark.parametrize("value", [-0.5, math.nan, math.inf, 0.0, "x", None])
def test_a_strut_that_cannot_be(value: object) -> None:
    with pytest.raises(DescriptionError, match="Limbs: strut: must be"):
        LIMBS.changed(strut=value)
    with pytest.raises(DescriptionError, match="Limbs: strut: must be"):
        LIMBS.model_copy(update={"strut": value})


@pytest.mark.parametrize(
    ("part", "updates", "fragment"),
    [
        (LIMBS, {"strut_spacing": -0.5}, "Limbs: strut_spacing: must be greater than"),
        (LIMBS, {"strut_spacing": 80.0}, "strut_spacing: is 80 m, no less than the struts'"),
        (LIMBS, {"strut_spacing": math.nan}, "Limbs: strut_spacing: must be a finite number"),
        (LIMBS, {"strut": 1e20}, "Limbs: strut: 1e+20 m cannot be; lengths are in metres"),
        (LIMBS, {"strut_spacings": 0.1}, "Limbs: strut_spacings: unknown key"),
        (
            CLAVEL,
            {"friction": {"drive9": {"viscous": 1, "coulomb": 1}}},
            "friction: has unknown drive9",
        ),
        (CLAVEL, {"bodies": {}}, "RobotDescription: bodies: lacks U, S, P"),
        (CLAVEL, {"gravity": (0.0, 0.0, 0.0)}, "RobotDescription: gravity: is zero"),
        (CLAVEL.bodies["U"], {"free": ("m", "m")}, "names an entry twice"),
        (CLAVEL.friction["drive1"], {"viscous": -1.0}, "viscous: must be greater than"),
        (
            CLAVEL.friction["drive1"],
            {"viscous_back": 1.0, "coulomb_back": 1.0, "offset": 0.1},
            "Friction: offset: says the same as coulomb_back",
        ),
        (MECHANISM, {"angle_deg": (1.0, 0.0)}, "OwnMechanism: angle_deg: must be given as"),
        (MECHANISM, {"bodies": ("a", "a")}, "OwnMechanism: bodies: has a name twice"),
        (ColumnMapping(), {"header_row": 0}, "ColumnMapping: header_row: must be greater than"),
    ],
)
def test_what_cannot_be_is_named(part, updates, fragment: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        part.changed(**updates)
    assert fragment in str(caught.value)


@pytest.mark.parametrize("name", KINDS)
def test_nothing_changed_is_the_same(name: str) -> None:
    robot = load_robot(name)
    assert robot.changed() == robot
    assert robot.model_copy() == robot
    for key in RobotDescription.model_fields:
        assert robot.changed(**{key: getattr(robot, key)}) == robot


def test_only_what_is_changed_is_another() -> None:
    robot = CLAVEL.changed(limbs=LIMBS.changed(strut=1.0))
    assert (robot.limbs.strut, robot.limbs.upper_arm) == (1.0, LIMBS.upper_arm)
    assert robot.changed(limbs=LIMBS) == CLAVEL
    assert LIMBS.strut != 1.0


def test_a_mapping_keeps_its_file(tmp_path) -> None:
    path = write(tmp_path / "mapping.yaml", "header_row: 3\n")
    assert load_mapping(path).changed(header_row=4).source == str(path)


@settings(max_examples=50, deadline=None)
@given(st.sampled_from(sorted(type(LIMBS).model_fields)), st.floats() | st.integers() | st.text())
def test_any_value_is_taken_or_refused(key: str, value: object) -> None:
    try:
        limbs = LIMBS.changed(**{key: value})
    except DescriptionError as error:
        assert str(error).startswith("Limbs: ")  # noqa: PT017 - both ends are right
        return
    assert type(LIMBS).model_validate(limbs.model_dump()) == limbs
