"""Warnings and errors say what is wrong and how to mend it; names in them stand as they are."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import deltaid
from command import accepted, run
from deltaid import errors
from deltaid.cli.output import console, table
from deltaid.errors import Doubt, visible
from deltaid.robot.load import catalogue_text
from deltaid.view.html import render
from deltaid.view.page import Page, Section, Table, Text
from logs import write
from sessions import ROOT

SOURCES = sorted((ROOT / "src" / "deltaid").rglob("*.py"))
# What verdicts and fits say is made elsewhere (`Verdict`, `identification/doubts.py`).
COLLECTED = {"warnings", "noticed", "doubts", "told"}


def calls(tree: ast.AST, name: str) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name:
            yield node


def text(node: ast.expr) -> str:
    """The words that stand in an expression."""
    parts = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]
    return "".join(part for part in parts if isinstance(part, str))


def test_a_doubt_is_one_sentence() -> None:
    doubt = Doubt("it rained", cause="a cloud", cure="wait", key="clock")
    assert doubt == "it rained; likeliest cause: a cloud; wait"
    assert doubt.key == "clock"


def bare(tree: ast.AST) -> Iterator[ast.AST]:
    """Warnings with no cause, no cure, a full stop, or words that `Doubt` adds."""
    for call in calls(tree, "Doubt"):
        words = {word.arg: word.value for word in call.keywords}
        parts = [word for word in (words.get("cause"), words.get("cure")) if word is not None]
        empty = any(isinstance(part, ast.Constant) and not part.value for part in parts)
        ended = any(text(part).endswith(".") for part in parts)
        if len(parts) < 2 or empty or ended or "likeliest" in text(call):
            yield call


def collected(tree: ast.AST) -> Iterator[ast.AST]:
    """Bare words that are appended to a list of warnings."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            whose = node.func.value
            name = getattr(whose, "attr", getattr(whose, "id", ""))
            words = node.args and isinstance(node.args[0], ast.Constant | ast.JoinedStr)
            if node.func.attr == "append" and name in COLLECTED and words:
                yield node


def test_no_warning_is_bare() -> None:
    """What is collected as a warning is a `Doubt`, and none has an empty cause or cure."""
    for path in SOURCES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found = [*bare(tree), *(() if "checks" in path.parts else collected(tree))]
        assert not found, f"{path.name}: {[ast.unparse(node) for node in found]}"


def test_bare_warnings_are_found() -> None:
    for code in (
        'Doubt("x", cause="a")',
        'Doubt("x", cause="", cure="b")',
        'Doubt("x", cause="a", cure="b.")',
        'Doubt("x; likeliest cause: y", cause="a", cure="b")',
    ):
        assert list(bare(ast.parse(code))), code
    assert not list(bare(ast.parse('Doubt("x", cause="a", cure="b")')))
    assert list(collected(ast.parse('self.warnings.append("x")')))
    assert not list(collected(ast.parse("warnings.append(doubt)")))


ERRORS = [name for name in vars(errors) if name.endswith("Error")]


def _raised() -> list[tuple[str, set[str], str]]:
    """Place, keywords and text of all errors that reading, writing and commands may raise."""
    found, package = [], Path(deltaid.__file__).parent
    for path in sorted(package.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ERRORS and node.args:
                keywords = {keyword.arg or "" for keyword in node.keywords}
                found.append((f"{path.name}:{node.lineno}", keywords, ast.unparse(node.args[0])))
    return found


OF_A_FIT = ("base_parameters.py", "conic.py", "fit.py")


def test_every_error_says_where_and_how_to_mend_it() -> None:
    """The cure may be in the sentence itself: what must be, or what to give instead."""
    raised = _raised()
    assert len(raised) > 80
    for place, keywords, what in raised:
        named = "where" in keywords or "called '" in what
        # `fit` tells the recordings of what goes wrong in it.
        assert named or place.split(":")[0] in OF_A_FIT, place
        assert "cure" in keywords or "must " in what or "give " in what, place


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
    outcome = accepted(command, robot_file(tmp_path, title))
    assert title in outcome.out


def test_escape_sequences_of_a_title_do_not_reach_the_terminal(tmp_path: Path) -> None:
    title = "\x1b]0;gone\x07\x1b[2J\x9b2Kleft\u202ethgir\x85\r\b"
    path = robot_file(tmp_path, title)
    for arguments in (("base", path), ("show", path), ("base", path, "--json")):
        outcome = accepted(*arguments)
        assert "gone" in outcome.out or "--json" in arguments
        assert not COMMANDS.search(outcome.out.replace("\x1b[1m", "").replace("\x1b[0m", ""))


@pytest.mark.parametrize("name", ["[/]", "[bold]q2[/bold]", "q\x9b2", "q\u202e2"])
def test_columns_and_paths_are_printed_in_messages(tmp_path: Path, name: str) -> None:
    log = write(tmp_path / "[red]:car:.csv", f"t,q1,{name}\n0,0,0\n")
    outcome = run("base", "clavel-delta3", log)
    assert outcome.code == 2
    assert "[red]:car:.csv, row 1: has no column q2, q3" in outcome.err
    assert visible(name) in outcome.err
    assert not COMMANDS.search(outcome.err)
    mapping = write(tmp_path / "mapping.yaml", 'time: {unit: "\\e[31m[bold]:car:"}\n')
    outcome = run("base", "clavel-delta3", log, "--columns", mapping)
    assert (outcome.code, outcome.errors) == (2, 1)
    assert "mapping.yaml, time.unit: unit '?[31m[bold]:car:' is not known" in outcome.err


def test_names_on_the_command_line_are_printed_in_messages() -> None:
    assert "called '[/]'" in run("base", "[/]").err
    assert "called '?[2J'" in run("base", "\x1b[2J").err


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.text(max_size=12))
@example("\x1b[31m")
def test_any_text_is_printed_as_it_stands(text: str) -> None:
    with console.capture() as captured:
        console.print(text)
        console.print(table(Table((text, "unit"), ((text, text),), title=text)))
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
