"""Whatever names, titles and columns of files hold is printed as it stands; it commands nothing."""

import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from command import run
from deltaid.cli.output import console, table
from deltaid.errors import visible
from deltaid.robot.load import catalogue_text
from deltaid.view.html import render
from deltaid.view.page import Page, Section, Table, Text
from logs import write

CLAVEL = catalogue_text("clavel-delta3")
COMMANDS = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
TITLES = ["[/]", "[bold]", "a [red]b[/red]", "[link=file:///x]y[/link]", ":smile:", "[/bold", "\\["]


def robot_file(folder: Path, title: str) -> Path:
    quoted = "".join(
        c if " " < c < "\x7f" and c not in '"\\' else f"\\U{ord(c):08x}" for c in title
    )
    text = CLAVEL.replace("title: Clavel's 3-DOF Delta", f'title: "{quoted}"', 1)
    return write(folder / "robot.yaml", text)


@pytest.mark.parametrize("title", TITLES)
@pytest.mark.parametrize("command", ["base", "show"])
def test_brackets_in_a_title_are_printed(tmp_path: Path, command: str, title: str) -> None:
    outcome = run(command, robot_file(tmp_path, title))
    assert outcome.code == 0
    assert title in outcome.out


def test_escape_sequences_of_a_title_do_not_reach_the_terminal(tmp_path: Path) -> None:
    title = "\x1b]0;gone\x07\x1b[2J\x9b2Kleft\u202ethgir\x85\r\b"
    path = robot_file(tmp_path, title)
    for arguments in (("base", path), ("show", path), ("base", path, "--json")):
        outcome = run(*arguments)
        assert outcome.code == 0
        assert "gone" in outcome.out or "--json" in arguments
        assert not COMMANDS.search(outcome.out.replace("\x1b[1m", "").replace("\x1b[0m", ""))


@pytest.mark.parametrize("name", ["[/]", "[bold]q2[/bold]", "q\x9b2", "q\u202e2"])
def test_columns_and_paths_are_printed_in_messages(tmp_path: Path, name: str) -> None:
    log = write(tmp_path / "[red].csv", f"t,q1,{name}\n0,0,0\n")
    outcome = run("base", "clavel-delta3", log)
    assert outcome.code == 2
    assert "[red].csv, row 1: has no column q2, q3" in outcome.err
    assert visible(name) in outcome.err
    assert not COMMANDS.search(outcome.err)
    mapping = write(tmp_path / "mapping.yaml", "torque: [{column: a, unit: '[/]'}]\n")
    outcome = run("base", "clavel-delta3", log, "--columns", mapping)
    assert (outcome.code, outcome.errors) == (2, 1)


def test_names_on_the_command_line_are_printed_in_messages() -> None:
    assert "called '[/]'" in run("base", "[/]").err
    assert "called '?[2J'" in run("base", "\x1b[2J").err


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.text(max_size=12))
@example("\x1b[31m")
def test_any_text_is_printed_as_it_stands(text: str) -> None:
    with console.capture() as captured:
        console.print(text)
        console.print(table(text, [text, "unit"], [[text, text]]))
    shown = captured.get()
    assert shown.startswith(visible(text))
    assert not COMMANDS.search(shown)


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.text(max_size=12).filter(str.strip))
@example("</title><script>alert(1)</script>")
@example("\x00\x1b\x9b")
def test_a_page_prints_text_as_it_stands(monkeypatch, text: str) -> None:
    monkeypatch.setattr("deltaid.view.html.get_plotlyjs", lambda: "")
    blocks = (Text(text), Table((text, "b"), ((text, text),), text))
    html = render(Page(text, text, (), (Section(text, blocks),), (text,)))
    empty = render(Page("a", "a", (), (Section("a", ()),), ("a",)))
    assert html.count("<script") == empty.count("<script")
    assert not COMMANDS.search(html.replace("\t", ""))
