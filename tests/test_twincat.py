"""Exports of TwinCAT Scope: a column of times for each channel, or for channels of one period."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from bags import read
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import RecordingError
from deltaid.recording.formats.twincat_table import ScopeTable
from deltaid.recording.opening import open_log
from deltaid.recording.resolution import resolve_columns
from deltaid.recording.source import LogTable
from deltaid.recording.table import open_table, read_batches
from scopes import Curve, scope

ROWS = 400
RNG = np.random.default_rng(8)
VALUES = RNG.normal(size=(ROWS, 6))
TIME = np.arange(ROWS) * 0.25
NAMES = ["q1", "q2", "q3", "tau1", "tau2", "tau3"]
CURVES = [Curve(name, TIME, VALUES[:, k]) for k, name in enumerate(NAMES)]
ALL = np.column_stack([TIME / 1000, VALUES])

OPTIONS = {
    "default": scope(CURVES),
    "shared times": scope(CURVES, shared=True),
    "decimal point": scope(CURVES, decimal=".", end=""),
    "semicolons": scope(CURVES, ";").replace("\n", "\r\n"),
    "commas": scope(CURVES, ",", ".", words=["Name"]),
    "commas in the header": scope(CURVES, ",", ".", shared=True),
    "colons": scope(CURVES, ":"),
    "names only": scope(CURVES, words=["Name"], preamble=False),
    "symbols": scope(CURVES, words=["SymbolName", "Unit"]).replace("MAIN.", ""),
    "full time stamps": scope(CURVES, started=132959733843760000),
    "long comment": scope(CURVES).replace(
        "SymbolComment\t", 'SymbolComment\t"first line\n(* 5 *)\n1\nlast"\t', 1
    ),
    "end of lines": scope(CURVES, end="").replace("\n", "\t\n"),
    "UTF-8 with a mark": "\ufeff" + scope(CURVES),
}


def opened(folder: Path, text: str) -> LogTable:
    path = folder / "scope.csv"
    path.write_bytes(text.encode())
    table = open_table(path)
    assert isinstance(table, ScopeTable)
    return table


def refused(folder: Path, text: str, columns: list[str]) -> str:
    def whole() -> None:
        table = opened(folder, text)
        table.picks(columns)
        list(read_batches(table, resolve_columns(table, (False,) * 3)))

    with pytest.raises(RecordingError) as caught:
        whole()
    return str(caught.value)


@pytest.mark.parametrize("option", OPTIONS)
def test_every_option_of_the_export_gives_the_same_samples(option: str, tmp_path: Path) -> None:
    table = opened(tmp_path, OPTIONS[option])
    assert np.array_equal(read(table, ["t", *NAMES]), ALL)
    assert not table.doubts
    lines = OPTIONS[option].split("\n")
    place = lines[table.first_row - 1].lstrip("\ufeff").strip()
    assert place.startswith(("0", "132959733843760000"))


def test_it_may_be_compressed_or_in_utf_16(tmp_path: Path) -> None:
    for name, data in {
        "a.txt.gz": gzip.compress(scope(CURVES).encode()),
        "b.txt": scope(CURVES).encode("utf-16"),
    }.items():
        (tmp_path / name).write_bytes(data)
        assert np.array_equal(read(open_table(tmp_path / name), ["t", *NAMES]), ALL)


def test_channels_are_found_by_symbol_as_well(tmp_path: Path) -> None:
    table = opened(tmp_path, scope(CURVES))
    assert np.array_equal(read(table, ["t", "MAIN.tau2", "q1"]), ALL[:, [0, 5, 1]])


def wave(t: np.ndarray, k: int) -> np.ndarray:
    return np.sin(0.02 * t + k)


@pytest.mark.parametrize("align", ["", "shift", "fill"])
@pytest.mark.parametrize("shared", [False, True])
def test_periods_of_their_own_are_brought_together(
    align: str, shared: bool, tmp_path: Path
) -> None:
    """Torques every 4 ms, positions every 1 ms: no line is one instant."""
    fast, slow = np.arange(1000) * 1.0, np.arange(250) * 4.0
    curves = [Curve(f"q{k + 1}", fast, wave(fast, k)) for k in range(3)]
    curves += [Curve(f"tau{k + 1}", slow, wave(slow, 5 + k)) for k in range(3)]
    table = opened(tmp_path, scope(curves, shared=shared, align=align))
    found = read(table, ["t", *NAMES])
    assert np.array_equal(found[:, 0], fast[:997] / 1000)
    assert np.array_equal(found[:, 1:4], np.column_stack([wave(fast, k) for k in range(3)])[:997])
    expected = np.column_stack([wave(fast, 5 + k) for k in range(3)])[:997]
    assert found[:, 4:] == pytest.approx(expected, abs=1e-7)
    assert "interpolated to those of q1, q2, q3" in table.doubts[0]
    alone = read(table, ["t", "tau2"])
    if align != "fill":
        assert np.array_equal(alone, np.column_stack([slow / 1000, wave(slow, 6)]))
        assert not table.doubts


def test_a_channel_that_ends_sooner_ends_the_recording(tmp_path: Path) -> None:
    curves = [*CURVES[:3], *(Curve(c.name, c.time[:390], c.values[:390]) for c in CURVES[3:])]
    for shared in (False, True):
        table = opened(tmp_path, scope(curves, shared=shared))
        assert np.array_equal(read(table, ["t", *NAMES]), ALL[:390])
        assert not table.doubts


def test_units_are_those_of_the_file(clavel: Dynamics, tmp_path: Path) -> None:
    """In words of Scope: the quantity stands behind the unit."""
    t = np.arange(2000.0)
    q = [17 + 11 * np.sin(0.007 * t + k) for k in range(3)]
    curves = [Curve(f"q{k + 1}", t, q[k], {"Unit": "° (Angle)"}) for k in range(3)]
    curves += [Curve(f"tau{k + 1}", t, q[k], {"Unit": "Nm (Torque)"}) for k in range(3)]
    path = tmp_path / "log.txt"
    path.write_text(scope(curves), encoding="utf-8")
    batch = next(open_log(path, clavel.kinematics).batches())
    expected = np.column_stack([t / 1000, *np.deg2rad(q), *q])
    assert batch[:, :7] == pytest.approx(expected, rel=1e-14)
    path.write_text(scope(curves).replace("° (Angle)", "furlong (Length)"), encoding="utf-8")
    with pytest.raises(RecordingError, match="unit 'furlong' is not known"):
        open_log(path, clavel.kinematics)


def test_what_scope_scales_is_said(tmp_path: Path) -> None:
    """An export is scaled or not, by an option that leaves no trace in the file."""
    rows = {"ScaleFactor": "-0,5", "Offset": "3", "Unit": "rad (Angle)"}
    table = opened(tmp_path, scope([Curve("q1", TIME, VALUES[:, 0], rows), *CURVES[1:]]))
    assert np.array_equal(read(table, ["t", *NAMES]), ALL)
    assert "ScaleFactor -0.5, Offset 3" in table.doubts[0]
    assert "declare {unit: 0.5 rad, zero: 6, sign: -1}" in table.doubts[0]
    assert np.array_equal(read(table, ["q2"]), ALL[:, 2:3])
    assert not table.doubts


def _line(text: str, row: int, new: str) -> str:
    lines = text.split("\n")
    lines[row - 1] = new
    return "\n".join(lines)


ROW = 100
SLOW = [*CURVES[:3], *(Curve(c.name, c.time[:100] * 4, c.values[:100]) for c in CURVES[3:])]


def _with(k: int, cell: str, curves: list[Curve] = CURVES) -> str:
    fields = scope(curves).split("\n")[ROW - 1].split("\t")
    fields[k] = cell
    return _line(scope(curves), ROW, "\t".join(fields))


WITHOUT_TIMES = "\n".join(
    line.split("\t", 1)[1] if line[:1].isdecimal() else line
    for line in scope(CURVES, shared=True).split("\n")
)
BAD = {
    "a word": (_with(3, "abc"), f"row {ROW}: column q2 is 'abc', not a finite number"),
    "nothing": (_with(3, ""), f"row {ROW}: column q2 is empty"),
    "no time": (_with(0, ""), f"row {ROW}: column t is empty"),
    "another mark": (_with(3, "1.5"), f"row {ROW}: column q2 is '1.5'"),
    "infinite": (_with(3, "INF"), f"row {ROW}: column q2 is 'INF'"),
    "a word in slow ones": (_with(9, "abc", SLOW), f"row {ROW}: column tau2 is 'abc'"),
    "too long": (_line(scope(CURVES), ROW, "1\t" * 13), f"row {ROW}: has 14 fields"),
    "decimal commas": (scope(CURVES, ","), "has 24 columns of data, but 12 names"),
    "no times": (WITHOUT_TIMES, "has 6 columns of data, but 7 names"),
    "no data": (scope(CURVES).split("\n\n0")[0], "without data"),
    "names with blanks": (
        scope([Curve("arm 1", TIME, VALUES[:, 0]), *CURVES], " "),
        "separated by tabs",
    ),
}


@pytest.mark.parametrize(("text", "said"), BAD.values(), ids=BAD)
def test_what_cannot_be_read_is_reported_with_its_place(
    text: str, said: str, tmp_path: Path
) -> None:
    message = refused(tmp_path, text, ["t", *NAMES])
    assert said in message
    assert "scope.csv" in message
    assert "→" in message


def test_an_unknown_channel_is_reported(tmp_path: Path) -> None:
    assert "has no column q4" in refused(tmp_path, scope(CURVES), ["t", "q4"])


def test_an_open_end_is_reported(tmp_path: Path) -> None:
    table = opened(tmp_path, scope(CURVES, end="").rstrip("\n"))
    assert np.array_equal(read(table, ["t", *NAMES]), ALL)
    assert "no line break" in table.doubts[0]


def test_an_export_cut_off_in_its_first_line_has_no_rows(clavel: Dynamics, tmp_path: Path) -> None:
    whole = scope(CURVES, end="").rstrip("\n").split("\n")
    first = next(k for k, line in enumerate(whole) if line[:1].isdigit())
    path = tmp_path / "scope.csv"
    path.write_text("\n".join([*whole[:first], whole[first].rsplit("\t", 2)[0] + "\t"]))
    with pytest.raises(RecordingError, match="has fewer than two rows of data"):
        open_log(path, clavel.kinematics)


def test_other_tables_are_not_taken_for_an_export(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("Name,t,q1\na,0,1\na,1,2\n", encoding="utf-8")
    assert not isinstance(open_table(path), ScopeTable)
