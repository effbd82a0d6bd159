"""Help, version and the installed script, and how fast help comes."""

import os
import runpy
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
import typer

import deltaid
from command import accepted, run
from deltaid.cli.app import app
from deltaid.fleets.drift_findings import DriftSettings
from deltaid.studio.drafting.questions import QUESTIONS
from deltaid.view.page import page_origin

COMMANDS = sorted(typer.main.get_command(app).commands)


@pytest.mark.parametrize("arguments", [[], *([name] for name in COMMANDS)])
def test_help(arguments: list[str]) -> None:
    outcome = accepted(*arguments, "--help")
    assert outcome.err == ""
    assert max(map(len, outcome.out.splitlines())) <= 80
    commands = typer.main.get_command(app).commands
    if not arguments:
        assert all(name in outcome.out for name in COMMANDS)
        return
    paragraphs = commands[arguments[0]].help.split("\n\n")
    assert all(paragraphs)
    assert "\n" not in "".join(paragraphs)  # a line of the source is no line of a terminal
    for parameter in commands[arguments[0]].params:
        assert parameter.name == "help" or parameter.help, parameter.name


@pytest.mark.parametrize(
    ("command", "settings"),
    [
        ("identify", deltaid.Settings()),
        ("gather", deltaid.Settings()),
        ("fleet", deltaid.Settings()),
        ("check", deltaid.Settings()),
        ("excite", deltaid.ExcitationSettings()),
        ("sensors", deltaid.PlanSettings()),
        ("simulate", deltaid.ControlSettings()),
        ("compare-controllers", deltaid.ControlSettings()),
        ("online", deltaid.OnlineSettings()),
        ("drift", DriftSettings()),
        ("fleet", DriftSettings()),
    ],
)
def test_an_option_has_the_default_of_its_setting(command: str, settings: object) -> None:
    options = {p.name: p.default for p in typer.main.get_command(app).commands[command].params}
    defaults = {name: vars(settings)[name] for name in vars(settings) if name in options}
    assert len(defaults) > 1
    assert {name: options[name] for name in defaults} == defaults


def test_units_of_questions_are_in_the_help() -> None:
    """Rich would read [m] as a style and print nothing."""
    shown = " ".join(run("new", "--help").out.replace("│", " ").split())
    for question in QUESTIONS:
        unit = question.label.rpartition("[")[2]
        assert not unit.endswith("]") or f"[{unit}" in shown, question.key


def test_version() -> None:
    assert run("--version").out == f"deltaid {version('deltaid')}\n"
    assert deltaid.__version__ == version("deltaid")


def test_no_arguments_show_help() -> None:
    outcome = run()
    assert "identify" in outcome.out + outcome.err


HEAVY = ("casadi", "polars", "scipy", "numpy", "ruamel", "pint", "llvmlite", "clarabel", "viser")
START = "from deltaid.cli import main; import sys; sys.argv = ['deltaid', {}]; main()"


@pytest.mark.parametrize(
    "code",
    [
        "import deltaid; dir(deltaid); deltaid.__version__",
        START.format("'--help'"),
        START.format("'identify', '-h'"),
    ],
)
def test_nothing_heavy_is_imported_for_help(code: str) -> None:
    report = f"import atexit, sys; atexit.register(lambda: print(*sys.modules, sep='\\n'))\n{code}"
    done = subprocess.run(
        [sys.executable, "-c", report], capture_output=True, check=True, encoding="utf-8"
    )
    loaded = {name.split(".")[0] for name in done.stdout.splitlines()}
    assert "deltaid" in loaded
    assert loaded.isdisjoint(HEAVY)


def test_the_console_script_and_the_module() -> None:
    script = Path(sys.executable).with_name("deltaid")
    good = subprocess.run([script, "robots"], capture_output=True, encoding="utf-8")
    assert (good.returncode, good.stderr) == (0, "")
    environment = os.environ | {"PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0"}
    schema = subprocess.run([script, "schema"], capture_output=True, env=environment, check=True)
    assert "m/s²" in schema.stdout.decode("utf-8")
    assert "‖J‖" in schema.stdout.decode("utf-8")
    for command in ([script], [sys.executable, "-m", "deltaid"]):
        bad = subprocess.run([*command, "robots", "x"], capture_output=True, encoding="utf-8")
        assert (bad.returncode, bad.stdout) == (2, "")
        assert bad.stderr.startswith("error: no catalogue robot")


def test_pages_name_the_command_where_no_script_is_installed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "argv", ["/x/deltaid/__main__.py", "--version"])
    with pytest.raises(SystemExit):
        runpy.run_module("deltaid", run_name="__main__")
    assert page_origin().command == "deltaid --version"
