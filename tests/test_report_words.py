"""What pages say in words: numbers and names in sentences, corrections, checks at a page's head."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.model.corrections import Correction
from deltaid.model.verdict import Grade, Verdict
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter, LimitUse
from deltaid.robot.load import load_robot
from deltaid.view.check import check_page, page_table, short_table
from deltaid.view.corrected import corrected
from deltaid.view.excitation import excitation_page
from deltaid.view.html import render
from deltaid.view.numbers import number, span
from deltaid.view.page import Fact, Page, Section, Text
from deltaid.view.typeset import explained
from html_page import Document

GOOD = Verdict("rate", Grade.GOOD, "1000 Hz")
CLOCK = Verdict("clock", Grade.DOUBTFUL, "23 rows repeat", cause="lost rows", cure="log anew")
SIGN = Verdict("torque-sign", Grade.WRONG, "turned", "drive1", "wired so", "turn it")


@pytest.mark.parametrize(
    ("text", "set_as"),
    [
        ("steps of 2.4e-06 rad", "steps of 2.4·10⁻⁶ rad"),
        ("drive1 -0.99 %, drive2 +1.7 %", "drive1 −0.99 %, drive2 +1.7 %"),
        ("run-1e-05.csv, log-2.csv, a/1e-5/b, 9e-1f", "run-1e-05.csv, log-2.csv, a/1e-5/b, 9e-1f"),
        ("run-1e-05 and a/2e-05", "run-1e-05 and a/2e-05"),
        ("2026-11-21 07:54 +0000", "2026-11-21 07:54 +0000"),
    ],
)
def test_numbers_in_sentences_are_set_and_names_of_files_are_not(text: str, set_as: str) -> None:
    assert str(explained(text)) == set_as


@pytest.mark.parametrize(
    ("text", "short", "words"),
    [
        ("it comes from U.Ixy", "U.Ixy", "upper arm: product of inertia of x and y"),
        ("next is kitchen-scale:TU+2S", "kitchen-scale:TU", "kitchen-scale: upper telescope bar"),
        ("bodies.EE of the file", "bodies.EE", "end effector"),
    ],
)
def test_names_in_sentences_are_explained(text: str, short: str, words: str) -> None:
    page = Page("t", "", (Fact("f", text),), (Section("s", (Text(text),)),), (text,))
    assert render(page).count(f'<abbr title="{words}">{short}</abbr>') == 3


def corrections(**subjects: tuple[str, ...]) -> tuple[Correction, ...]:
    return tuple(
        Correction.model_validate({"kind": kind, "subject": one, "text": "why"})
        for kind, several in subjects.items()
        for one in several
    )


def test_corrections_name_bodies_and_rows_of_drives(snapshot: Callable[[str], None]) -> None:
    drives = ("drive1", "drive2", "drive3", "drive4")
    cases = (
        (),
        corrections(friction=drives),
        corrections(friction=(*drives[:2], *drives[3:]), prior=("TU", "EE")),
        corrections(prior=("U1", "U2", "U3")),
    )
    snapshot("\n".join(map(corrected, cases)) + "\n")


def test_a_motion_beyond_a_limit_is_not_called_good() -> None:
    robot = compiled(load_robot("clavel-delta3"))
    exciter = Exciter(robot, ExcitationSettings(starts=1, harmonics=2))
    result = exciter.optimise()
    kept = excitation_page(result).verdict
    assert kept.sentence.startswith("Good: ")
    beyond = replace(result, limits=(*result.limits, LimitUse("speed of drive1", 1.01)))
    said = excitation_page(beyond).verdict
    assert said.grade == "poor"
    assert said.sentence.endswith("and beyond a limit of speed of drive1.")


def test_what_is_good_has_no_next_step() -> None:
    rows = page_table((GOOD, CLOCK)).rows
    assert rows[0] == ("doubtful", "clock", "23 rows repeat", "lost rows → log anew")
    assert rows[1] == ("good", "rate", "1000 Hz", "")


def test_the_head_of_a_page_has_the_worst_first_and_the_good_in_one_row() -> None:
    table = short_table((GOOD, CLOCK, GOOD, SIGN))
    assert [row[:2] for row in table.rows] == [
        ("wrong", "torque-sign"), ("doubtful", "clock"), ("good", "all others (2)"),
    ]  # fmt: skip
    assert table.rows[0][2:] == ("drive1: turned", "wired so → turn it")
    assert table.marked == {0, 1}
    assert short_table((GOOD,)).rows == (("good", "all checks (1)", "rate"),)


def test_a_check_begins_with_its_verdict(snapshot: Callable[[str], None]) -> None:
    said = list[str]()
    for verdicts, grade in (
        ((GOOD, SIGN, CLOCK), "poor"),
        ((CLOCK, CLOCK), "fair"),
        ((GOOD,), "good"),
    ):
        page = check_page("t", verdicts, (), {})
        html = render(page)
        assert page.verdict.sentence in Document(html).texts
        assert f'class="verdict {grade}"' in html
        assert ('class="marked wrong"' in html) == (SIGN in verdicts)
        said.append(page.verdict.sentence)
    snapshot("\n".join(said) + "\n")


def test_an_interval_without_a_width_is_its_number() -> None:
    assert span(2.5, 2.5) == number(2.5)
    assert span(2.4, 2.6) == "2.40 … 2.60"
