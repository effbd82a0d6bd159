"""Recordings in memory: tables and arrays give what the same numbers in a file give."""

import functools
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from deltaid.recording.memory import Recording, as_source, as_sources
from deltaid.recording.opening import open_log
from deltaid.recording.recording import open_recordings
from deltaid.recording.row_sample import NO_ROWS, from_text, in_text, sampled, shared_rows
from logs import arrays, names, recorded, refusal

NAME = "clavel-delta3"
KINEMATICS = deltaid.Kinematics(deltaid.load_robot(NAME))


@pytest.fixture(scope="module")
def frame() -> pl.DataFrame:
    return recorded(1500)


def samples(log: object, mapping: deltaid.ColumnMapping | None = None) -> np.ndarray:
    """Time and all columns, without the weights."""
    opened = open_log(log, KINEMATICS, mapping)  # pyright: ignore[reportArgumentType]
    values = np.concatenate(list(opened.batches()))
    return values[:, : len(opened.columns.all)]


def test_lazy_tables_chunks_and_other_columns(frame: pl.DataFrame) -> None:
    rows = frame.to_numpy()
    cut = pl.concat([frame.head(700), frame.tail(800)], rechunk=False)
    noted = frame.with_columns(note=pl.lit("axis")).select("note", *reversed(frame.columns))
    for table in (frame.lazy(), cut, noted):
        np.testing.assert_array_equal(samples(table), rows)


def test_rows_beyond_a_slice(frame: pl.DataFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deltaid.recording.formats.frames.BATCH_ROWS", 333)
    np.testing.assert_array_equal(samples(frame), frame.to_numpy())
    holed = frame.with_columns(q2=pl.when(pl.col("t").is_between(1, 1)).then(None).otherwise("q2"))
    message = refusal(samples, holed)
    assert message.startswith("table, row 1001: column q2 is empty")


def test_a_table_of_pandas(frame: pl.DataFrame) -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({name: frame[name].to_numpy() for name in frame.columns})
    table["note"] = "axis"
    np.testing.assert_array_equal(samples(table), frame.to_numpy())
    assert open_log(table, KINEMATICS).sha256 == open_log(frame, KINEMATICS).sha256
    nullable = table.astype({"q1": "Float64"})
    np.testing.assert_array_equal(samples(nullable), frame.to_numpy())
    nullable.loc[5, "q1"] = pandas.NA
    assert "table, row 6: column q1 is 'nan'" in refusal(samples, nullable)
    assert "column tau1 holds String, not numbers" in refusal(samples, table.assign(tau1="low"))
    objects = table.astype({"q1": object})
    np.testing.assert_array_equal(samples(objects), frame.to_numpy())
    objects.loc[5, "q1"] = "low"
    assert "table, row 6: column q1 is 'nan'" in refusal(samples, objects)
    twice = pandas.concat([table, table[["q1"]]], axis=1)
    assert "table: has several columns called q1" in refusal(samples, twice)


def test_an_index_of_pandas_that_is_the_time_is_a_column(frame: pl.DataFrame) -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({name: frame[name].to_numpy() for name in frame.columns})
    for by_time in (table.set_index("t"), table.set_index("t").rename_axis(None)):
        np.testing.assert_array_equal(samples(by_time), frame.to_numpy())
    lapse = pandas.to_timedelta(1e9 * table.pop("t").round(6), unit="ns")
    np.testing.assert_allclose(samples(table.set_index(lapse.to_numpy())), frame.to_numpy())
    assert "has no time" in refusal(samples, table)


def test_a_recording_is_a_value(frame: pl.DataFrame) -> None:
    pandas = pytest.importorskip("pandas")
    given = {key: np.array(value, order="F") for key, value in arrays(frame).items()}
    taken = Recording.from_arrays(**given)
    table = pandas.DataFrame({name: frame[name].to_numpy() for name in frame.columns}, copy=True)
    held = Recording.from_table(table)
    for value in given.values():
        value[:] = 0.0
    table.iloc[:, :] = 0.0
    np.testing.assert_array_equal(samples(taken), frame.to_numpy())
    np.testing.assert_array_equal(samples(held), frame.to_numpy())


def test_units_of_arrays(frame: pl.DataFrame) -> None:
    given = arrays(frame)
    rows = frame.to_numpy()
    scaled = Recording.from_arrays(
        t=1e3 * given["t"],
        q=np.degrees(given["q"]),
        tau=given["tau"] * [1000, 1, 100],
        unit_t="ms",
        unit_q="deg",
        unit_tau=("mN m", "N m", "N cm"),
    )
    np.testing.assert_allclose(samples(scaled), rows, rtol=1e-14, atol=1e-14)
    single = Recording.from_arrays(
        t=given["t"].tolist(), q=given["q"].tolist(), tau=given["tau"].astype(np.float32)
    )
    np.testing.assert_allclose(samples(single), rows, rtol=1e-6, atol=1e-6)
    columns = deltaid.ColumnMapping.model_validate(
        {"position": [{"column": f"q{i}", "unit": "deg", "gear": 2} for i in (1, 2, 3)]}
    )
    motor = Recording.from_arrays(**given | {"q": np.degrees(2 * given["q"])})
    np.testing.assert_allclose(samples(motor, columns), rows, rtol=1e-14, atol=1e-14)
    # Units in a mapping go first, as for files.
    mixed = Recording.from_arrays(**given | {"q": np.degrees(2 * given["q"])}, unit_q="rev")
    np.testing.assert_array_equal(samples(mixed, columns), samples(motor, columns))


def test_derivatives_and_a_rate_in_place_of_times() -> None:
    frame = recorded(1000, derivatives=True)
    given = {key: frame.select(names(key)).to_numpy() for key in ("q", "qd", "qdd", "tau")}
    rows = samples(Recording.from_arrays(rate=1000.0, **given))
    np.testing.assert_array_equal(rows[:, 0], np.arange(1000) / 1000)
    np.testing.assert_array_equal(rows[:, 1:], np.hstack([*given.values()]))
    rpm = given | {"qd": given["qd"] * 30 / np.pi, "qdd": np.degrees(given["qdd"])}
    turned = Recording.from_arrays(rate=1000.0, unit_qd="rpm", unit_qdd="deg/s^2", **rpm)
    np.testing.assert_allclose(samples(turned), rows, rtol=1e-13, atol=1e-13)


def test_a_copy_is_refused(frame: pl.DataFrame) -> None:
    same = Recording.from_arrays(**arrays(frame))
    message = refusal(open_recordings, [frame, same], KINEMATICS)
    assert message.startswith("arrays: is the same recording as table 1")
    other = frame.with_columns(tau1=pl.col("tau1") + 1e-9)
    message = refusal(open_recordings, (other, frame, frame.clone()), KINEMATICS)
    assert message.startswith("table 3: is the same recording as table 2")
    assert len(open_recordings([frame, other], KINEMATICS)) == 2


def test_a_part_of_another_recording_is_refused(frame: pl.DataFrame) -> None:
    part = frame[600:1400].with_columns(t=pl.col("t") - 0.5)
    for tables in ((frame, part), (part, frame)):
        message = refusal(open_recordings, tables, KINEMATICS)
        assert message.startswith("table 2: has the rows of table 1, 100 % of the shorter of both")


def test_a_sample_shows_shared_rows_of_recordings_of_any_length() -> None:
    rows = np.random.default_rng(5).standard_normal((50_000, 6))

    def sample_of(part: np.ndarray) -> np.ndarray:
        return functools.reduce(sampled, np.array_split(part, 7), NO_ROWS)

    long = sample_of(rows[:40_000])
    assert len(long) == len(sample_of(rows)) < 2000
    assert shared_rows(long, sample_of(rows[20_000:])) == pytest.approx(2 / 3, abs=0.05)
    assert shared_rows(sample_of(rows[9000:9400]), long) == 1.0
    assert shared_rows(long, sample_of(rows[40_000:])) == 0.0
    assert shared_rows(NO_ROWS, long) == 0.0
    kept = from_text(in_text(long))
    assert 0 < len(kept) < len(long)
    assert shared_rows(kept, sample_of(rows[20_000:])) == pytest.approx(2 / 3, abs=0.3)
    excerpt = from_text(in_text(sample_of(rows[10_000:25_000])))
    assert shared_rows(kept, excerpt) == shared_rows(excerpt, kept) == 1.0
    assert shared_rows(kept, sample_of(rows[40_000:])) == 0.0
    assert from_text(in_text(sample_of(rows[:3]))).tolist() == sample_of(rows[:3]).tolist()


SHAPES = {
    "t shorter": ({"t": np.arange(5.0)}, "arrays, t: has shape (5,), but q has 1500 rows"),
    "flat q": ({"q": np.zeros(1500)}, "arrays, q: has shape (1500,), not (samples, drives)"),
    "empty": ({"q": np.zeros((0, 3))}, "arrays, q: has shape (0, 3), not (samples, drives)"),
    "tau of others": ({"tau": np.zeros((1500, 2))}, "arrays, tau: has shape (1500, 2), but q has"),
    "text": ({"tau": [["low"] * 3] * 1500}, "arrays, tau: holds <U3, not numbers"),
    "complex": ({"q": np.zeros((1500, 3)) * 1j}, "arrays, q: holds complex128, not numbers"),
    "ragged": ({"q": [[1.0, 2.0], [1.0]]}, "arrays, q: rows differ in length"),
    "ragged extra": ({"extra": {"grip": [[1.0], []]}}, "arrays, extra grip: rows differ in length"),
    "masked": (
        {"q": np.ma.masked_less(np.tile([-1.0, 1.0, 1.0], (1500, 1)), 0)},
        "arrays, q: has masked values",
    ),
    "no time": ({"t": None}, "arrays: neither t nor rate is given"),
    "two times": ({"rate": 1000.0}, "arrays: both t and rate are given"),
    "no rate": ({"t": None, "rate": float("nan")}, "arrays, rate: is nan"),
    "rate zero": ({"t": None, "rate": 0.0}, "arrays, rate: is 0.0"),
    "unit of rate": ({"t": None, "rate": 1e3, "unit_t": "ms"}, "arrays, unit_t: belongs to t"),
    "unit of nothing": ({"unit_qd": "rpm"}, "arrays, unit_qd: qd is not given"),
    "two units": ({"unit_q": ("deg", "deg")}, "arrays, unit_q: has 2 units for 3 drives"),
    "name": ({"name": ""}, "name: '' is no name of a recording"),
}


@pytest.mark.parametrize("case", SHAPES)
def test_arrays_that_do_not_fit(frame: pl.DataFrame, case: str) -> None:
    change, expected = SHAPES[case]
    message = refusal(lambda: Recording.from_arrays(**arrays(frame) | change))
    assert message.startswith(expected)
    assert "\n  → " in message


def test_values_and_units_that_do_not_fit(frame: pl.DataFrame) -> None:
    given = arrays(frame)
    q = given["q"].copy()
    q[17, 1] = np.nan
    message = refusal(samples, Recording.from_arrays(**given | {"q": q}))
    assert message.startswith("arrays, row 18: column q2 is 'nan', not a finite number")
    wrong = Recording.from_arrays(**given, unit_tau="deg", name="run 7")
    message = refusal(samples, wrong)
    assert message.startswith("run 7, unit of tau1: unit 'deg' is not a unit of N m")
    two = Recording.from_arrays(t=given["t"], q=given["q"][:, :2], tau=given["tau"][:, :2])
    assert refusal(samples, two).startswith("arrays: q has 2 columns, but the robot has 3 drives")
    silent = Recording.from_arrays(t=given["t"], q=given["q"])
    assert refusal(samples, silent).startswith("arrays: has no torque columns")
    texts = frame.with_columns(t=pl.lit("12:00"))
    assert refusal(samples, texts).startswith("table: column t holds String, not numbers")
    lazy = frame.lazy().select("no such column")
    assert refusal(samples, lazy).startswith("table: cannot be computed: ")


def test_what_is_no_recording(frame: pl.DataFrame) -> None:
    for call in (as_source, as_sources):
        message = refusal(call, None)
        assert message.startswith("logs: a NoneType is no recording")
        assert "deltaid.Recording.from_arrays" in message
        message = refusal(call, frame.to_numpy())
        assert message.startswith("table: an array of shape (1500, 7) has no names of columns")
        assert "a dictionary of arrays" in message
    ragged = refusal(as_source, {"t": [0.0, 1.0], "q": [[1.0, 2.0], [1.0]]})
    assert ragged.startswith("table, q: rows differ in length")
    assert "no log was given" in refusal(open_recordings, [], KINEMATICS)
    assert [str(source) for source in as_sources(("a.csv", frame))] == ["a.csv", "table 2"]


def test_columns_of_an_array_are_the_same_wherever_they_begin(
    tmp_path: Path, frame: pl.DataFrame
) -> None:
    """Behind others, so that the array's first columns are never read."""
    q, tau = (frame.select(names(key)).to_numpy() for key in ("q", "tau"))
    wide = np.hstack([np.zeros((len(q), 2)), q])
    np.savez(tmp_path / "log.npz", t=frame["t"].to_numpy(), q=wide, tau=tau)
    columns = {
        "position": [{"column": f"q[{k}]", "unit": "rad"} for k in (2, 3, 4)],
        "torque": [{"column": f"tau[{k}]", "unit": "N m"} for k in range(3)],
    }
    found = samples(tmp_path / "log.npz", deltaid.ColumnMapping.model_validate(columns))
    np.testing.assert_array_equal(found[:, 1:7], np.hstack([q, tau]))
