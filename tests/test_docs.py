"""The documentation says what the program does, its examples run, and its links lead somewhere."""

import os
import re
import shlex
import subprocess
import sys
from enum import EnumType
from pathlib import Path
from typing import get_type_hints

import pytest
import typer
from ruamel.yaml import YAML

import deltaid
from cli_page import page as cli_page
from deltaid.cli.app import app
from deltaid.model.record import IdentifiedModel
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from links import DOCS, Link, anchors, external, links
from links import PAGES as LINKED
from sessions import NOT_RUN, ROOT, SKIPPED, blocks, steps

COMMANDS = typer.main.get_command(app).commands
PAGES = sorted(DOCS.rglob("*.md"))
DOCUMENTS = (*PAGES, ROOT / "README.md")
_API = (DOCS / "api.md", *sorted((DOCS / "api").glob("*.md")))
API = "".join(path.read_text(encoding="utf-8") for path in _API)
RUNNABLE = [ROOT / "README.md"]
RUNNABLE += [  # a notebook's page is made by running the notebook
    path
    for path in PAGES
    if steps(path.read_text(encoding="utf-8")) and not path.with_suffix(".ipynb").exists()
]
CLI = (DOCS / "cli.md").read_text(encoding="utf-8")
_INLINE = re.compile(r"`(deltaid [^`]+)`")
_SHELL = ("", "console", "sh", "powershell")
_NO_COMMANDS = ("python", "text", "yaml", "matlab", "c", "json")


def section(heading: str) -> str:
    """A section of cli.md up to the next heading of the same level."""
    match = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", CLI, re.M | re.S)
    assert match, f"docs/cli.md has no section '{heading}'"
    return match[1]


def command_lines(path: Path) -> list[str]:
    """All `deltaid …` lines of a page: in shell blocks and inline."""
    page = path.read_text(encoding="utf-8")
    found = []
    for language in _SHELL:
        for _, text in blocks(page, language):
            for line in text.replace("\\\n", " ").splitlines():
                bare = line.removeprefix("$ ")
                if language == "console" and bare == line:
                    continue
                found += re.findall(r"(?:^|[/\s])(deltaid [^|&;>]+)", bare)
    prose = re.sub(r"^```.*?^```$", "", page, flags=re.M | re.S)
    return found + _INLINE.findall(prose)


@pytest.mark.parametrize("path", LINKED, ids=lambda path: path.name)
def test_a_row_of_a_table_stands_on_one_line(path: Path) -> None:
    """A cell that goes on in the next line ends the table there."""
    page = re.sub(r"^ *```.*?^ *```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    assert not re.findall(r"^\|.*[^|\s]\s*$|^\|.*\n[^|\n].*", page, flags=re.M)


def test_public_names_are_what_the_api_page_shows() -> None:
    for name in deltaid.__all__:
        assert getattr(deltaid, name).__name__ == name
        assert re.search(rf"^::: deltaid\.{name}$", API, re.M), name


def test_command_lines_parse() -> None:
    lines = [(path, line) for path in DOCUMENTS for line in command_lines(path)]
    for path, line in lines:
        words = shlex.split(line.partition(" > ")[0], comments=True)[1:]
        if words[:1] == ["--mechanism"]:
            words = words[2:]
        name = next((word for word in words if not word.startswith("-")), None)
        if name is None or name.isupper():  # options of deltaid itself, or a placeholder
            continue
        assert name in COMMANDS, f"{path.name}: {line}"
        options = {option for p in COMMANDS[name].params for option in p.opts} | {"-h", "--help"}
        for word in words:
            if word.startswith("-"):
                assert word.partition("=")[0] in options, f"{path.name}: {line}"


def test_blocks_are_of_a_kind_that_is_run_or_read() -> None:
    for path in DOCUMENTS:
        page = path.read_text(encoding="utf-8")
        kinds = set(re.findall(r"^ *```(\w*)[^\n]*\n.*?^ *```$", page, re.M | re.S))
        kinds -= {"py"} if path.with_suffix(".ipynb").exists() else set()
        assert kinds <= {*_SHELL, *_NO_COMMANDS}, path


def test_little_is_not_run() -> None:
    lines = [line for path in RUNNABLE for line in command_lines(path)]
    assert sum(bool(NOT_RUN.search(line)) for line in lines) < 0.1 * len(lines)


def test_cli_page_is_what_the_program_has() -> None:
    assert cli_page() == CLI, "python tests/cli_page.py --renew"


def test_cli_page_lists_arguments_and_options() -> None:
    for name, command in COMMANDS.items():
        text = section(f"deltaid {name}")
        for parameter in command.params:
            if "--help" in parameter.opts:
                continue
            for spelling in parameter.opts:
                shown = spelling if spelling.startswith("-") else spelling.upper()
                assert f"`{shown}`" in text, f"{shown} of {name} is not in docs/cli.md"
        known = {option for p in command.params for option in p.opts}
        for option in re.findall(r"^\| (?:`-\w`, )?`(--[\w-]+)`", text, re.M):
            assert option in known, f"docs/cli.md: {name} has no {option}"


def test_cli_page_lists_choices() -> None:
    for command in app.registered_commands:
        for kind in get_type_hints(command.callback).values():
            for choice in kind if isinstance(kind, EnumType) else ():
                text = section(f"deltaid {command.name}")
                assert f"`{choice.value}`" in text, f"{choice.value} of {command.name}"


def test_cli_page_lists_options_of_the_program() -> None:
    for parameter in typer.main.get_command(app).params:
        for option in parameter.opts:
            assert f"`{option}`" in section("deltaid")


@pytest.mark.parametrize(
    ("heading", "model"),
    [
        ("The robot file", RobotDescription),
        ("The mapping file", ColumnMapping),
        ("The model file", IdentifiedModel),
    ],
)
def test_cli_page_lists_keys_of_files(heading: str, model: type) -> None:
    schema, text = model.model_json_schema(), section(heading) + section("The robot file")
    parts = [schema] if model is IdentifiedModel else [schema, *schema.get("$defs", {}).values()]
    for part in parts:
        for key in part.get("properties", {}):
            assert re.search(rf"`([\w.*]+\.)?{key}(\.\w+)?`", text), f"{key} is not in '{heading}'"


def _require_agreement(*arguments: str | Path) -> None:
    # In a process of its own, since it changes the folder and what commands find.
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("sessions.py"), *arguments],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": "utf-8"},
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_sessions_and_code_of_the_pages() -> None:
    _require_agreement(*RUNNABLE)


def test_quoted_example_files_are_those_in_examples() -> None:
    for path in PAGES:
        for line, text in blocks(path.read_text(encoding="utf-8"), "yaml"):
            first, *quoted = text.splitlines()
            if not first.startswith("# from "):
                continue
            kept = iter((ROOT / first.removeprefix("# from ")).read_text("utf-8").splitlines())
            for row in quoted:
                assert row == SKIPPED or row in kept, f"{path.name}, line {line}: {row}"


EXAMPLES = ROOT / "examples"
# Those that a page runs are run there, with what they print (sessions.py).
ON_PAGES = {
    script
    for page in PAGES
    for script in re.findall(r"\$ python examples/(\w+\.py)", page.read_text(encoding="utf-8"))
}
# Those in programs of other people: test_export_drake.py, test_jax.py.
ELSEWHERE = {"in_drake.py", "in_jax.py"}
SCRIPTS = [
    path for path in sorted(EXAMPLES.glob("*.py")) if path.name not in {*ON_PAGES, *ELSEWHERE}
]


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_example_runs_in_a_folder(script: Path, tmp_path: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in EXAMPLES.iterdir()}
    here, target = tmp_path / "here", tmp_path / "target"
    here.mkdir()
    done = subprocess.run(
        [sys.executable, script, target],
        cwd=here,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONIOENCODING": "utf-8"},
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    assert not list(here.iterdir())
    assert {path: path.stat().st_mtime_ns for path in EXAMPLES.iterdir()} == before
    if script.name == "own_mechanism.py":
        deltaid.use_mechanism(EXAMPLES / "heli4" / "mechanism.py")
    model = deltaid.IdentifiedModel.load(target / "model.yaml")
    assert model.consistent
    assert max(model.fit.nrmse) < 0.02


@pytest.mark.slow
def test_links_lead_somewhere() -> None:
    broken = {
        (str(page.relative_to(ROOT)), link.target): why
        for page in LINKED
        for link in links(page)
        if not link.external and (why := link.broken())
    }
    assert not broken


def test_what_is_broken_is_found(tmp_path: Path) -> None:
    page = DOCS / "index.md"
    for target in ("nowhere.md", "theory.md#nothing", "#nothing", "../README.md", "images/x.png"):
        assert Link(page, target).broken()
    assert not Link(page, "theory.md#excitation").broken()
    text = (
        '# A\n\n## B `c` (d)\n\n## A\n\n[x](a.md) <img src="b.png">\n\n=== "T"\n\n    [y](c.md)\n'
    )
    own = tmp_path / "own.md"
    own.write_text(text)
    assert anchors(own) == {"a", "b-c-d", "a_1"}
    assert [link.target for link in links(own)] == ["a.md", "b.png", "c.md"]


def test_links_elsewhere_are_few_and_safe() -> None:
    assert all(target.startswith("https://") for target in external())


def test_every_page_is_in_the_navigation_once() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    text = re.sub(r"!ENV", "", text)

    def pages(entry: object) -> list[str]:
        if isinstance(entry, str):
            return [entry]
        children = entry.values() if isinstance(entry, dict) else entry
        return [page for child in children for page in pages(child)]

    listed = pages(YAML(typ="safe").load(text)["nav"])
    assert sorted(listed) == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))
