"""Parts of a report's page by themselves: text, tables, figures, and what they say in words."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import polars as pl
import pytest

from deltaid.checks.verdicts import Verdicts
from deltaid.dynamics.dynamics import compiled
from deltaid.model.corrections import Correction
from deltaid.model.verdict import Grade, Verdict
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter, LimitUse
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.robot.body import HollowCylinder
from deltaid.robot.load import load_robot
from deltaid.robot.parameter import TURNING
from deltaid.view.animation import ellipsoid
from deltaid.view.check import page_table, short_table, verdicts_page
from deltaid.view.comparison import TorqueComparison, compare
from deltaid.view.corrections import corrected
from deltaid.view.excitation import excitation_page
from deltaid.view.html import explained, numeric, render
from deltaid.view.numbers import number, percent, span
from deltaid.view.page import Fact, Figure, Page, Section, Table, Text
from deltaid.view.torques import over_time, residual_blocks
from html_page import HOSTILE, Document
from logs import recorded, true_parameters, write


def test_sentences_that_begin_with_a_number_are_no_numbers() -> None:
    """Right-aligned without breaks, they would end beyond the page."""
    cells = ("0.25", "18 % of the rows are excluded", "3 N m s/rad", "≥ 1.05", "4 ± 0.1 kg m²")
    table = Table(("a", "b", "c", "d", "e"), (cells, ("—", "2 %", "", "1", "0.5")))
    assert [numeric(table, k) for k in range(5)] == [True, False, True, True, True]


def test_hostile_text_in_every_part_of_a_page() -> None:
    figure = go.Figure(go.Scatter(x=[1, 2], y=[1, 2], name=HOSTILE))
    page = Page(
        HOSTILE,
        HOSTILE,
        (Fact(HOSTILE, HOSTILE, HOSTILE),),
        (
            Section(
                HOSTILE,
                (Text(HOSTILE), Table((HOSTILE,), ((HOSTILE,),), HOSTILE), Figure(figure, HOSTILE)),
            ),
        ),
        (HOSTILE,),
    )
    document = Document(render(page))
    assert not [tag for tag, _ in document.tags if tag == "img"]
    # Title twice, subtitle, fact 3, warning, contents, heading, text, column, cell, 2 captions.
    assert document.texts.count(HOSTILE) == 14
    data = [json.loads(s) for s in document.scripts if s.startswith('{"data"')]
    assert [trace["name"] for figure in data for trace in figure["data"]] == [HOSTILE]


def test_a_long_recording_is_thinned_and_keeps_its_outlier(tmp_path: Path) -> None:
    frame = recorded(50_000, derivatives=True)
    outlier = 31_234
    torque = frame["tau2"].to_numpy().copy()
    torque[outlier] += 30.0
    path = write(tmp_path / "long.parquet", frame.with_columns(pl.Series("tau2", torque)))
    robot = load_robot("clavel-delta3")
    dynamics = compiled(robot)
    c = compare(dynamics, true_parameters(), with_filter(open_log(path, dynamics.kinematics)))
    assert c.stretch == 3
    assert len(c.time) == len(c.residual) == -(-50_000 // 3)
    worst = np.nanargmax(np.abs(c.measured - c.predicted)[:, 1])  # NaN where it does not count
    assert c.time[worst] == pytest.approx(frame["t"][outlier])
    assert np.all(np.diff(c.time) > 0)


def test_ellipsoid_of_a_cylinder_has_its_mass_centre_and_moments() -> None:
    length, radius, at = 0.6, 0.1, (0.3, -0.1, 0.5)
    rod = HollowCylinder(
        shape="hollow_cylinder", axis="y", length=length, outer_radius=radius, centre=at, mass=2.0
    )
    centre, A = ellipsoid(rod.parameters())
    np.testing.assert_allclose(centre, at, atol=1e-12)
    # Second moments: of the rod m L²/12 along and m R²/4 across, of an ellipsoid m h²/5.
    halves = [np.sqrt(5 / 4) * radius, np.sqrt(5 / 4) * radius, np.sqrt(5 / 12) * length]
    np.testing.assert_allclose(np.linalg.norm(A, axis=0), halves, rtol=1e-9)
    np.testing.assert_allclose(np.abs(A[:, 2]), [0, halves[2], 0], atol=1e-9)


def test_a_drive_at_rest_and_times_since_1970() -> None:
    n, rng = 500, np.random.default_rng(2)
    time = 1.7e9 + 0.001 * np.arange(n)
    torque = rng.normal(size=(n, 2))
    frequency = np.arange(1.0, 20.0)
    c = TorqueComparison(
        time=time,
        measured=torque,
        predicted=np.zeros((n, 2)),
        stretch=1,
        speed=np.column_stack([np.zeros(n), rng.normal(size=n)]),
        residual=torque,
        frequency=frequency,
        measured_density=np.ones((19, 2)),
        residual_density=np.ones((19, 2)),
        cutoff=None,
        events=np.array([[time[10], time[20]], [time[40], time[45]]]),
        drives={"drive1": TURNING, "drive2": TURNING},
    )
    blocks = over_time(c), *residual_blocks(c)
    np.testing.assert_array_equal(blocks[0].figure.data[0].x, time)
    assert blocks[0].figure.data[0].y.dtype == np.float32
    (marks, _) = (trace for trace in blocks[0].figure.data if trace.name == "excluded: events")
    np.testing.assert_array_equal(marks.x[[0, 1, 3, 4]], time[[10, 20, 40, 45]])
    assert len(render(Page("t", "", (), (Section("s", blocks),)))) > 1.9e6


def test_shares_have_no_powers_of_ten_where_people_would_not_write_any() -> None:
    shares = (0.00123, 0.0712, 0.99, 0.996, 1.94, 35.0, 1e6, -1.5)
    shown = ("0.12 %", "7.1 %", "99 %", "100 %", "194 %", "3500 %", "1e+08 %", "-150 %")
    assert tuple(percent(share) for share in shares) == shown


def test_numbers_are_typeset_and_names_are_not() -> None:
    cells = ("-1.2e-05", "-0.3 … 1.5e+07", "≥ 3", "log-2.csv", "9e-1f")
    html = render(Page("t", "", (), (Section("s", (Table(("a",), tuple((c,) for c in cells)),)),)))
    texts = Document(html).texts
    for text in ("−1.2·10⁻⁵", "−0.3 … 1.5·10⁷", "≥ 3", "log-2.csv", "9e-1f"):
        assert text in texts


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
        Correction.model_validate({"kind": kind, "subject": subject, "text": "why"})
        for kind, several in subjects.items()
        for subject in several
    )


def test_corrections_name_bodies_and_rows_of_drives(snapshot: Callable[[str], None]) -> None:
    drives = ("drive1", "drive2", "drive3", "drive4")
    cases = (
        (),
        corrections(friction=drives),
        corrections(friction=(*drives[:2], *drives[3:]), prior=("TU", "EE")),
        corrections(prior=("U1", "U2", "U3")),
        corrections(**{"platform-spring": ("platform",), "platform-drag": ("platform",)}),
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
        page = verdicts_page(Verdicts(verdicts))
        html = render(page)
        assert page.verdict.sentence in Document(html).texts
        assert f'class="verdict {grade}"' in html
        assert ('class="marked wrong"' in html) == (SIGN in verdicts)
        said.append(page.verdict.sentence)
    snapshot("\n".join(said) + "\n")


def test_an_interval_without_a_width_is_its_number() -> None:
    assert span(2.5, 2.5) == number(2.5)
    assert span(2.4, 2.6) == "2.40 … 2.60"
