"""Columns of tables that are no plain numbers: dates, durations, decimals, lists, structs."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording
from deltaid.recording.resolution import resolve_columns
from deltaid.recording.table import open_table, read_batches
from logs import recorded, refusal, write

FRAME = recorded(1500)
ROWS = FRAME.to_numpy()
# Whole microseconds, and some that only 64 bits tell apart from their neighbours.
TICKS = np.round(ROWS[:, 0] * 1e6).astype(np.int64) + np.arange(1500) % 3
START = 1_700_000_000_123_456


def samples(source: pl.DataFrame, tmp_path: Path, columns: ColumnMapping | None = None):
    """All rows, from a table in memory and from the same in Parquet."""
    held = Recording.from_table(source).table
    path = write(tmp_path / "log.parquet", source)
    found = []
    for table in (held, open_table(path, columns)):
        batches = read_batches(table, resolve_columns(table, (False,) * 3, columns))
        found.append(np.concatenate([batch.values for batch in batches]))
    np.testing.assert_array_equal(found[0], found[1])
    return found[0]


def dated(kind: pl.DataType, per_microsecond: int = 1) -> pl.DataFrame:
    ticks = pl.Series((START + TICKS) * per_microsecond)
    return FRAME.with_columns(t=ticks.cast(kind))


@pytest.mark.parametrize(
    "frame",
    [
        dated(pl.Datetime("us")),
        dated(pl.Datetime("ns"), 1000),
        dated(pl.Datetime("us", "Europe/Zurich")),
        FRAME.with_columns(t=pl.Series(TICKS * 1000 + 12_345).cast(pl.Time)),
    ],
    ids=["us", "ns", "zone", "time of day"],
)
def test_dates_are_seconds_since_the_first_row(tmp_path: Path, frame: pl.DataFrame) -> None:
    values = samples(frame, tmp_path)
    np.testing.assert_allclose(values[:, 0], (TICKS - TICKS[0]) / 1e6, rtol=1e-15, atol=0)
    np.testing.assert_array_equal(values[:, 1:], ROWS[:, 1:])


def test_slices_share_the_first_date(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = samples(dated(pl.Datetime("us")), tmp_path)
    monkeypatch.setattr("deltaid.recording.memory.BATCH_ROWS", 333)
    monkeypatch.setattr("deltaid.recording.formats.parquet._SLICE_ROWS", 444)
    np.testing.assert_array_equal(samples(dated(pl.Datetime("us")), tmp_path), whole)


def test_durations_and_decimals(tmp_path: Path) -> None:
    frame = FRAME.with_columns(
        t=pl.Series(TICKS).cast(pl.Duration("us")), q1=pl.col("q1").round(6).cast(pl.Decimal(12, 6))
    )
    values = samples(frame, tmp_path)
    np.testing.assert_allclose(values[:, 0], TICKS / 1e6, rtol=1e-15)
    np.testing.assert_allclose(values[:, 1], ROWS[:, 1], atol=5.1e-7)


def test_entries_of_structs(tmp_path: Path) -> None:
    q = pl.struct(q1="q1", deep=pl.struct(all=pl.concat_list("q2", "q3")))
    frame = FRAME.select("t", "tau1", "tau2", "tau3", pose=q)
    columns = ["pose.q1", "pose.deep.all[0]", "pose.deep.all[1]"]
    mapping = ColumnMapping.model_validate({"position": {"columns": columns, "unit": "rad"}})
    np.testing.assert_array_equal(samples(frame, tmp_path, mapping), ROWS)


TEXT = pl.col("q2").cast(pl.String)
WRONG = {
    "no date": (
        {"t": pl.when(pl.col("t") > 0).then(pl.lit(1).cast(pl.Datetime("us")))},
        "row 1: column t is empty",
    ),
    "a list that is short": (
        {
            "q": pl.when(pl.col("t") == FRAME["t"][99])
            .then(pl.concat_list("q1", "q2"))
            .otherwise(pl.concat_list("q1", "q2", "q3")),
            "q1": None,
        },
        "row 100: column q[0] is empty",
    ),
    "lists of text": ({"q": pl.concat_list(TEXT, TEXT, TEXT), "q1": None}, "no column q1, q2, q3"),
    "categories": ({"q2": TEXT.cast(pl.Categorical)}, "column q2 holds Categorical, not numbers"),
    "dates without time": ({"t": pl.lit(1).cast(pl.Date)}, "column t holds Date, not numbers"),
}


@pytest.mark.parametrize("case", WRONG)
def test_columns_that_cannot_be_used(tmp_path: Path, case: str) -> None:
    expressions, fragment = WRONG[case]
    kept = {key: value for key, value in expressions.items() if value is not None}
    frame = FRAME.with_columns(**kept)
    if "q1" in expressions:
        frame = frame.drop("q1", "q2", "q3")
    assert fragment in refusal(samples, frame, tmp_path)


def test_dates_have_no_unit(tmp_path: Path) -> None:
    mapping = ColumnMapping.model_validate({"time": {"column": "t", "unit": "ms"}})
    message = refusal(samples, dated(pl.Datetime("us")), tmp_path, mapping)
    assert "time: column t holds dates or times of day, which have no unit" in message


def test_dates_and_lists_of_pandas(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    plain = {name: FRAME[name].to_numpy() for name in FRAME.columns[4:]}
    stamps = pandas.to_datetime(START + TICKS, unit="us", utc=True)
    for time in (stamps, stamps.tz_convert("Asia/Tokyo"), stamps.tz_localize(None)):
        table = pandas.DataFrame({"t": time, "q": list(ROWS[:, 1:4]), **plain})
        held = Recording.from_table(table).table
        columns = resolve_columns(held, (False,) * 3)
        (batch,) = read_batches(held, columns)
        np.testing.assert_allclose(batch.values[:, 0], (TICKS - TICKS[0]) / 1e6, rtol=1e-15)
        np.testing.assert_array_equal(batch.values[:, 1:], ROWS[:, 1:])
    lapse = pandas.DataFrame({"t": pandas.to_timedelta(TICKS, unit="us"), "q1": ROWS[:, 1]})
    (rows,) = Recording.from_table(lapse).table.rows(["t"])
    np.testing.assert_allclose(np.asarray(rows.numbers[0]), TICKS / 1e6, rtol=1e-15)


def test_dates_of_numpy(tmp_path: Path) -> None:
    stamps = np.array(START + TICKS, dtype="M8[us]")
    for time in (stamps, stamps.astype("M8[ns]")):
        np.savez(tmp_path / "log.npz", t=time, q=ROWS[:, 1:4], tau=ROWS[:, 4:])
        table = open_table(tmp_path / "log.npz")
        (batch,) = read_batches(table, resolve_columns(table, (False,) * 3))
        np.testing.assert_allclose(batch.values[:, 0], (TICKS - TICKS[0]) / 1e6, rtol=1e-15)
