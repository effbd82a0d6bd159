"""State of robots on the pages of a fleet: what asks for attention, and what is unknown."""

from datetime import datetime, timedelta
from pathlib import Path

import polars as pl
import pytest

from fleet_tables import START, TYPES, changed, write, write_tables
from html_page import document, words


@pytest.mark.parametrize(
    ("weeks", "grade", "text"),
    [
        (20, "fair", "hardly before"),
        (3, "poor", "hardly before"),
        (-1, "poor", "is beyond its limit"),
    ],
)
def test_a_limit_within_four_weeks_is_to_be_acted_upon(
    tmp_path: Path, weeks: int, grade: str, text: str
) -> None:
    folder = write_tables(tmp_path, 3, 15, foreign=())
    now = pl.read_parquet(folder / "recordings.parquet")["time"].max()
    assert isinstance(now, datetime)
    horizon = now + timedelta(weeks=weeks)
    changed(folder, "drift", "R003", "q2", horizon=horizon, horizon_low=horizon)
    write(folder)
    page = folder / "site" / "robots" / "R003.html"
    assert f'class="verdict {grade}"' in page.read_text(encoding="utf-8")
    assert text in words(page)


def test_what_nobody_can_tell_is_not_called_good(tmp_path: Path) -> None:
    folder = write_tables(tmp_path, 3, 1, rising=(), foreign=())
    for robot in ("R001", "R002", "R003"):
        changed(folder, "drift", robot, state="unknown", reason="not enough data: no change")
    write(folder)
    said = words(folder / "site" / "index.html")
    assert "there is not enough data on 3 of 3" in said
    assert "good" not in [cell.strip() for cell in document(folder / "site" / "index.html").texts]
    assert "Not enough data on 9 of 9 drives" in said
    assert 'class="verdict untested"' in (folder / "site" / "index.html").read_text("utf-8")
    robot = words(folder / "site" / "robots" / "R001.html")
    assert "Not enough data to say whether friction changes." in robot
    assert "q1: not enough data: no change." in robot
    assert "No inspection needed" not in robot
    kind = words(folder / "site" / "types" / f"{TYPES[0]}.html")
    assert "Whether its robots are of one type is not known." in kind  # two robots cannot tell


def test_numbers_of_the_quarantine_agree(tmp_path: Path) -> None:
    """A recording that the manifest names and that is not there; a period without a fit."""
    folder = write_tables(tmp_path, 3, 3, rising=(), foreign=())
    pl.DataFrame(
        {"what": ["recording", "fit"], "robot": ["R001", "R003"],
         "which": ["s3://plant/R001/gone.csv", "2026-01"], "reason": ["no such file", "too short"]}
    ).write_csv(folder / "quarantine.csv")  # fmt: skip
    write(folder)
    said = words(folder / "site" / "index.html")
    assert "2 that could not be used" in said
    assert "in quarantine 2 recording: 1, fit: 1" in said
    assert "1 of 10 recordings are in quarantine" in said
    assert "4 recordings" in words(folder / "site" / "robots" / "R001.html")


def test_a_wrong_torque_constant_is_named(tmp_path: Path) -> None:
    """Of ratios, whose product is 1, the drive unlike the others; else each that is not 1. A single
    one is no ratio."""
    folder = write_tables(tmp_path, 4, 3, rising=(), foreign=())
    path = folder / "parameters.parquet"
    frame = pl.read_parquet(path)
    values = {"R001": (0.95, 1.026, 1.026), "R002": (0.93, 0.93, 0.93), "R003": (1.0, 1.0, 1.0),
              "R004": (1.0025,)}  # fmt: skip
    for robot, gains in values.items():
        own = frame.filter((pl.col("robot") == robot) & (pl.col("parameter") == "EE.m"))
        for drive, gain in zip(("q1", "q2", "q3"), gains, strict=False):
            rows = own.with_columns(
                parameter=pl.lit(f"gain.{drive}"), value=gain, std=0.001, low=gain - 0.002,
                high=gain + 0.002, unit=pl.lit(""), prior=1.0,
            )  # fmt: skip
            frame = pl.concat([frame, rows])
    frame.write_parquet(path)
    write(folder)
    said = words(folder / "site" / "index.html")
    assert "3 of 4 robots need attention." in said
    assert "R004: q1 gives 1.002 ± 0.001 times the torque that it records: torque const" in said
    assert "R001: q1 gives 0.926 ± 0.001 times the torque that it records, against other" in said
    assert "R001: q2" not in said
    assert "R002: q1 gives 0.930 ± 0.001 times the torque that it records: torque const" in said
    assert "unit of torques? " in said
    assert "?." not in said + words(folder / "site" / "robots" / "R002.html")
    assert "gain.q1" in words(folder / "site" / "robots" / "R003.html")


def test_a_torque_constant_that_the_last_recordings_doubt_is_named_before_a_body(
    tmp_path: Path,
) -> None:
    """Gathered recordings are not corrected by it, so no `gain` is among their parameters."""
    folder = write_tables(tmp_path, 8, 4, rising=(), foreign=(0,))
    path = folder / "recordings.parquet"
    frame = pl.read_parquet(path).sort("robot", "time")
    behind = pl.int_range(pl.len()).reverse().over("robot")
    doubted = ((pl.col("robot") == "R001") & (behind < 3)) | (
        (pl.col("robot") == "R002") & (behind < 2)
    )
    frame.with_columns(
        verdicts=pl.when(doubted).then(pl.lit("drive-gain, torque-lag")).otherwise(pl.lit(""))
    ).write_parquet(path)
    write(folder)
    said = words(folder / "site" / "index.html")
    doubt = "its last 3 recordings show a wrong torque constant of a drive (deltaid check names it)"
    assert f"R001: {doubt}; does not belong to its type" in said
    assert "1 of 8 robots needs attention." in said


@pytest.mark.parametrize(
    ("days", "which"), [(1, "only recording shows"), (2, "last 2 recordings show")]
)
def test_a_robot_with_few_recordings_shows_a_wrong_torque_constant_by_all_of_them(
    days: int, which: str, tmp_path: Path
) -> None:
    folder = write_tables(tmp_path, 3, days, rising=(), foreign=())
    changed(folder, "recordings", "R001", verdicts="drive-gain")
    write(folder)
    said = words(folder / "site" / "index.html")
    assert f"R001: its {which} a wrong torque constant of a drive" in said
    assert "1 of 3 robots needs attention." in said


def test_a_robots_page_dates_the_recordings_that_were_used(tmp_path: Path) -> None:
    folder = write_tables(tmp_path, 2, 4, rising=(), foreign=(), silent=(1,))
    changed(folder, "recordings", "R001", reason="")
    path = folder / "recordings.parquet"
    first = pl.col("time") == START
    frame = pl.read_parquet(path)
    refused = frame.with_columns(reason=pl.when(first).then(pl.lit("cut off")).otherwise("reason"))
    refused.write_parquet(path)
    write(folder)
    said = words(folder / "site" / "robots" / "R001.html")
    assert "4 recordings, used from 2026-01-12 to 2026-01-26" in said
    assert "4 recordings, none used" in words(folder / "site" / "robots" / "R002.html")


def test_whether_robots_are_alike_is_no_number_where_nobody_knows(tmp_path: Path) -> None:
    """Three robots are too few, and one has no plural."""
    for robots, counted in ((3, "3 robots of 2 types"), (1, "1 robot of 2 types")):
        folder = write_tables(tmp_path / str(robots), robots, 3, rising=(), foreign=())
        write(folder)
        said = words(folder / "site" / "index.html")
        assert counted in said
        assert "not like their type —" in said


def test_a_robot_without_recordings_is_not_said_to_belong(tmp_path: Path) -> None:
    folder = write_tables(tmp_path, 12, 3, rising=(), foreign=(), silent=(7,))
    write(folder)
    types = [words(folder / "site" / "types" / f"{kind}.html") for kind in TYPES]
    assert "All 6 robots belong to this type." in types[0]
    assert "All 5 robots that could be compared belong to this type; 1 could not." in types[1]


def test_silence_and_failed_fits_ask_for_attention(tmp_path: Path) -> None:
    folder = write_tables(tmp_path, 3, 15, rising=(), foreign=())
    path = folder / "recordings.parquet"
    frame = pl.read_parquet(path)
    late = (pl.col("robot") == "R002") & (pl.col("time") > START + timedelta(weeks=8))
    frame.filter(~late).write_parquet(path)
    pl.DataFrame(
        {"what": ["fit", "fit", "type"], "robot": ["R001", "R003", ""],
         "which": ["2026-01", "2026-05", TYPES[0]], "reason": "too little motion"}
    ).write_csv(folder / "quarantine.csv")  # fmt: skip
    write(folder)
    said = words(folder / "site" / "index.html")
    assert "2 of 3 robots need attention." in said
    assert "R002: no recording since 2026-03-02" in said
    assert "R003: no fit of 2026-05: too little motion" in said
    assert f"Robots of type {TYPES[0]} could not be compared: too little motion" in said
    assert "R001:" not in said  # a later period could be fitted
