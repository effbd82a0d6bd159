"""Results of commands fit a screen of 25 lines and 80 columns; `--full` prints the rest."""

import math
from pathlib import Path

import pytest
from rich.cells import cell_len

from command import run
from deltaid.cli.screen import print_found
from deltaid.view.page import Table
from identified import identified

ROBOT = "irb360-6-1600"
COMMANDS = {
    "base": ("base", "ROBOT"),
    "check": ("check", "ROBOT", "LOG"),
    "columns": ("columns", "LOG"),
    "forces": ("forces", "MODEL", "LOG"),
    "identify": ("identify", "ROBOT", "LOG", "--verify", "LOG"),
    "online": ("online", "MODEL", "LOG"),
    "robots": ("robots",),
    "sensors": ("sensors", "clavel-delta3", "--budget", "100"),
    "sample": ("sample", "MODEL", "-n", "20", "-o", "OUT/models.npz"),
    "show": ("show", "ROBOT"),
    "simulate": ("simulate", "MODEL", "LOG"),
    "validate": ("validate", "MODEL", "LOG"),
}
WITH_ALL = ("base", "forces", "identify", "sample", "sensors", "show")


def lines(text: str) -> int:
    """Of a terminal of 80 columns."""
    return sum(max(1, math.ceil(cell_len(line) / 80)) for line in text.splitlines())


def result(command: str, folder: Path, *options: str) -> str:
    found = identified(ROBOT)
    named = {"ROBOT": ROBOT, "LOG": str(found.log), "MODEL": str(found.model_file)}
    words = [named.get(word, word.replace("OUT", str(folder))) for word in COMMANDS[command]]
    outcome = run(*words, *options)
    assert outcome.code in (0, 3), outcome
    return outcome.out


@pytest.mark.parametrize("command", COMMANDS)
def test_a_result_fits_a_screen(command: str, tmp_path: Path) -> None:
    assert lines(result(command, tmp_path)) <= 25


@pytest.mark.parametrize("command", WITH_ALL)
def test_all_of_it_is_printed_when_asked_for(command: str, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    short = result(command, tmp_path)
    full = result(command, tmp_path / "full", "--full")
    assert "--full prints also" in short
    assert "--full" not in full
    assert lines(full) > lines(short)
    assert short.splitlines()[0] == full.splitlines()[0]
    tables = [line for line in full.splitlines() if "  " in line]
    assert max(map(cell_len, tables)) <= 80


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
