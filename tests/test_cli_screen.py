"""Results of commands fit a screen of 25 lines and 80 columns; `--full` prints the rest."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.cells import cell_len

from command import run
from deltaid.cli.output import error_console, print_found, remark
from deltaid.view.page import Table
from drifting import write_months
from identified import identified
from measured_poses import measured
from plant import no_workers, plant

ROBOT = "irb360-6-1600"
# Not here: what runs until it is stopped (studio), prints a file (schema), or takes minutes
# (reproduce).
COMMANDS = {
    "base": f"base {ROBOT}",
    "calibrate": "calibrate clavel-delta3 --points points.csv -o own.yaml",
    "check": f"check {ROBOT} log.csv",
    "columns": f"columns log.csv {ROBOT} -o columns.yaml",
    "compare-controllers": f"compare-controllers model.yaml start.csv --plant {ROBOT}",
    "demo": "demo clavel-delta3 --keep demo",
    "drift": "drift clavel-delta3 months -o drift.csv",
    "excite": f"excite {ROBOT} --starts 1 --duration 4 -o motion.csv",
    "export": "export model.yaml --to c -o code/",
    "fleet": "fleet fleet.yaml -o fleet",
    "forces": "forces model.yaml log.csv",
    "gather": f"gather {ROBOT} log.csv -o factors",
    "identify": f"identify {ROBOT} log.csv --verify log.csv -o own.yaml",
    "new": "new own.yaml --kind delta --arm 220mm --strut 0.5 --base-radius 0.1 "
    "--platform-radius 0.04 --yes",
    "online": "online model.yaml log.csv",
    "robots": "robots",
    "sample": "sample model.yaml -n 20 -o models.npz",
    "sensors": "sensors clavel-delta3 --budget 100",
    "show": f"show {ROBOT}",
    "simulate": "simulate model.yaml log.csv",
    "torque": "torque model.yaml log.csv -o torques.csv",
    "validate": "validate model.yaml log.csv",
}
WITH_ALL = ("base", "forces", "identify", "sample", "sensors", "show")
_NUMBER = re.compile(r"[-−+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The present folder, with a model, the recording that it was identified from, its start."""
    found = identified(ROBOT)
    found.frames[0].write_csv(tmp_path / "log.csv")
    found.frames[0][50:350].write_csv(tmp_path / "start.csv")
    shutil.copy(found.model_file, tmp_path / "model.yaml")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def result(command: str, *options: str) -> list[str]:
    """Lines of a terminal of 80 columns."""
    outcome = run(*COMMANDS[command].split(), *options, terminal=True)
    assert outcome.code in (0, 3), outcome
    return outcome.out.splitlines()


def words(lines: list[str]) -> str:
    """A result without what rounding may change: numbers, the room that they take, where a
    sentence is folded, and which of the limits that a motion uses to the full comes nearest."""
    short = [re.sub(" +", " ", _NUMBER.sub("#", line)).rstrip() for line in lines]
    text = re.sub(r"\n (?=\S)", " ", "\n".join(short))
    return re.sub(r"(?<=limits; )[^,]+(?= comes nearest)", "…", text)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_result_fits_a_screen(
    command: str, folder: Path, snapshot: Callable[[str], None]
) -> None:
    if command == "calibrate":
        measured(folder, 2)
    elif command == "drift":
        write_months(folder / "months", 12)
    elif command == "fleet":
        plant(folder).record("north/2026-01-05")
    with no_workers():
        lines = result(command)
    assert len(lines) <= 25
    assert max(map(cell_len, lines)) <= 80
    snapshot(f"$ deltaid {COMMANDS[command]}\n{words(lines)}\n")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("command", WITH_ALL)
def test_all_of_it_is_printed_when_asked_for(command: str) -> None:
    short, full = result(command), result(command, "--full")
    assert any("--full prints also" in line for line in short)
    assert not any("--full" in line for line in full)
    assert len(full) > len(short)
    assert short[0] == full[0]
    assert max(map(cell_len, full)) <= 80


@pytest.mark.parametrize("rows", [2, 15, 16, 17, 18, 19, 200])
def test_a_table_is_cut_where_a_screen_ends(rows: int, capsys: pytest.CaptureFixture) -> None:
    table = Table(("entry", "unit"), tuple((f"entry {k}", "m") for k in range(rows)))
    print_found(["Good: all is well.", "A second line."], [table], full=False)
    printed = capsys.readouterr().out.splitlines()
    entries = sum(line.startswith("entry ") for line in printed) - 1
    assert len(printed) <= 22
    assert entries == rows or len(printed) >= 21
    cut = f"→ --full prints also: {rows - entries} more rows of entry"
    assert (cut in printed) == (entries < rows)


def test_no_row_alone_is_left(capsys: pytest.CaptureFixture) -> None:
    table = Table(("entry", "unit"), (("x", "m"), ("y", "m"), ("z", "m")), title="entries")
    print_found([f"line {k}" for k in range(18)], [table], full=False)
    assert capsys.readouterr().out.splitlines()[18:] == ["→ --full prints also: entries"]


@pytest.mark.usefixtures("folder")
def test_a_comparison_with_a_load_fits_a_screen() -> None:
    given = ("model.yaml", "start.csv", "--plant", ROBOT, "--payload", "0.5+-0.1")
    lines = run("compare-controllers", *given, terminal=True).out.splitlines()
    assert "worst load" in lines[1]
    assert max(map(cell_len, lines)) <= 80


@pytest.mark.parametrize("is_terminal", [True, False])
def test_remarks_are_folded_at_words_in_a_terminal_only(
    is_terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(error_console, "_force_terminal", is_terminal)
    monkeypatch.setattr(error_console, "_width", 40)
    monkeypatch.setattr(error_console, "_height", 25)
    text = "log.csv: time starts again in one place; likeliest cause: two recordings in one file"
    remark("warning", text)
    lines = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().err).splitlines()
    assert " ".join(" ".join(lines).split()) == f"warning: {text}"
    assert (max(map(cell_len, lines)) <= 40) == (len(lines) > 1) == is_terminal
