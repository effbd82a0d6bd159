"""What a description says was measured, and lists of what sensors and scales would tell."""

from pathlib import Path

import pytest

from deltaid.checks.check import of_robot
from deltaid.dynamics.parameters import stated_spreads
from deltaid.errors import DeltaidError, DescriptionError
from deltaid.model.verdict import Grade
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue_text, load_robot, parse, yaml_text
from deltaid.sensors.planning.offers import Offers
from deltaid.sensors.planning.plan import PlanSettings, sensor_plan
from descriptions import CLAVEL, refusal, replaced

SENSORS = """
sensors:
  plate: {kind: base-wrench, force_noise: 0.5}
  gauge1: {kind: strut-force, strut: strut1a}
  torque1: {kind: joint-torque, drive: drive1}
"""


def with_text(text: str) -> str:
    return CLAVEL + text


def of_body(text: str) -> str:
    """The catalogue robot with other lines below the prior of its struts."""
    return replaced("    free: [m, mcx, Sxx, Syy, Szz]\n  P:", f"    {text}\n  P:")


def test_sensors_and_measured_values_that_fit() -> None:
    text = with_text(SENSORS) + "measured: [{mass: 1.2, of: {U: 1, S: 2}, std: 0.01}]\n"
    robot = parse(text, RobotDescription, where="robot.yaml")
    assert list(robot.sensors) == ["plate", "gauge1", "torque1"]
    assert robot.measured[0].placed[1].count == 2


def test_a_spread_is_that_of_its_entries() -> None:
    robot = parse(of_body("spread: {m: 0.1, Ixx: 0.2}"), RobotDescription, where="robot.yaml")
    assert stated_spreads(robot) == {"S.m": 0.1, "S.Ixx": 0.2}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sensors: {gauge: {kind: strut-force, strut: strut4}}", "has unknown strut4"),
        ("sensors: {gauge: {kind: strut-force, strut: strut1c}}", "did you mean strut1"),
        ("sensors: {gauge: {kind: joint-torque, drive: driv1}}", "did you mean drive1?"),
        ("sensors: {drive1: {kind: base-wrench}}", "sensors.drive1: is called as a joint is"),
        ("sensors: {S: {kind: base-wrench}}", "sensors.S: is called as a body is"),
        ("sensors: {tau1: {kind: base-wrench}}", "sensors.tau1: is called as another column"),
        ("sensors: {'a b': {kind: base-wrench}}", "the name 'a b': begin with a letter"),
        ("sensors: {gauge: {kind: scale}}", "choose from 'base-wrench'"),
        ("sensors: {p: {kind: base-wrench, motor_turns: 20}}", "no drive has a rotor_inertia"),
        ("measured: [{mass: 1, of: X, std: 0.1}]", "has unknown X; choose from U, S, P"),
        ("measured: [{mass: 1, of: {}, std: 0.1}]", "measured[1].of names no body"),
    ],
)
def test_what_the_robot_does_not_have_is_refused(text: str, words: str) -> None:
    assert words in refusal(with_text(f"{text}\n"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("free: []\n    spread: 0.1", "bodies.S.spread: is given, but free: [] says"),
        ("free: []\n    measured: [{mass: 0.1, std: 0.01}]", "is of S, which is known (free: [])"),
        ("spread: {mass: 0.1}", "spread"),
        (
            "free: [m, mcx, Sxx]\n    measured: [{centre: 0.01, axis: y, std: 0.001}]",
            "bodies.S.free excludes mcy, which says that it is zero; name it there",
        ),
        (
            "free: [m, mcx]\n    measured: [{first_moment: 1, axis: [1, 0, 1], std: 0.1}]",
            "is along x, z, but bodies.S.free excludes mcz",
        ),
    ],
)
def test_what_a_body_keeps_is_not_measured(text: str, words: str) -> None:
    assert words in refusal(of_body(text))


def test_turns_of_motors_are_of_drives_that_turn() -> None:
    text = catalogue_text("irb360-6-1600")
    for turns, words in (
        ("{drive9: 10}", "has unknown drive9"),
        ("{drive4: 0}", "sensors.plate.motor_turns.drive4: is 0"),
        ("0", "sensors.plate.motor_turns: is 0"),
    ):
        line = f"sensors: {{plate: {{kind: base-wrench, motor_turns: {turns}}}}}\n"
        assert words in refusal(f"{text}{line}")


def test_known_bodies_may_be_weighed_with_others() -> None:
    robot = load_robot("clavel-delta3")
    bodies = dict(robot.bodies) | {"P": robot.bodies["P"].changed(free=())}
    known = robot.changed(bodies=bodies)
    assert known.changed(measured=({"mass": 1.0, "of": {"P": 1, "S": 2}, "std": 0.1},)).measured
    with pytest.raises(DescriptionError, match="which is known"):
        known.changed(measured=({"mass": 1.0, "of": "P", "std": 0.1},))


@pytest.mark.parametrize(
    ("value", "grade", "words"),
    [
        ("{mass: 0.21, std: 0.001}", "good", "1 measured value, as mass of S, goes"),
        ("{mass: 0.05, std: 0.001}", "good", ""),
        ("{mass: 210, std: 1}", "wrong", "is 210 kg, where the prior has 0.21 kg"),
        ("{mass: 0.0002, std: 0.001}", "doubtful", "a value in another unit"),
        ("{centre: 0.5, axis: x, std: 0.01}", "good", ""),
        ("{first_moment: 110, axis: x, std: 1}", "wrong", "first moment in kg mm"),
        ("{inertia: 80000, axis: y, std: 1}", "wrong", "kg mm²"),
    ],
)
def test_measured_values_in_another_unit_are_reported(value: str, grade: str, words: str) -> None:
    text = of_body(f"free: [m, mcx, Sxx, Syy, Szz]\n    measured: [{value}]")
    robot = parse(text, RobotDescription, where="robot.yaml")
    (found,) = (verdict for verdict in of_robot(robot) if verdict.key == "measured-scale")
    assert found.grade == grade
    assert words in found.sentence
    if "210" in value:
        assert dict(found.proposals[0].changes)["bodies.S.measured[0].mass"] == 0.21


@pytest.mark.parametrize(
    ("third", "words"),
    [
        ("{mass: 0.52, std: 0.001, of: {S: 2, P: 1}}", ""),
        ("{mass: 0.54, std: 0.001, of: {S: 2, P: 1}}", "mass of S is 0.2100 ± 0.001 kg"),
        ("{mass: 0.217, std: 0.001, of: S}", "the other measured values say 0.2170 kg"),
        ("{mass: 0.9, std: 0.001, of: U}", ""),
    ],
)
def test_measured_values_that_contradict_each_other_are_doubtful(third: str, words: str) -> None:
    text = of_body("free: [m, mcx, Sxx, Syy, Szz]") + (
        "measured:\n  - {mass: 0.21, std: 0.001, of: S}\n  - {mass: 0.1, std: 0.001, of: P}\n"
        f"  - {third}\n"
    )
    robot = parse(text, RobotDescription, where="robot.yaml")
    (verdict,) = (v for v in of_robot(robot) if v.key == "measured-scale")
    assert (verdict.grade, words in verdict.sentence) == ("doubtful" if words else "good", True)


def test_no_measured_value_no_verdict() -> None:
    assert not any(v.key == "measured-scale" for v in of_robot(load_robot("clavel-delta3")))


DELTA = "clavel-delta3"
LIST = """\
offers:
  scale:
    title: scale
    price: 20
    weigh: {quantity: mass, std: 0.001}
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("quantity: mass, std: 0.001", "quantity: mass", "gives neither std nor share"),
        ("quantity: mass", "quantity: mass, axis: x", "a mass has no axis"),
        ("quantity: mass", "quantity: inertia", "inertia needs its axis"),
        ("quantity: mass", "quantity: centre, axis: x, of: limb", "centre of a limb"),
        ("quantity: mass", "quantity: inertia, axis: [0, 0, 0]", "weigh.axis: has no direction"),
        ("quantity: mass, std: 0.001", "quantity: centre, axis: x, share: 0.1", "needs std, in m"),
        ("price: 20", "price: -1", "line 4, offers.scale.price"),
        ("price: 20", "cost: 20", "offers.scale.cost: unknown key"),
        ("    weigh: {quantity: mass, std: 0.001}\n", "", "nothing to do with it"),
        ("weigh:", "sensors: {g: {kind: joint-torque, drive: each}}\n    weigh:", "weigh and"),
        ("weigh: {quantity: mass, std: 0.001}", "sensors: {g: {kind: bathroom}}", "bathroom"),
        ("scale:", "a scale:", "a scale"),
    ],
)
def test_bad_lists_are_refused(old: str, new: str, said: str) -> None:
    message = refusal(replaced(old, new, LIST), Offers)
    assert said in message
    assert "deltaid schema sensors" in message


@pytest.mark.parametrize(
    ("weigh", "said"),
    [
        ({"quantity": "mass", "of": "X", "std": 1e-3}, "has no body 'X'"),
        ({"quantity": "mass", "of": {"S": 2, "Q": 1}, "std": 1e-3}, "has no body 'Q'"),
        ({"quantity": "first_moment", "of": "P", "axis": "x", "share": 0.01}, "is zero at the"),
    ],
)
def test_lists_that_do_not_fit_the_robot_are_refused(
    weigh: dict, said: str, tmp_path: Path
) -> None:
    listed = Offers.model_validate({"offers": {"a": {"title": "a", "price": 1, "weigh": weigh}}})
    with pytest.raises(DescriptionError, match=said):
        sensor_plan(DELTA, offers=listed)
    (path := tmp_path / "list.yaml").write_text(yaml_text(listed.model_dump(exclude_unset=True)))
    with pytest.raises(DescriptionError, match=r"list\.yaml, offers\.a"):
        sensor_plan(DELTA, offers=path)


def test_gains_that_are_known_are_no_goal() -> None:
    with pytest.raises(DeltaidError, match="no goal"):
        sensor_plan(DELTA, goal="gains", settings=PlanSettings(gain_spread=0.0))


ROTORS = [
    ("par4", 1e-2, None, ""),
    ("par4", 30.0, None, ""),
    ("par4", 100.0, Grade.DOUBTFUL, "kg cm², g cm² or g m²"),
    ("par4", 1e3, Grade.WRONG, "kg cm², g cm² or g m²"),
    ("par4", 1e-3, Grade.DOUBTFUL, "without its gear"),
    ("linear-delta", 1e3, Grade.WRONG, "in grams"),
    ("irb360-6-1600", 1e4, Grade.DOUBTFUL, "kg cm², g cm² or g m²"),  # only the tool turns it
]


@pytest.mark.parametrize(("name", "factor", "grade", "cause"), ROTORS)
def test_rotors_in_another_unit(name: str, factor: float, grade: Grade | None, cause: str) -> None:
    robot = load_robot(name)
    rotors = {drive: factor * inertia for drive, inertia in robot.rotor_inertia.items()}
    wrong = robot.changed(rotor_inertia=rotors)
    poor = [verdict for verdict in of_robot(wrong, quick=True) if verdict.key == "prior-scale"]
    assert [verdict.grade for verdict in poor] == [grade or Grade.GOOD]
    assert cause in poor[0].cause
    assert not grade or f"is {max(rotors.values()):.3g} kg" in poor[0].seen
