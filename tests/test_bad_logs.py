"""A log that cannot be used gets one message: what is wrong, in which file, row and column."""

import random
import re
from functools import reduce
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from bad_logs import GOOD, NUMBERED, ROWS, changed, with_field, with_line, without_rows
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError
from deltaid.recording.columns import TimeChannel
from deltaid.recording.formats import csv_lines
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.recording.survey_checks import off_course
from deltaid.recording.time.counts import unit_factors
from deltaid.recording.time.doubts import doubts_about_holes
from deltaid.robot.load import load_robot
from logs import comma, read, recorded, refusal, text, write

# Two runs under one time, as a logger writes them that counts rows.
JOINED = pl.concat([recorded(1500).head(150), recorded(1500).slice(900, 150)])
COMMAS = text(recorded(ROWS), ";", number=comma)
LINE_150 = GOOD.split("\n")[149]
FIELDS_150 = LINE_150.split(",")
# What is in the file, and what the message must say besides the file's name.
BAD_TEXT = {
    "NaN": (with_field(150, "q2", "NaN"), "row 150: column q2 is 'NaN'"),
    "too large": (with_field(150, "q1", "1e999"), "row 150: column q1 is '1e999'"),
    "empty": (with_field(150, "q2", ""), "row 150: column q2 is empty"),
    "control characters": (with_field(150, "q1", "\x00\x01"), "row 150: column q1 is '??'"),
    "first of several": (
        with_field(200, "t", "x", with_field(150, "tau3", "y")),
        "row 150: column tau3 is 'y'",
    ),
    "last row": (with_field(ROWS + 1, "q3", "?"), f"row {ROWS + 1}: column q3 is '?'"),
    "quoted decimal comma": (
        with_field(150, "q2", '"0,5"'),
        "row 150: column q2 is '0,5'",
        "semicolons",
    ),
    "quoted decimal commas": (
        text(recorded(ROWS), number=lambda x: f'"{comma(x)}"'),
        "row 2: column t is '0,0'",
        "semicolons",
    ),
    "thousands": (with_field(150, "q2", "1.000,5", COMMAS), "is '1.000,5'", "no thousands sign"),
    "English thousands": (
        with_field(150, "t", '"1,000.5"'),
        "is '1,000.5'",
        "→ write numbers without a thousands sign",
    ),
    "date": (
        with_field(2, "t", "03/01/2026 10:59:57.000"),
        "2: column t is '03/01",
        "T14:30:00.000",
    ),
    "German date": (with_field(2, "t", "1.3.2026 10:59"), "2: column t is '1.3.", "T14:30:00.000"),
    "printed minus": (with_field(150, "q2", "−0.5"), "is '−0.5'", "minus sign as on the keyboard"),
    "hexadecimal": (with_field(150, "q2", "0x1F"), "is '0x1F'", "write numbers in decimal digits"),
    "unit": (with_field(150, "q2", "-0.5 rad"), "is '-0.5 rad'", "the number alone, and its unit"),
    "unit of angles": (with_field(150, "q2", "-5.2e-1°"), "is '-5.2e-1°'", "the number alone"),
    "zeroed bytes": (
        with_field(150, "q2", "0.5\x00\x00"),
        "is '0.5??'",
        "remove or repair such rows",
    ),
    "second header": (
        with_line(150, GOOD.split("\n")[0]),
        "row 150: column t is 't'",
        "the header is repeated here: split the file",
    ),
    "point among commas": (
        with_field(150, "q2", "0.5", COMMAS),
        "row 150: column q2 is '0.5'",
        "in one way, with point or comma, and no thousands sign",
    ),
    "decimal commas with commas": (
        text(recorded(ROWS), number=comma),
        "row 2: has 14 fields, but the header has 7",
        "semicolons",
    ),
    "more fields": (with_line(150, LINE_150 + ",1"), "row 150: has 8 fields, but the header has 7"),
    "fewer fields": (
        with_line(150, ",".join(FIELDS_150[:4])),
        "row 150: has 4 fields, but the header has 7",
    ),
    "open quote": (with_line(150, '"' + LINE_150), "row 150: has a quotation mark"),
    "stray quotes": (with_field(150, "q1", '0.1"2"3"'), "row 150"),
    "empty line": (with_line(150, ""), "row 150: is an empty line"),
    "cut off": (
        GOOD[: -len(GOOD.split("\n")[-2]) // 2],
        f"row {ROWS + 1}: has ",
        "the file is cut off there",
    ),
    "no header": ("\n".join(GOOD.split("\n")[1:]), "row 1: has no header"),
    "no header below a remark": (
        "\ufeff# a remark\n" + GOOD.split("\n", 1)[1],
        "row 2: has no header",
    ),
    "duplicated column": (GOOD.replace("q3", "q2", 1), "row 1: has 2 columns called q2"),
    "missing column": (GOOD.replace("tau2", "M2", 1), "row 1: has no column tau2", "--columns"),
    "columns that count from 0": (
        changed().replace("q1,q2,q3,tau1,tau2,tau3", "q0,q1,q2,tau0,tau1,tau2", 1),
        "row 1: has no column q3, tau3",
        "ROBOT` proposes which is which",
    ),
    "no torques": (
        text(recorded(ROWS).drop("tau1", "tau2", "tau3")),
        "row 1: has no torque columns",
    ),
    "bars between columns": (GOOD.replace(",", "|"), "row 1: has no column", "tab or blanks"),
    "row of units": (
        GOOD.replace("\n", "\ns,rad,rad,counts,Nm,Nm,Nm\n", 1),
        "row 2: holds no numbers",
        "data_row: 3",
    ),
    "empty file": ("", "log.csv: is empty"),
    "empty lines": ("\n\n\n", "row 1: is an empty line"),
    "one row": ("\n".join(GOOD.split("\n")[:2]), "log.csv: has fewer than two rows"),
    "carriage returns": (GOOD.replace("\n", "\r"), "row 1: has carriage returns alone"),
    "time backwards": (
        changed(t=1 - pl.col("t")),
        "log.csv: column t runs backwards",
        "rate: 1000",
    ),
    "time at random": (
        changed(t=pl.col("t").shuffle(seed=1)),
        "log.csv: column t goes back in ",
        "it is no time",
    ),
    "time stands still": (
        changed(t=pl.lit(0.25)),
        "log.csv: column t is 0.25 s in all rows: it does not run",
    ),
    "gaps everywhere": (
        changed(t=pl.col("t") + 0.1 * (pl.int_range(pl.len()) // 30)),
        "log.csv: has no stretch of 256 samples without a gap; the longest has 30",
    ),
    "time in milliseconds": (
        changed(t=1000 * pl.col("t")),
        "log.csv: column t makes a sampling rate of 1 Hz",
        "unit: ms",
    ),
    "time in nanoseconds": (
        changed(t=(1e9 * pl.col("t")).round()),
        "log.csv: column t makes a sampling rate of 1e-06 Hz",
        "unit: ns",
    ),
    "a counter of cycles": (
        changed(t=pl.int_range(pl.len())),
        "log.csv: column t makes a sampling rate of 1 Hz",
        "if t counts rows or cycles, give the sampling rate in its place (time: {rate: 1000})",
    ),
    "time in hours": (
        changed(t=pl.col("t") / 3600),
        "log.csv: column t makes a sampling rate of 3.6e+06 Hz; at most 1e+06 Hz can be",
        "unit: 3600 s makes 1000 Hz",
    ),
    "time in microseconds": (changed(t=1e6 * pl.col("t")), "rate of 0.001 Hz", "unit: us"),
    "milliseconds since 1970": (
        changed(t=1.772e12 + (1e3 * pl.col("t")).round()),
        "row 2: column t is 1.772e+12 s",
        "declare the column's unit (ms, us, ns)",
    ),
    "exponents of Fortran": (
        text(recorded(ROWS), number=lambda x: f"{float(x):.9e}".replace("e", "D")),
        "row 2: column t is '0.000000000D+00'",
        "write exponents with E",
    ),
    "time in days, as a spreadsheet's dates": (
        changed(t=45352.0 + pl.col("t") / 86400),
        "log.csv: column t makes a sampling rate of 8.64e+07 Hz; at most 1e+06 Hz can be",
        "unit: 86400 s",
    ),
    "constant torque": (changed(tau2=pl.lit(0.0)), "log.csv: column tau2 is constant; no torque"),
    "degrees": (
        changed(q2=pl.col("q2").degrees()),
        "column q2 is ",
        "looks like degrees, or like the motor side",
    ),
    "a lost reading": (
        with_field(150, "q1", "0.0", with_field(151, "q2", "0.0")),
        "row 150: column q1 is 0 rad for one row, between ",
        "remove such rows",
    ),
    "lost readings": (
        reduce(lambda log, row: with_field(row, "q1", "0", log), (90, 91, 92, 150), GOOD),
        "row 90: column q1 is 0 rad for 3 rows, between ",
        "no motion, and so in 1 more places of ",
    ),
    "a number for none": (
        reduce(lambda log, row: with_field(row, "tau2", "-9999", log), (90, 120, 151, 200), GOOD),
        "row 90: column tau2 is -9999 there and again",
        "remove these rows",
    ),
    "joined runs": (
        text(JOINED.with_columns(t=recorded(ROWS)["t"])),
        "row 152: column q2 jumps by ",
        "recordings were joined",
        "split the log there",
    ),
    "out of reach": (
        reduce(lambda log, row: with_field(row, "q1", "-2.5", log), range(150, 154), GOOD),
        "row 150: the elbow of limb 1 points inwards at (q1, q2, q3) = (-2.5, ",
    ),
}


@pytest.mark.parametrize(
    ("declared", "true", "rate"),
    [("ms", "s", 2000.0), ("us", "ms", 2.0), ("min", "s", 25.0), ("s", "ms", 5.0)],
)
def test_a_unit_of_time_is_proposed_for_the_declared_one(
    tmp_path: Path, declared: str, true: str, rate: float
) -> None:
    path = write(tmp_path / "log.csv", recorded(ROWS).with_columns(t=pl.int_range(pl.len()) / rate))
    mapping = ColumnMapping.model_validate({"time": {"column": "t", "unit": declared}})
    kinematics = compiled(load_robot("clavel-delta3")).kinematics
    cure = refusal(open_log, path, kinematics, mapping).partition("declare the unit")[2]
    assert re.findall(r"unit: (\S+(?: s)?) makes", cure)[0] == true


@pytest.mark.parametrize("scale", [0.0, np.inf])
def test_no_unit_of_time_is_proposed_for_an_impossible_one(scale: float) -> None:
    assert not unit_factors(TimeChannel("t", scale, 0.0))


@pytest.mark.parametrize("name", BAD_TEXT)
@pytest.mark.parametrize("size", [1 << 22, 700])
def test_bad_csv(tmp_path, opened, monkeypatch, name: str, size: int) -> None:
    monkeypatch.setattr(csv_lines, "_BLOCK_BYTES", size)
    content, *fragments = BAD_TEXT[name]
    path = write(tmp_path / "log.csv", content)
    message = refusal(lambda log: with_filter(opened(log)), path)
    assert message.startswith(str(path))
    for fragment in fragments:
        assert fragment in message


def test_good_csv(tmp_path, opened) -> None:
    assert not opened(write(tmp_path / "log.csv", GOOD)).warnings


def test_rows_are_counted_with_comments(tmp_path, opened, monkeypatch) -> None:
    lines = with_field(150, "q2", "x").split("\n")
    for place in (200, 149, 100, 100, 1, 0, 0):  # five of them above the bad field's line
        lines.insert(place, "# remark")
    path = write(tmp_path / "log.csv", "\n".join(lines))
    for size in (1 << 22, 700, 200):
        monkeypatch.setattr(csv_lines, "_BLOCK_BYTES", size)
        bad = lines.index(next(line for line in lines if ",x," in line)) + 1
        assert f"row {bad}: column q2 is 'x'" in refusal(opened, path)
    path = write(path, "# a\n# b\n" + without_rows(150, 152).replace("\n0.1,", "\n# c\n0.1,"))
    log = opened(path)
    (doubt,) = doubts_about_holes(log.clock, log.table, "t", 3, 20)
    assert "3 rows are missing in 1 place (1 % of the recording), the first before row 153" in doubt


def test_later_passes_count_comments_once(tmp_path, opened) -> None:
    log = opened(write(tmp_path / "log.csv", GOOD.replace("\n0.1,", "\n# c\n# d\n0.1,")))
    for _ in range(2):
        assert sum(len(batch) for batch in log.batches()) == ROWS
        assert [log.table.row_place(row)[-3:] for row in (101, 102, 103)] == ["101", "104", "105"]


def test_rows_outside_the_workspace_are_counted_with_comments(tmp_path) -> None:
    robot = load_robot("clavel-delta3")
    narrow = robot.workspace.model_copy(update={"radius": 1e-3})
    kinematics = compiled(robot.changed(workspace=narrow)).kinematics

    def first(text: str) -> int:
        (doubt,) = open_log(write(tmp_path / "log.csv", text), kinematics).warnings
        return int(re.search(r"outside the workspace .* in row (\d+) at", doubt)[1])

    assert first(GOOD.replace("\n", "\n# a\n# b\n", 1)) == first(GOOD) + 2


HEADLESS = GOOD.split("\n", 1)[1]


def test_numbered_columns_must_be_there(tmp_path, opened) -> None:
    path = write(tmp_path / "log.csv", HEADLESS.replace(",", " "))
    assert opened(path, NUMBERED).samples == ROWS
    torque = tuple(column.changed(column="9") for column in NUMBERED.torque or ())
    message = refusal(opened, path, NUMBERED.changed(torque=torque[:1] + NUMBERED.torque[1:]))
    assert "row 1: has no column 9; its columns are 1, 2, 3, 4, 5, 6, 7" in message
    assert "column: 1" in refusal(opened, path)


def test_stated_units_must_fit(tmp_path, opened) -> None:
    amperes = GOOD.replace("\n", "\ns,rad,rad,rad,A,A,A\n", 1)
    message = refusal(opened, write(tmp_path / "log.csv", amperes))
    assert "row 1, unit of tau1: unit 'A' is not a unit of N m" in message
    assert "torque_constant" in message


def test_damaged_spellings_give_one_message(tmp_path, opened) -> None:
    rng = random.Random(7)
    wholes = (
        "Scope\n\n# x\n" + GOOD.replace("\n", "\n# s\ns,rad,rad,rad,Nm,Nm,Nm\n", 1) + "END\n",
        "% x\n" + GOOD.replace(",", "  ") + "// x\nEOF",
    )
    for data in (bytearray(whole.encode()) for whole in wholes for _ in range(20)):
        for _ in range(3):
            at = rng.randrange(len(data) if rng.random() < 0.5 else 100)
            data[at : at + rng.randrange(3)] = rng.choice(b'#;,\n\t "x\0%\xff-').to_bytes()
        path = write(tmp_path / "log.csv", bytes(data))
        message = ""
        try:
            opened(path)
        except DeltaidError as error:
            message = str(error)
        assert not message or (message.startswith(str(path)) and "→" in message)


def test_row_numbers_in_large_files(tmp_path) -> None:
    lines = GOOD.split("\n")
    body = "\n".join(lines[1:-1]) + "\n"
    copies = (5 << 20) // len(body)
    bad = with_field(150, "q2", "x").split("\n", 1)[1]
    path = write(tmp_path / "log.csv", lines[0] + "\n" + copies * body + bad)
    assert f"row {copies * ROWS + 150}: column q2 is 'x'" in refusal(read, path)


@pytest.mark.filterwarnings("error")
def test_no_rows_are_off_no_course() -> None:
    assert not [*off_course(np.zeros((0, 3)))]


@pytest.mark.parametrize("times", [11.0, 13.0])
@pytest.mark.parametrize("place", [40, 5, 90])
def test_a_reading_counts_as_lost_beyond_all_steps_about_it(times: float, place: int) -> None:
    """A motion of up to 1 mrad a row that one row of a drive leaves by so many times as much."""
    rng = np.random.default_rng(0)
    steps = 1e-3 * np.array([1.0, -1.0]) * rng.uniform(0.5, 1.0, (100, 2))
    steps[place + np.array([-2, 3]), 1] = -1e-3
    assert not [*off_course(steps)]
    steps[[place, place + 1], 1] = times * 1e-3, -times * 1e-3
    assert [*off_course(steps)] == ([(place, 1, 1)] if times > 12.0 else [])
    # So do two or three rows, whatever they hold.
    steps[place + 1 : place + 3, 1] = 2e-3, -times * 1e-3
    assert [*off_course(steps)] == ([(place, 1, 2)] if times > 12.0 else [])
    # Where the same drive shakes as much beside it, that is how it moves.
    steps[place + 5, 1] = 2e-3
    assert not [*off_course(steps)]
