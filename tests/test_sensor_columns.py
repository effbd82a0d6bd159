"""Columns of sensors: named, in whatever unit, in all kinds of files, through gaps and delays."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.errors import DescriptionError
from deltaid.recording.mapped_columns import SensorColumns
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import PreparedRecording, open_recordings
from deltaid.recording.repairs import LeftSpan, Repairs
from deltaid.robot.load import load_robot, parse
from deltaid.robot.sensors import BaseWrench, StrutForce
from logs import recorded, refusal

SIX = ["plate.fx", "plate.fy", "plate.fz", "plate.mx", "plate.my", "plate.mz"]
SHARE = np.array([1000.0, 4.4482216152605, 9.80665, 1e-3, 0.112984829, 1.0])
UNITS = ("kN", "lbf", "kgf", "mN*m", "in*lbf", "N m")


@cache
def dynamics() -> Dynamics:
    sensors = {
        "plate": BaseWrench(kind="base-wrench"),
        "gauge1": StrutForce(kind="strut-force", strut="strut1a"),
    }
    return compiled(load_robot("clavel-delta3").changed(sensors=sensors))


def truth(t: np.ndarray) -> np.ndarray:
    """Seven channels, as smooth as a motion: (samples, 7)."""
    phases = np.arange(7.0)
    return 50.0 + 20.0 * phases + 10.0 * np.sin(2 * np.pi * (1 + phases) * t[:, None] + phases)


def table(samples: int = 1500) -> pl.DataFrame:
    frame = recorded(samples)
    values = truth(frame["t"].to_numpy())
    return frame.with_columns(
        [pl.Series(name, x) for name, x in zip([*SIX, "gauge1"], values.T, strict=True)]
    )


def opened(source: RecordingLike, mapping: ColumnMapping | None = None) -> PreparedRecording:
    (recording,) = open_recordings(source, dynamics().kinematics, mapping, keep_all=True)
    return recording


def shown(recording: PreparedRecording) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times, and what each sensor shows."""
    windows = list(recording.windows(dynamics().kinematics))
    columns = recording.log.columns
    parts = [columns.shown(w.inner.extra) for w in windows]
    time = np.concatenate([w.inner.time for w in windows])
    return time, {name: np.hstack([part[name] for part in parts]) for name in parts[0]}


def assert_true(recording: PreparedRecording, atol: float = 1e-9) -> None:
    time, found = shown(recording)
    assert len(time) > 500
    np.testing.assert_allclose(found["plate"], truth(time)[:, :6].T, atol=atol)
    np.testing.assert_allclose(found["gauge1"], truth(time)[:, 6:].T, atol=atol)


def test_a_log_without_such_columns_has_no_sensor() -> None:
    recording = opened(recorded())
    assert recording.log.columns.sensors == ()
    assert shown(recording)[1] == {}
    gauged = opened(table().drop(SIX))
    assert list(shown(gauged)[1]) == ["gauge1"]


def test_units_signs_and_zeros_of_each_column() -> None:
    signs, zeros = np.array([1, -1, 1, -1, 1, -1]), np.arange(6.0)
    frame = table().rename({name: f"c{i}" for i, name in enumerate(SIX)} | {"gauge1": "s"})
    raw = [frame[f"c{i}"] / (SHARE[i] * signs[i]) + zeros[i] for i in range(6)]
    frame = frame.with_columns(
        *(x.alias(f"c{i}") for i, x in enumerate(raw)), s=0.1 - frame["s"] / 12.5
    )
    mapping = ColumnMapping(
        sensors={
            "plate": SensorColumns(
                columns=tuple(f"c{i}" for i in range(6)),
                unit=UNITS,
                sign=tuple(signs.tolist()),
                zero=tuple(zeros.tolist()),
            ),
            "gauge1": SensorColumns(column="s", unit="12.5 N", sign=-1, zero=0.1),
        }
    )
    recording = opened(frame, mapping)
    time, found = shown(recording)
    np.testing.assert_allclose(found["plate"], truth(time)[:, :6].T, rtol=1e-6)
    np.testing.assert_allclose(found["gauge1"], truth(time)[:, 6:].T, rtol=1e-9)


def test_an_array_may_have_a_sensors_name(tmp_path: Path) -> None:
    frame, path = table(), tmp_path / "log.npz"
    arrays = {name: frame[name].to_numpy() for name in recorded().columns}
    arrays["plate"], arrays["gauge1"] = frame[SIX].to_numpy(), frame["gauge1"].to_numpy()
    np.savez(path, allow_pickle=False, **arrays)
    assert_true(opened(path))


def test_arrays_in_memory_carry_sensors_beside_units_of_their_own() -> None:
    frame = table()
    q = np.rad2deg(frame["q1", "q2", "q3"].to_numpy())
    given = deltaid.Recording.from_arrays(
        q=q,
        t=frame["t"].to_numpy(),
        tau=frame["tau1", "tau2", "tau3"].to_numpy(),
        unit_q="deg",
        extra={"wrench": frame[SIX].to_numpy(), "gauge1": frame["gauge1"].to_numpy()},
    )
    mapping = ColumnMapping(sensors={"plate": SensorColumns(column="wrench")})
    assert_true(opened(given, mapping))
    import pandas as pd

    assert_true(opened(pd.DataFrame(frame.to_dict(as_series=False))))


def test_each_recording_has_a_mapping_of_its_own() -> None:
    kinematics = dynamics().kinematics
    other = table(1400).rename({"gauge1": "s1"}).with_columns(tau1=pl.col("tau1") + 1e-9)
    mappings = [None, ColumnMapping(sensors={"gauge1": SensorColumns(column="s1"), "plate": None})]
    first, second = open_recordings([table(), other], kinematics, mappings)
    assert [sensor.name for sensor in first.log.columns.sensors] == ["plate", "gauge1"]
    assert [sensor.name for sensor in second.log.columns.sensors] == ["gauge1"]


def test_numbers_that_are_missing_do_not_count_and_are_reported(tmp_path: Path) -> None:
    frame = table()
    holes = {600: "", 601: "nan", 602: "OVL", 603: "inf", 604: "1e38"}
    texts = [holes.get(i, repr(x)) for i, x in enumerate(frame["plate.my"].to_list())]
    path = tmp_path / "log.csv"
    frame.with_columns(pl.Series("plate.my", texts)).write_csv(path)
    recording = opened(path)
    time, found = shown(recording)
    at = np.searchsorted(time, frame["t"].to_numpy()[600:605] - 1e-9)
    assert np.flatnonzero(np.isnan(found["plate"]).any(axis=0)).tolist() == at.tolist()
    assert np.isnan(found["plate"][:, at]).all()
    assert np.isfinite(found["gauge1"]).all()
    (warning,) = (text for text in recording.log.warnings if "plate.my" in text)
    assert "5 of 1500 rows, the first row 602" in warning


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (pl.lit(3.0).alias("plate.mx"), "column plate.mx of sensor plate is 3 in all rows"),
        (pl.lit(None, dtype=pl.Float64).alias("gauge1"), "holds no number in any row"),
        (pl.lit("ok").alias("gauge1"), "column gauge1 holds"),
    ],
)
def test_columns_in_which_nothing_was_recorded_are_refused(change: pl.Expr, words: str) -> None:
    said = refusal(opened, table().with_columns(change))
    assert words in said
    without = ColumnMapping(sensors={"plate": None, "gauge1": None})
    assert opened(table().with_columns(change), without).log.columns.sensors == ()


@pytest.mark.parametrize(
    ("sensors", "words"),
    [
        ({"plat": SensorColumns(column="x")}, "no sensor plat; its sensors are plate, gauge1"),
        ({"plat": SensorColumns(column="x")}, "did you mean plate?"),
        ({"zzz": None}, "describe it under `sensors:`"),
        (
            {"gauge1": SensorColumns(columns=("a", "b"))},
            "sensors.gauge1.columns: lists 2 columns, but the sensor shows 1 number: gauge1",
        ),
        ({"plate": SensorColumns(columns=tuple(SIX), sign=(1, -1))}, "sensors.plate.sign: lists 2"),
        ({"plate": SensorColumns(column="x")}, "has no column x[0]"),
        ({"gauge1": SensorColumns(column="gauge2")}, "did you mean gauge1?"),
        ({"gauge1": SensorColumns(column="gauge1", unit="A")}, "unit 'A' is not a unit of N"),
        ({"gauge1": SensorColumns(column="gauge1", unit="kg")}, "a force: kgf"),
        ({"plate": SensorColumns(columns=tuple(SIX), unit="N")}, "forces first"),
        ({"gauge1": SensorColumns(column="gauge1", unit="0 N")}, "makes a factor of 0"),
        ({"gauge1": SensorColumns(column="tau1")}, "column tau1 is declared 2 times"),
    ],
)
def test_mappings_that_do_not_fit_are_refused(
    sensors: dict[str, SensorColumns | None], words: str
) -> None:
    assert words in refusal(opened, table(), ColumnMapping(sensors=sensors).known_as("map.yaml"))


def test_a_wrench_of_which_columns_are_missing_is_refused() -> None:
    said = refusal(opened, table().drop("plate.my", "plate.mz"))
    assert "no plate.my, plate.mz" in said
    assert "plate: null" in said


def test_an_entry_of_a_mapping_has_one_spelling() -> None:
    with pytest.raises(DescriptionError, match="gives none of them: give one of column, columns"):
        parse("sensors:\n  plate: {unit: N}\n", ColumnMapping, where="map.yaml")
    found = parse("sensors:\n  plate: {column: w}\n  g:\n", ColumnMapping, where="map.yaml")
    assert found.sensors == {"plate": SensorColumns(column="w"), "g": None}


def test_lost_rows_leave_a_gap_and_jitter_is_interpolated() -> None:
    frame, rng = table(3000), np.random.default_rng(3)
    lost = frame.with_row_index().filter(~pl.col("index").is_in([700, 701, 1500])).drop("index")
    time, found = shown(opened(lost))
    untold = time[np.isnan(found["plate"]).any(axis=0)]
    np.testing.assert_allclose(untold, frame["t"].to_numpy()[[700, 701, 1500]], atol=1e-6)
    finite = np.isfinite(found["plate"]).all(axis=0)
    np.testing.assert_allclose(found["plate"][:, finite], truth(time)[finite, :6].T, atol=1e-9)
    # Samples that were taken unevenly: sensors are interpolated as motion and torques are.
    t = frame["t"].to_numpy() + 2e-4 * rng.uniform(-1, 1, len(frame))
    names = [name for name in frame.columns if name[0] in "qt" and name != "t"]
    uneven = {name: np.interp(t, frame["t"], frame[name]) for name in names}
    values = truth(t)
    uneven |= dict(zip([*SIX, "gauge1"], values.T, strict=True))
    recording = opened(pl.DataFrame({"t": t} | uneven))
    assert recording.log.clock.even is False
    assert_true(recording, atol=1e-5)


def test_stale_rows_do_not_count() -> None:
    frame = table(3000)
    columns = [name for name in frame.columns if name != "t"]
    held = np.arange(3000)
    held[1200:1220] = 1199
    frame = frame.with_columns(*(pl.Series(name, frame[name].to_numpy()[held]) for name in columns))
    (recording,) = open_recordings(frame, dynamics().kinematics)
    time, found = shown(recording)
    untold = time[np.isnan(found["gauge1"][0])]
    assert set(np.round(untold, 6)) >= {round(k / 1000, 6) for k in range(1200, 1220)}
    finite = np.isfinite(found["gauge1"][0])
    np.testing.assert_allclose(found["gauge1"][0, finite], truth(time)[finite, 6], atol=1e-9)


@pytest.mark.parametrize("late", [0.003, 0.0034])
def test_a_delay_of_torques_leaves_sensors_beside_the_motion(late: float) -> None:
    recording = replace(opened(table()), repairs=Repairs(delay=(late,) * 3))
    time, found = shown(recording)
    whole = np.isfinite(found["plate"]).all(axis=0)
    assert whole.mean() > 0.98
    expected = truth(time[whole])
    np.testing.assert_allclose(found["plate"][:, whole], expected[:, :6].T, atol=1e-6)


@pytest.mark.parametrize("late", [0.004, 0.0117, -0.0035])
def test_a_late_sensor_is_put_beside_the_motion(late: float) -> None:
    frame = table()
    values = truth(frame["t"].to_numpy() - late)
    frame = frame.with_columns(pl.Series(n, x) for n, x in zip(SIX, values.T[:6], strict=True))
    plate = SensorColumns(columns=tuple(SIX), delay=late)
    mapping = ColumnMapping(sensors={"plate": plate})
    time, found = shown(opened(frame, mapping))
    finite = np.isfinite(found["plate"]).all(axis=0)
    assert finite.mean() > 0.95
    np.testing.assert_allclose(found["plate"][:, finite], truth(time)[finite, :6].T, atol=1e-6)
    np.testing.assert_allclose(found["gauge1"], truth(time)[:, 6:].T, atol=1e-9)
    excerpt = opened(frame, mapping).excerpted().brief
    time, again = shown(excerpt)
    np.testing.assert_allclose(again["plate"], found["plate"])


def test_stretches_excluded_for_all_drives_do_not_count() -> None:
    spans = (LeftSpan(0.5, 0.52, "contact"), LeftSpan(0.8, 0.82, "torque spike", drives=(1,)))
    recording = replace(opened(table()), repairs=Repairs(left_out=spans))
    time, found = shown(recording)
    untold = time[np.isnan(found["plate"]).any(axis=0)]
    assert (untold.min(), untold.max()) == pytest.approx((0.5, 0.52))


def test_an_excerpt_has_sensors_too() -> None:
    recording = opened(table(3000)).excerpted().brief
    assert_true(recording)
