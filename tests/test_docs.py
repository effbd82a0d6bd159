"""The documentation says what the program does: commands, options, keys, outputs, examples."""

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

import deltaid
from deltaid.cli.app import app
from deltaid.model.record import IdentifiedModel
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from sessions import NOT_RUN, ROOT, SKIPPED, blocks, steps

DOCS = ROOT / "docs"
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
    schema, text = model.model_json_schema(), section(heading)
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
