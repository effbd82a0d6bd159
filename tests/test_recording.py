"""Reading logs: every spelling of a recording gives the same samples, in blocks of any size."""

import dataclasses
import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import zstandard

from bad_logs import NUMBERED
from deltaid.dynamics.dynamics import Dynamics
from deltaid.recording import table
from deltaid.recording.formats import csv_lines, frames
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.opening import open_log
from deltaid.recording.table import open_table, recut
from logs import Spelling, comma, names, read, recorded, text, write


def _quoted(frame: pl.DataFrame) -> bytes:
    header = [f'"{name}"' for name in frame.columns]
    return text(frame, header=header, number=lambda v: f'"{v!r}"').encode()


def _spaced(frame: pl.DataFrame) -> bytes:
    return text(frame, ";", header=[f" {n} " for n in frame.columns], number="  {!r} ".format)


def _with_notes(frame: pl.DataFrame) -> bytes:
    noted = frame.with_columns(note=pl.lit('"Achse, gemäß ""Plan"""'), date=pl.lit("2025-11-20"))
    return text(noted.select("date", *frame.columns, "note")).encode()


def _commented(source: str, marks: tuple[str, ...] = ("#", "%", "//", ";")) -> bytes:
    """A comment above the names, under them, among the data and at the end."""
    lines = source.rstrip("\n").split("\n")
    for i, place in enumerate((len(lines), 45, 40, 40, 2, 1, 0)):
        lines.insert(place, f"{marks[i % len(marks)]} remark {i}, 1.5")
    return "\n".join(lines).encode()


def _with_second(source: str, row: str) -> bytes:
    return source.replace("\n", f"\n{row}\n", 1).encode()


def _in_two(data: bytes, compress: Callable[[bytes], bytes]) -> bytes:
    half = len(data) // 2
    return compress(data[:half]) + compress(data[half:])


SPELLINGS: dict[str, Spelling] = {
    "commas and tabs": lambda f: text(f, ",\t").encode(),
    "decimal commas, semicolons": lambda f: text(f, ";", number=comma).encode(),
    "decimal commas, tabs": lambda f: text(f, "\t", number=comma).encode(),
    "byte order mark and quotes": lambda f: b"\xef\xbb\xbf" + _quoted(f),
    "empty lines at the end": lambda f: (text(f, eol="\r\n") + "\r\n \r\n\n").encode(),
    "empty rows at the end": lambda f: (text(f, ";") + ";" * (f.width - 1) + "\n\n").encode(),
    "no line end at the end": lambda f: text(f).rstrip("\n").encode(),
    "separator at every line's end": lambda f: text(f, eol=";;\n", separator=";").encode(),
    "quotes": _quoted,
    "spaces": _spaced,
    "scientific": lambda f: text(f, number="{:+.16E}".format).encode(),
    "other columns": _with_notes,
    "other columns from Windows": lambda f: _with_notes(f).decode().encode("cp1252"),
    "comments": lambda f: _commented(text(f, "\t")),
    "comments with semicolons": lambda f: _commented(text(f, ";"), ("#", "%", "//")),
    "names in a comment": lambda f: ("# made by x\n# " + text(f, " ")).encode(),
    "row of units": lambda f: _with_second(text(f), "s,rad,[rad],(rad),N m,Nm,Nm"),
    "preamble": lambda f: ("Scope;1,5\n\nStart: 12:00\n" + text(f, ";", number=comma)).encode(),
    "preamble and units": lambda f: b"Scope\n" + _with_second(text(f), "s,rad,rad,rad,Nm,Nm,Nm"),
    "blanks": lambda f: text(f, " \t  ").replace("\n", " \r\n  ").encode(),
    "blanks and decimal commas": lambda f: text(f, "   ", number=comma).encode(),
    "end tag": lambda f: (text(f) + "END\n").encode(),
    "end in words": lambda f: (text(f, ";", eol="\r\n") + "\r\nEnd of file; bye").encode(),
    "end tag in gzip": lambda f: gzip.compress((text(f) + "END\n\n").encode()),
    "gzip in two members": lambda f: _in_two(text(f).encode(), gzip.compress) + bytes(512),
    "zstd in two frames": lambda f: _in_two(text(f).encode(), zstandard.compress),
    "UTF-16": lambda f: b"\xff\xfe" + text(f, eol="\r\n").encode("utf-16-le"),
    "UTF-16, big end first, tabs": lambda f: b"\xfe\xff" + text(f, "\t").encode("utf-16-be"),
    "UTF-16 in gzip": lambda f: gzip.compress(text(f, ";", number=comma).encode("utf-16")),
    "columns in another order": lambda f: text(f.select(sorted(f.columns, reverse=True))).encode(),
}


@pytest.fixture
def frame() -> pl.DataFrame:
    return recorded(60)


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch):
    """Sets how much of a file is read at a time."""

    def set_sizes(size: int) -> None:
        monkeypatch.setattr(csv_lines, "_BLOCK_BYTES", size)
        monkeypatch.setattr(frames, "BATCH_ROWS", size // 40)

    return set_sizes


@pytest.mark.parametrize("spelling", SPELLINGS)
@pytest.mark.parametrize("size", [1 << 22, 500, 61])
def test_spellings_give_equal_samples(tmp_path, frame, small_blocks, spelling, size) -> None:
    content = SPELLINGS[spelling](frame)
    path = write(tmp_path / "log.csv", content)
    small_blocks(size)
    np.testing.assert_array_equal(read(path), frame.to_numpy())


@pytest.mark.parametrize("size", [1 << 22, 280])
def test_parquet_gives_the_same(tmp_path, frame, small_blocks, size) -> None:
    small_blocks(size)
    path = write(tmp_path / "log[1].parquet", frame)
    np.testing.assert_array_equal(read(path), frame.to_numpy())
    renamed = path.rename(tmp_path / "without-extension")
    np.testing.assert_array_equal(read(renamed), frame.to_numpy())


@pytest.mark.parametrize("kind", [pl.Int16, pl.Int64, pl.UInt32, pl.Float32, pl.Decimal(20, 3)])
def test_parquet_numbers_of_any_type(tmp_path, kind) -> None:
    whole = pl.DataFrame({name: np.arange(5) + k for k, name in enumerate(names("t", "q", "tau"))})
    path = write(tmp_path / "log.parquet", whole.cast(kind))
    np.testing.assert_array_equal(read(path), whole.to_numpy())


def test_names_from_windows_match_a_mapping(tmp_path, frame) -> None:
    header = ["t", "q1 [°]", *frame.columns[2:]]
    path = write(tmp_path / "log.csv", text(frame, header=header).encode("cp1252"))
    assert open_table(path).header[1] == "q1 [°]"


def test_rows_above_the_data_can_be_declared(tmp_path, frame) -> None:
    preamble = "Name;Scope\r\nStart;12:00\r\n\r\n"
    header, rest = text(frame, ";", number=comma, eol="\r\n").split("\r\n", 1)
    units = ";".join(["s"] + ["rad"] * 3 + ["Nm"] * 3)
    path = write(tmp_path / "scope.csv", f"{preamble}{header}\r\n{units}\r\n{rest}")
    for mapping in (ColumnMapping(header_row=4, data_row=6), ColumnMapping(data_row=6)):
        np.testing.assert_array_equal(read(path, mapping), frame.to_numpy())


@pytest.mark.parametrize("separator", [",", ";", "\t", "  "])
@pytest.mark.parametrize("number", [repr, comma])
def test_columns_without_names_are_numbered(tmp_path, frame, separator, number) -> None:
    if (separator, number) == (",", comma):
        separator = " ;"
    rows = text(frame, separator, number=number).split("\n", 1)[1]
    path = write(tmp_path / "log.csv", "# a remark\n" + rows)
    np.testing.assert_array_equal(read(path, NUMBERED), frame.to_numpy())
    path = write(tmp_path / "log.csv", "\ufeff# a remark\nRecorded in May\n" + rows)
    np.testing.assert_array_equal(read(path, NUMBERED), frame.to_numpy())
    below = NUMBERED.changed(data_row=3)
    np.testing.assert_array_equal(read(path, below), frame.to_numpy())


def test_whole_numbers_do_not_decide_the_decimal_mark(tmp_path) -> None:
    rows = ["t;q1;q2;q3;tau1;tau2;tau3", "0;0;0;0;1;1;1", "1;0,5;0;0;1;1;-1,25e-1"]
    values = read(write(tmp_path / "log.csv", "\n".join(rows)))
    np.testing.assert_array_equal(values[1], [1, 0.5, 0, 0, 1, 1, -0.125])


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
@pytest.mark.parametrize("size", [120, 777, 5000])
def test_block_boundaries_change_no_survey(tmp_path, clavel, small_blocks, name, size) -> None:
    path = write(tmp_path / name, recorded(300, derivatives=True))
    whole = open_log(path, clavel.kinematics)
    small_blocks(size)
    assert _same(whole, open_log(path, clavel.kinematics))


def _same(a: object, b: object) -> bool:
    """Equal but for the rounding of sums that are taken in another order."""
    if dataclasses.is_dataclass(a):
        fields = (field.name for field in dataclasses.fields(a) if field.compare)
        return all(_same(getattr(a, name), getattr(b, name)) for name in fields)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.allclose(a, b, rtol=1e-10, atol=0)
    return a == b


def test_survey_over_several_batches(tmp_path, clavel: Dynamics, monkeypatch) -> None:
    frame = recorded(700, derivatives=True)
    path = write(tmp_path / "log.csv", frame)
    monkeypatch.setattr(table, "BATCH_ROWS", 64)
    log = open_log(path, clavel.kinematics)
    assert (log.samples, log.rate) == (700, pytest.approx(1000))
    largest = frame.select(pl.col(names("tau")).abs().max()).row(0)
    np.testing.assert_array_equal(log.torque_max, largest)
    assert not log.warnings
    assert log.has_derivatives


@pytest.mark.parametrize(("size", "overlap"), [(7, 0), (7, 3), (10, 25), (100, 40), (3, 1)])
def test_recut(size: int, overlap: int) -> None:
    rows = np.arange(200.0).reshape(100, 2)
    blocks = list(recut(np.array_split(rows, 9), size, overlap))
    starts = range(0, 100 - overlap, size)
    assert len(blocks) == len(starts)
    for start, block in zip(starts, blocks, strict=True):
        np.testing.assert_array_equal(block, rows[start : start + size + overlap])


@pytest.mark.parametrize("at", [1, 280])
def test_rows_of_data_behind_a_comment_mark_are_reported(
    tmp_path: Path, clavel: Dynamics, at: int
) -> None:
    """At the ends of a recording, where no gap shows that they are missing."""
    head, *rows = text(recorded(300)).splitlines()
    lines = [f"note,{head}", *(f"ok,{row}" for row in rows)]
    for i in range(at, 301 if at > 1 else 4):
        lines[i] = f"#N/A,{rows[i - 1]}"
    lines.insert(100, "# " + ", ".join(["word"] * len(lines[0].split(","))))
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    (warning,) = open_log(path, clavel.kinematics).warnings
    count, first = (3, 2) if at == 1 else (21, 282)
    assert f"{count} of them hold a number" in warning
    assert f"the first in row {first};" in warning


@pytest.mark.parametrize(("share", "uneven"), [(0.04, False), (0.08, True)])
def test_a_time_stamp_is_uneven_beyond_a_twentieth_of_a_step(
    tmp_path: Path, clavel: Dynamics, share: float, uneven: bool
) -> None:
    frame = recorded(300)
    time = frame["t"].to_numpy().copy()
    time[150] += share * (time[1] - time[0])
    path = write(tmp_path / "log.parquet", frame.with_columns(t=pl.Series(time)))
    log = open_log(path, clavel.kinematics)
    assert log.clock.steady != uneven
    assert not log.warnings
