"""What a log's time may be: dates, ticks, cycles, nothing; counters and angles that start again."""

import numpy as np
import pandas as pd
import polars as pl
import pytest

import deltaid
from deltaid.dynamics.dynamics import Dynamics
from deltaid.model.verdict import Grade
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording
from deltaid.recording.opening import open_log
from logs import comma, read, recorded, refusal, text, write

ROWS = 300
FRAME = recorded(ROWS)
TIME = FRAME["t"].to_numpy()
NANOS = np.round(TIME * 1e9).astype(np.int64) + 1_763_650_800_123_456_789


def with_time(values: object, **mapping: object) -> tuple[pl.DataFrame, ColumnMapping]:
    """The recording with another time column, and what is declared of it."""
    frame = FRAME.with_columns(t=pl.Series("t", values))
    return frame, ColumnMapping.model_validate({"time": mapping} if mapping else {})


def dates(pattern: str) -> list[str]:
    """Dates of all rows; %f stands for nanoseconds."""
    stamps = pl.Series(NANOS).cast(pl.Datetime("ns")).dt
    return stamps.to_string(pattern).to_list()


ISO = {
    "zone": (dates("%Y-%m-%dT%H:%M:%S.%9fZ"), 0),
    "blank": (dates("%Y-%m-%d %H:%M:%S.%6f"), 1e-6),
    "comma": (dates("%Y-%m-%d %H:%M:%S,%3f+0130"), 1e-3),
    "time of day": (dates("%H:%M:%S.%9f"), 0),
}


@pytest.mark.parametrize("name", ISO)
@pytest.mark.parametrize("separator", [";", "\t"])
def test_dates_as_text(tmp_path, name: str, separator: str) -> None:
    stamps, step = ISO[name]
    frame, mapping = with_time(stamps)
    number = comma if "," in stamps[0] else repr
    values = read(write(tmp_path / "log.csv", text(frame, separator, number=number)), mapping)
    np.testing.assert_allclose(values[:, 0], TIME, rtol=0, atol=max(step, 1e-15))
    np.testing.assert_array_equal(values[:, 1:], FRAME.to_numpy()[:, 1:])


@pytest.mark.parametrize("name", ISO)
@pytest.mark.parametrize("kind", ["Parquet", "polars", "pandas"])
def test_dates_as_text_in_tables(tmp_path, clavel: Dynamics, name: str, kind: str) -> None:
    stamps, step = ISO[name]
    frame, mapping = with_time(stamps)
    recording = {
        "Parquet": lambda: write(tmp_path / "log.parquet", frame),
        "polars": lambda: Recording.from_table(frame),
        "pandas": lambda: Recording.from_table(pd.DataFrame(frame.to_dict(as_series=False))),
    }[kind]()
    (batch,) = open_log(recording, clavel.kinematics, mapping).batches()
    np.testing.assert_allclose(batch[:, 0], TIME, rtol=0, atol=max(step, 1e-15))
    np.testing.assert_array_equal(batch[:, 1:7], FRAME.to_numpy()[:, 1:])


def test_a_date_that_is_none_is_named(tmp_path) -> None:
    stamps = ISO["zone"][0].copy()
    stamps[40] = "2025-02-30T00:00:00Z"
    frame, _ = with_time(stamps)
    for path, row in (
        (write(tmp_path / "log.csv", text(frame, ";")), 42),
        (write(tmp_path / "log.parquet", frame), 41),
    ):
        message = f"row {row}: column t is '2025-02-30T00:00:00Z', not a finite number"
        assert message in refusal(read, path)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_nanoseconds_since_1970_keep_their_digits(tmp_path, suffix: str) -> None:
    frame, mapping = with_time(NANOS, unit="ns")
    path = write(tmp_path / f"log.{suffix}", frame)
    np.testing.assert_allclose(read(path, mapping)[:, 0], TIME, rtol=0, atol=1e-15)


def test_ticks_and_cycles(tmp_path) -> None:
    frame, mapping = with_time(np.round(TIME * 1e7).astype(int), unit="100 ns")
    path = write(tmp_path / "log.csv", frame)
    np.testing.assert_allclose(read(path, mapping)[:, 0], TIME, rtol=0, atol=1e-15)
    frame, mapping = with_time(np.arange(ROWS) + 7, column="t", rate=1000)
    path = write(tmp_path / "log.csv", frame)
    np.testing.assert_allclose(read(path, mapping)[:, 0], TIME + 0.007, rtol=0, atol=1e-15)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_log_without_time(tmp_path, clavel: Dynamics, suffix: str) -> None:
    path = write(tmp_path / f"log.{suffix}", FRAME.drop("t"))
    mapping = ColumnMapping.model_validate({"time": {"rate": 1000}})
    np.testing.assert_allclose(read(path, mapping), FRAME.to_numpy(), rtol=0, atol=1e-15)
    log = open_log(path, clavel.kinematics, mapping)
    assert log.rate == pytest.approx(1000)
    assert not log.warnings
    message = refusal(read, path)
    assert "has no time: no column t or time; its columns are q1, q2, q3" in message
    assert "`time: {rate: 1000}`" in message


def test_a_rate_that_a_time_column_contradicts(tmp_path, clavel: Dynamics) -> None:
    path = write(tmp_path / "log.csv", recorded(1500))
    at = {rate: ColumnMapping.model_validate({"time": {"rate": rate}}) for rate in (500, 1000)}
    assert not open_log(path, clavel.kinematics, at[1000]).warnings
    log = open_log(path, clavel.kinematics, at[500])
    assert log.rate == pytest.approx(500)
    (warning,) = log.warnings
    assert "column t makes a rate of 1000 Hz, but the mapping states 500 Hz in its place" in warning
    verdicts = deltaid.check("clavel-delta3", path, columns=at[500])
    clock = next(verdict for verdict in verdicts if verdict.key == "clock")
    assert clock.grade is Grade.DOUBTFUL
    assert clock.seen in warning


@pytest.mark.parametrize(("bits", "signed"), [(8, False), (16, False), (16, True), (32, False)])
def test_cycle_counters_overflow(tmp_path, clavel: Dynamics, bits: int, signed: bool) -> None:
    counts = (np.arange(ROWS) + 2**bits - 150) % 2**bits
    if signed:
        counts = (np.arange(ROWS) + 2 ** (bits - 1) - 150 + 2 ** (bits - 1)) % 2**bits
        counts -= 2 ** (bits - 1)
    frame, mapping = with_time(counts, column="t", rate=1000)
    log = open_log(write(tmp_path / "log.csv", frame), clavel.kinematics, mapping)
    (warning,) = log.warnings
    assert warning.startswith(
        f"column t starts again after {2**bits} counts ({bits} bits) in 1 row, the first row 152: "
        "taken to go on; likeliest cause: a counter that is full"
    )
    steps = np.diff(np.concatenate(list(log.batches()))[:, 0])
    np.testing.assert_allclose(steps, 1e-3, rtol=0, atol=1e-9 * 2 ** max(0, bits - 30))


@pytest.mark.parametrize("bits", [16, 24, 32])
@pytest.mark.parametrize("signed", [False, True])
def test_encoder_counts_overflow(tmp_path, bits: int, signed: bool) -> None:
    step = 2 * np.pi / 2**20 if bits < 32 else 2 * np.pi / 2**28
    counts = np.round(FRAME["q2"].to_numpy() / step).astype(np.int64)
    shift = counts[ROWS // 2] - (2 ** (bits - 1) if signed else 0)  # overflows in the middle
    wrapped = (counts - shift) % 2**bits
    wrapped = np.where(signed & (wrapped >= 2 ** (bits - 1)), wrapped - 2**bits, wrapped)
    assert np.abs(np.diff(wrapped)).max() > 0.9 * 2**bits
    column = {"column": "q2", "unit": f"360/{2 * np.pi / step:.0f} deg"}
    columns = [{"column": "q1", "unit": "rad"}, column, {"column": "q3", "unit": "rad"}]
    mapping = ColumnMapping.model_validate({"position": columns})
    frame = FRAME.with_columns(q2=pl.Series(wrapped))
    values = read(write(tmp_path / "log.parquet", frame), mapping)[:, 2]
    np.testing.assert_allclose(np.diff(values), np.diff(counts * step), rtol=0, atol=1e-9)


def test_fast_encoders_do_not_start_again(tmp_path) -> None:
    """Steps about as large as 2¹⁶ counts, one after the other, are motion."""
    counts = np.cumsum(np.linspace(50_000, 80_000, ROWS).astype(np.int64))
    frame = FRAME.with_columns(q2=pl.Series(counts))
    values = read(write(tmp_path / "log.parquet", frame))
    np.testing.assert_array_equal(values[:, 2], counts)


def test_recorded_speeds_do_not_hide_that_time_stands_still(tmp_path, clavel: Dynamics) -> None:
    frame = recorded(ROWS, derivatives=True).with_columns(t=pl.lit(0.5))
    message = refusal(open_log, write(tmp_path / "log.csv", frame), clavel.kinematics)
    assert "column t is 0.5 s in all rows: it does not run" in message


@pytest.mark.parametrize(
    ("time", "parts"),
    [
        ({"column": "t", "unit": "s", "rate": 1000}, "gives unit and rate"),
        ({"rate": 0}, "greater than 0"),
    ],
)
def test_mistakes_in_the_mapping(time: dict[str, object], parts: str) -> None:
    with pytest.raises(ValueError, match=parts):
        ColumnMapping.model_validate({"time": time})


def test_a_column_of_times_counts_no_cycles(tmp_path) -> None:
    frame, mapping = with_time(TIME, column="t", rate=1000)
    message = refusal(read, write(tmp_path / "log.csv", frame), mapping)
    assert "row 3: column t counts no cycles: it is 0.001" in message
