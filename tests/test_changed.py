"""Copies of descriptions with other values are validated as files are."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import deltaid
from deltaid.errors import DescriptionError
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.robot.own import OwnMechanism
from logs import write
from support import KINDS

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


def test_the_public_way() -> None:
    robot = deltaid.load_robot("clavel-delta3")
    assert robot.changed(title="mine").title == "mine"
