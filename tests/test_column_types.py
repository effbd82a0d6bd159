"""Columns that are no plain numbers, and units that become SI at the joint."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.recording.memory import Recording
from deltaid.recording.resolution import resolve_columns
from deltaid.recording.table import open_table, read_batches
from logs import names, read, recorded, refusal, write

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
        found.append(np.concatenate(list(batches)))
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
    monkeypatch.setattr("deltaid.recording.formats.frames.BATCH_ROWS", 333)
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


def test_durations_have_no_unit(tmp_path: Path) -> None:
    frame = FRAME.with_columns(t=pl.Series(TICKS).cast(pl.Duration("us")))
    mapping = ColumnMapping.model_validate({"time": {"column": "t", "unit": "ms"}})
    message = refusal(samples, frame, tmp_path, mapping)
    assert "time: column t holds durations, which have no unit" in message


def test_dates_and_lists_of_pandas() -> None:
    pandas = pytest.importorskip("pandas")
    plain = {name: FRAME[name].to_numpy() for name in FRAME.columns[4:]}
    stamps = pandas.to_datetime(START + TICKS, unit="us", utc=True)
    for time in (stamps, stamps.tz_convert("Asia/Tokyo"), stamps.tz_localize(None)):
        table = pandas.DataFrame({"t": time, "q": list(ROWS[:, 1:4]), **plain})
        held = Recording.from_table(table).table
        columns = resolve_columns(held, (False,) * 3)
        (batch,) = read_batches(held, columns)
        np.testing.assert_allclose(batch[:, 0], (TICKS - TICKS[0]) / 1e6, rtol=1e-15)
        np.testing.assert_array_equal(batch[:, 1:], ROWS[:, 1:])
    lapse = pandas.DataFrame({"t": pandas.to_timedelta(TICKS, unit="us"), "q1": ROWS[:, 1]})
    (rows,) = Recording.from_table(lapse).table.rows(["t"])
    np.testing.assert_allclose(np.asarray(rows.numbers[0]), TICKS / 1e6, rtol=1e-15)


def test_dates_of_numpy(tmp_path: Path) -> None:
    stamps = np.array(START + TICKS, dtype="M8[us]")
    for time in (stamps, stamps.astype("M8[ns]")):
        np.savez(tmp_path / "log.npz", t=time, q=ROWS[:, 1:4], tau=ROWS[:, 4:])
        table = open_table(tmp_path / "log.npz")
        (batch,) = read_batches(table, resolve_columns(table, (False,) * 3))
        np.testing.assert_allclose(batch[:, 0], (TICKS - TICKS[0]) / 1e6, rtol=1e-15)


def test_units_under_the_header_hold(tmp_path) -> None:
    rows = ["t,q1,q2,q3,tau1,tau2,tau3", "ms,deg,mrad,rad,Nmm,N m,kN*m", "1,90,1,1,1,1,1"]
    path = write(tmp_path / "log.csv", "\n".join([*rows, "2,0,0,0,0,0,0"]))
    expected = [1e-3, np.pi / 2, 1e-3, 1, 1e-3, 1, 1e3]
    np.testing.assert_allclose(read(path)[0], expected, rtol=1e-15)
    columns = tuple({"column": f"q{i}", "unit": "rev"} for i in (1, 2, 3))
    declared = ColumnMapping.model_validate({"position": columns, "time": {"unit": "s"}})
    expected[:4] = [1, 180 * np.pi, 2 * np.pi, 2 * np.pi]
    np.testing.assert_allclose(read(path, declared)[0], expected, rtol=1e-15)


# Declared columns, the numbers in the file, and by hand what they are at the joint in SI.
UNITS = [
    ("position", {"unit": "deg"}, 90.0, np.pi / 2),
    ("position", {"unit": "°", "zero": 10.0}, 100.0, np.pi / 2),
    ("position", {"unit": "rev", "gear": 20.0, "sign": -1}, 5.0, -np.pi / 2),
    ("position", {"unit": "360/65536 deg", "zero": 32768.0}, 49152.0, np.pi / 2),
    ("position", {"unit": "1e-3 rad"}, 1500.0, 1.5),
    ("velocity", {"unit": "rpm", "gear": 30.0}, 1800.0, 2 * np.pi),
    ("velocity", {"unit": "deg/s", "zero": -5.0}, 85.0, np.pi / 2),
    ("acceleration", {"unit": "deg/s^2"}, 180.0, np.pi),
    ("acceleration", {"unit": "rad/s²", "gear": 4.0}, 8.0, 2.0),
    ("torque", {"unit": "mN*m", "gear": 50.0}, 200.0, 10.0),
    ("torque", {"unit": "N m"}, 3.5, 3.5),
    ("torque", {"unit": "N·mm"}, 3500.0, 3.5),
    ("torque", {"unit": "A", "torque_constant": 0.5, "gear": 10.0, "zero": 1.0}, 3.0, 10.0),
    ("torque", {"unit": "0.0235 N*m", "gear": 2.0}, 100.0, 4.7),
    ("torque", {"unit": "lbf*ft"}, 10.0, 13.558179483314),
]


@pytest.mark.parametrize(("quantity", "declared", "number", "value"), UNITS)
def test_declared_columns_become_si(tmp_path, quantity, declared, number, value) -> None:
    frame = pl.DataFrame({name: [0.0, 0.25] for name in names("t", "q", "qd", "qdd", "tau")})
    frame = frame.with_columns(pl.lit(number).alias("x"), pl.lit(0.0).alias("y"))
    columns = (
        {"column": "y", **declared},
        {"column": "x", **declared},
        {"column": "z", **declared},
    )
    mapping = ColumnMapping.model_validate({quantity: columns})
    path = write(tmp_path / "log.csv", frame.with_columns(pl.lit(7.0).alias("z")))
    start = 1 + 3 * ["position", "velocity", "acceleration", "torque"].index(quantity)
    values = read(path, mapping)
    assert values[0, start + 1] == pytest.approx(value, rel=1e-12)
    assert values.shape == (2, 13)


@pytest.mark.parametrize(
    ("unit", "seconds"), [("s", 1), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("min", 60)]
)
def test_units_of_time(tmp_path, unit: str, seconds: float) -> None:
    frame = recorded(300)
    path = write(tmp_path / "log.csv", frame.rename({"t": "Zeit"}))
    mapping = ColumnMapping.model_validate({"time": {"column": "Zeit", "unit": unit}})
    np.testing.assert_allclose(read(path, mapping)[:, 0], seconds * frame["t"].to_numpy())


def test_mapping_file(tmp_path) -> None:
    source = Path(__file__).parents[1] / "examples" / "columns.yaml"
    mapping = load_mapping(source)
    assert mapping.source == str(source)
    names_of = ("time_ms", *(f"{kind}{i}" for kind in ("angle", "speed", "current") for i in "123"))
    path = write(tmp_path / "log.csv", pl.DataFrame({name: [1.0, 2.0] for name in names_of}))
    expected = [1e-3, *np.deg2rad([-1, 0.5, -1]), *[-np.pi / 300] * 3, *[-1.2] * 3]
    np.testing.assert_allclose(read(path, mapping)[0], expected)
