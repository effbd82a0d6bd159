"""Drafts of robots: every kind, wide ranges, round trips, refusals that name their cause."""

import re
from functools import cache

import numpy as np
import pytest
from ruamel.yaml import YAML

from deltaid.checks.check import of_robot
from deltaid.errors import DeltaidError
from deltaid.robot.load import load_robot
from deltaid.robot.platform import H4Platform, I4Platform, Par4Platform
from deltaid.studio.drafting.draft import GIVEN, Draft, answers, kind_of, quantity
from deltaid.studio.drafting.interview import description, interview
from deltaid.studio.drafting.questions import KINDS as KINDS_OF_ROBOT
from deltaid.studio.drafting.questions import QUESTIONS, Question, lifted, questions_of
from deltaid.studio.drafting.text import written
from support import KINDS
from sweeps import slow, swept
from test_catalogue import number_paths

SIZED = {"arm": 0.22, "strut": 0.5, "base_radius": 0.16, "platform_radius": 0.05}
FEW = ("delta", "h4", "par4-linear")
every_kind = pytest.mark.parametrize("kind", swept(KINDS_OF_ROBOT, *FEW))


def draft(kind: str, **given: float) -> Draft:
    """A draft with these answers, besides lengths that go together where they are asked for."""
    base = {"base_radius": 0.3} if "linear" in kind else {}
    made = Draft(kind, "mine", "A machine of mine")
    for question in questions_of(kind):
        if question.key in (values := {**SIZED, **base, **given}):
            made = made.answered(question.key, values[question.key], GIVEN)
    return made


@cache
def typical(kind: str) -> Draft:
    """A machine of this kind, of which only lengths are known."""
    return interview(draft(kind))


@every_kind
def test_every_kind_passes_the_check_and_says_where_numbers_are_from(kind: str) -> None:
    done = typical(kind)
    text = written(done)
    assert {v.grade for v in of_robot(description(done))} == {"good"}
    tree = YAML(typ="safe", pure=True).load(text)
    sources = tree.pop("sources")
    numbers = number_paths(tree)
    assert [n for n in numbers if not any(f"{n}.".startswith(f"{s}.") for s in sources)] == []
    assert [s for s in sources if not any(f"{n}.".startswith(f"{s}.") for n in numbers)] == []
    assert text.startswith("# yaml-language-server: $schema=robot.schema.json\n")
    assert all(len(line) <= 160 for line in text.splitlines())
    assert "limbs.strut: given" in text
    assert "assumed" in sources["workspace"]


def wide(kind: str, rng: np.random.Generator) -> Draft:
    """Answers over all that a machine may have, lengths in some proportion."""
    size = 10 ** rng.uniform(-1.5, 0.6)
    lengths = {
        "arm": size * rng.uniform(0.2, 0.6),
        "strut": size,
        "base_radius": size * rng.uniform(0.15, 0.6),
        "platform_radius": size * rng.uniform(0.03, 0.12),
    }
    made = Draft(kind, "wide", "Wide")
    for question in questions_of(kind):
        low, high = question.low, question.high
        if question.key in lengths:
            value = min(max(lengths[question.key], low), high)
        elif rng.random() < 0.1:
            even = rng.uniform(low, high)
            value = even if low <= 0 else np.exp(rng.uniform(np.log(low), np.log(high)))
        else:
            continue
        made = made.answered(question.key, float(f"{value:.4g}"), GIVEN)
    return made


@pytest.mark.parametrize("seed", swept(range(9), 0, 1))
def test_wide_answers_give_a_robot_or_a_cause(seed: int) -> None:
    kind, rng = list(KINDS_OF_ROBOT)[seed], np.random.default_rng(seed)
    made = wide(kind, rng)
    done = answered_or_refused(made)
    if isinstance(done, DeltaidError):
        assert len(done.what) > 20
        assert done.where or done.cure
        assert not re.search(r"line \d", done.what)
    else:
        verdicts = of_robot(description(done))
        assert {v.key for v in verdicts if v.grade != "good"} <= {"prior-scale"}
        assert {key: done.values[key] for key in made.values} == dict(made.values)


def answered_or_refused(made: Draft) -> Draft | DeltaidError:
    try:
        return interview(made)
    except DeltaidError as error:
        return error


@every_kind
def test_every_number_comes_back(kind: str) -> None:
    """Odd digits in all answers at once, read back from the text."""
    rng, usual = np.random.default_rng(5), typical(kind).values
    given = {q.key: float(f"{usual[q.key] * rng.uniform(0.97, 1):.7g}") for q in questions_of(kind)}
    given |= {"gear": 3.0} | {key: usual[key] for key in ("radius", "low", "high")}
    robot = description(Draft(kind, "odd", "Odd", given, dict.fromkeys(given, GIVEN)))
    back = answers(robot)
    assert kind_of(robot) == kind
    if isinstance(platform := robot.platform, H4Platform | Par4Platform | I4Platform):
        assert platform.angle_deg == (-given["tool_turn"], given["tool_turn"])
    behind = {"torque": 3.0, "speed": 1 / 3, "rotor": 9.0, "gear": 1 / 3}
    for question in questions_of(kind):
        key = question.key
        if key in ("base_radius", "pinion") and kind.startswith(("h4", "i4")):
            assert back[key] == pytest.approx(given[key], rel=1e-5)
            continue
        assert back[key] == pytest.approx(given[key] * behind.get(key, 1.0), rel=1e-11), key


@pytest.mark.parametrize("name", KINDS)
def test_catalogue_robots_are_read_as_answers(name: str) -> None:
    robot = load_robot(name)
    found = answers(robot)
    needed = [q.key for q in questions_of(kind_of(robot)) if q.assumed is None]
    assert set(needed) <= set(found)
    assert found["strut"] == robot.limb_geometry[0].strut
    assert found["radius"] == robot.workspace.inner_box[1][0] * np.sqrt(2)


@pytest.mark.parametrize(
    ("kind", "given", "words"),
    [
        ("delta", {"strut": 0.12, "arm": 0.3}, ("120 mm", "--strut", "longer strut")),
        ("delta", {"angle_low": 50.0, "angle_high": 20.0}, ("--angle-high", "50")),
        ("delta", {"radius": 0.6}, ("workspace cannot be used", "--radius")),
        ("delta", {"low": -9.0}, ("cannot reach the middle of the workspace", "--low")),
        ("delta", {"high": -2.0}, ("--high", "--low")),
        ("delta", {"torque": 0.01}, ("would sink", "torque")),
        ("delta", {"platform_mass": 490.0}, ("490 kg", "kilograms")),
        ("delta", {"base_radius": 0.05, "arm": 0.02}, ("no place was found", "third")),
        ("linear-delta", {"rail_high": -3.0, "rail_low": -5.0}, ("above its base", "rails")),
        ("linear-delta", {"tilt": -45.0}, ("meet before their lower ends", "--tilt 45")),
        ("linear-delta", {"tilt": 80.0}, ("cannot reach", "negative if the rails lean inwards")),
        slow("par4", {"bar": 0.9}, ("no place was found", "--strut")),
    ],
)  # fmt: skip
def test_refusals_name_their_cause(
    kind: str, given: dict[str, float], words: tuple[str, ...]
) -> None:
    with pytest.raises(DeltaidError) as refused:
        interview(draft(kind, **given))
    assert all(word in str(refused.value) for word in words), str(refused.value)


def test_a_workspace_is_as_wide_as_the_robot_reaches() -> None:
    robot = description(typical("delta"))
    larger = {"radius": robot.workspace.inner_box[1][0] * np.sqrt(2) * 1.3}
    with pytest.raises(DeltaidError, match="cannot be used"):
        interview(draft("delta", **larger))


def test_a_workspace_is_as_high_as_the_rails_allow() -> None:
    drafts = (draft("linear-delta", rail_low=0.0, rail_high=end) for end in (1.0, 1.8))
    short, long = (description(interview(x)).workspace.bounding_box[0, 2] for x in drafts)
    assert short - long == pytest.approx(0.8)  # both end where the rails do


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("235 mm", "m", 0.235), ("0.235", "m", 0.235), ("23.5cm", "m", 0.235),
        (" 9.25 in", "m", 0.23495), ("1.2 kg cm²", "kg*m**2", 1.2e-4),
        ("12 kg*cm^2", "kg*m**2", 1.2e-3), ("400 rpm", "degree/s", 2400),
        ("30°", "degree", 30), ("0.5 rad", "degree", 28.6478897565), ("800 g", "kg", 0.8),
        ("1.5 N·m", "N*m", 1.5), ("-3e-2", "m", -0.03), ("9.81 m/s²", "m/s**2", 9.81),
        ("20", "", 20), ("3 kg cm2", "kg*m**2", 3e-4), ("2 m/s2", "m/s**2", 2),
    ],
)  # fmt: skip
def test_numbers_with_units(text: str, unit: str, value: float) -> None:
    assert quantity(text, unit) == value  # no 0.23500000000000001 in a file


@pytest.mark.parametrize(
    "text", ["", "x", "0,5", "5 kg", "1 2", "nan", "inf", "--3", "2**9**9**9 m", "5 " + "m" * 60]
)
def test_what_is_no_length_is_said(text: str) -> None:
    with pytest.raises(DeltaidError, match="200 mm"):
        quantity(text, "m")


class Scripted:
    """Answers by key, in the order of being asked; then takes what is offered."""

    def __init__(self, **answers: list[str]) -> None:
        self.answers, self.messages, self.asked = answers, list[str](), list[str]()

    def ask(self, question: Question, offer: tuple[float, str] | None) -> str:
        self.asked.append(question.key)
        mine = self.answers.get(question.key)
        return mine.pop(0) if mine else ""

    def tell(self, error: DeltaidError) -> None:
        self.messages.append(str(error))


def test_wrong_answers_are_asked_again() -> None:
    someone = Scripted(
        arm=["200 kg", "220 mm"], strut=["", "0.12", "0.5"], base_radius=["160"] * 2 + ["0.16"] * 2,
        platform_radius=["5cm"], torque=["0.01", "14"],
    )  # fmt: skip
    done = interview(Draft("delta", "mine", "Mine"), someone)
    assert [done.values[key] for key in SIZED] == list(SIZED.values())
    assert done.values["torque"] == 14
    assert (done.origins["arm"], done.origins["arm_mass"]) == ("given", "assumed")
    text = " ".join(someone.messages)
    for words in ("no unit for this", "is not a number", "is it 160 mm?", "cannot reach", "sink"):
        assert words in text
    # A group that does not go together is asked again as a whole, other groups are not.
    assert (someone.asked.count("swing"), someone.asked.count("arm_mass")) == (2, 1)
    assert len(someone.messages) == 6


def test_what_is_given_is_not_asked() -> None:
    someone = Scripted()
    interview(draft("delta", swing=45.0), someone)
    assert "strut" not in someone.asked
    assert "swing" not in someone.asked
    assert "arm_mass" in someone.asked


def test_limits_of_questions_are_those_of_their_words() -> None:
    for question in QUESTIONS:
        assert question.require(float(question.low)) == question.low
        with pytest.raises(DeltaidError, match=question.option):
            question.require(question.high * 1.01 + 1e-3)
        with pytest.raises(DeltaidError):
            question.require(question.low - abs(question.low) * 0.01 - 1e-15)


def test_a_drive_lifts_its_share_of_the_platform_and_both_struts_of_its_limb() -> None:
    masses = {"platform_mass": 0.9, "tool_mass": 0.3, "telescope_mass": 0.6, "strut_mass": 0.07}
    assert lifted("delta", masses) == pytest.approx(1.8 / 3 + 2 * 0.07)
    assert lifted("h4", masses) == pytest.approx(1.8 / 4 + 2 * 0.07)
