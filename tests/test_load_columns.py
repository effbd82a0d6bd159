"""What a robot carries, and when: declared in a mapping, read with a recording, masked, checked."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError, RecordingError
from deltaid.estimation.additions import extended
from deltaid.identification.measured_rows import LoadSlope
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording
from deltaid.recording.carried import Load
from deltaid.recording.log import Log
from deltaid.recording.mapping import ColumnMapping, load_mapping, mapping_each
from deltaid.recording.memory import Recording
from deltaid.recording.opening import open_log
from deltaid.recording.recording import open_recordings
from deltaid.recording.windows import SampleBlock
from deltaid.robot.load import load_robot

CLAVEL = load_robot("clavel-delta3")


@pytest.fixture(scope="module")
def frame() -> pl.DataFrame:
    """5 s at 500 Hz with a column that is 1 from 2 s to 3 s."""
    dynamics, rng = compiled(CLAVEL), np.random.default_rng(3)
    motion = random_motion(dynamics.kinematics, rng, period=5.0)
    p = np.array([parameter.prior for parameter in dynamics.layout.parameters])
    noise = SensorNoise(encoder_step=1e-5, torque=0.01)
    table = simulate_recording(dynamics, p, motion, rng, duration=5.0, rate=500.0, noise=noise)
    return table.with_columns(grip=((pl.col("t") >= 2) & (pl.col("t") < 3)).cast(pl.Float64))


def mapping(text: str, folder: Path) -> ColumnMapping:
    (folder / "columns.yaml").write_text(text)
    return load_mapping(folder / "columns.yaml")


def opened(source: object, **load: object) -> Log:
    columns = ColumnMapping(load=Load.model_validate(load))
    return open_log(source, compiled(CLAVEL).kinematics, columns)  # pyright: ignore[reportArgumentType]


def held(log: Log) -> np.ndarray:
    """Whether the load is held, row by row."""
    rows = np.concatenate(list(log.batches()))
    return log.columns.held(rows[:, 0], rows[:, log.columns.extra_places])[0]


def test_a_mapping_declares_loads(tmp_path: Path) -> None:
    text = """
load:
- {column: gripper, when: [2, 3], name: part}
- {spans: [[2.0, 5.5], [7, 8]], name: kilogram, mass: 1.0, centre: [0, 0, -0.05],
   inertia: {xx: 1e-3, yy: 1e-3, zz: 1e-3}, mass_tolerance: 0.001}
"""
    part, kilogram = mapping(text, tmp_path).loads
    assert (part.name, part.holding, part.known) == ("part", (2.0, 3.0), {})
    assert kilogram.known["mass"] == 1.0
    time = np.array([1.9, 2.0, 5.4, 5.5, 7.5, 8.0])
    assert kilogram.held(time, None).tolist() == [0, 1, 1, 0, 1, 0]
    assert part.held(time[:3], np.array([1.0, 2.0, 3.0])).tolist() == [0, 1, 1]
    assert mapping("load: {always: true}", tmp_path).loads[0].held(time, None).all()


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        ("{mass: 1}", "line 1, load: gives none of them: give one of column, spans"),
        ("{always: true, column: g}", "gives column and always"),
        ("{always: true, when: 1}", "load.when: lists numbers of a column"),
        ("{spans: [[3, 2]]}", "span [3, 2] does not follow"),
        ("{spans: [[1, 3], [2, 4]]}", "span [2, 4] does not follow"),
        ("{always: true, course: fills}", "load.course: needs spans"),
        ("{spans: [[1, 2]], course: falls}", "load.course"),
        ("{spans: []}", "load.spans: needs at least one span"),
        ("{always: true, mass: -1}", "mass"),
        ("{always: true, centre: [0, 0, 0]}", "gives centre but no mass"),
        ("{always: true, mass: 1, inertia: {xx: 1, yy: 1, zz: 1}}", "inertia but no centre"),
        ("{always: true, mass: 1, mass_tolerance: 0.6}", "more than half the mass"),
        (
            "{always: true, mass: 1, centre: [0, 0, 0], inertia: {xx: 1, yy: 1, zz: 3}}",
            "the load is not a physical body: its principal moments",
        ),
        ("[{always: true}, {column: g}]", "two loads are called load"),
    ],
)
def test_declarations_that_cannot_be(text: str, fragment: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError) as error:
        mapping(f"load: {text}", tmp_path)
    assert fragment in str(error.value)
    assert "deltaid schema columns" in str(error.value)


def test_rows_about_a_change_are_excluded(frame: pl.DataFrame) -> None:
    log = opened(frame, column="grip")
    masks = [mask for mask in log.masks if mask.reason == "load changes"]
    assert [(mask.first, mask.last) for mask in masks] == [(994, 1005), (1494, 1505)]
    assert all(mask.drives == (0, 1, 2) for mask in masks)
    weights = np.concatenate(list(log.batches()))[:, -3:]
    assert not weights[994:1006].any()
    assert np.flatnonzero(held(log))[[0, -1]].tolist() == [1000, 1499]


def test_spans_and_columns_say_the_same(frame: pl.DataFrame) -> None:
    by_column = opened(frame, column="grip")
    by_spans = opened(frame.drop("grip"), spans=[[2, 3]])
    assert by_column.masks == by_spans.masks
    np.testing.assert_array_equal(held(by_column), held(by_spans))


def test_rows_on_a_course_count_but_about_its_ends(frame: pl.DataFrame) -> None:
    frame = frame.drop("grip")
    emptied = opened(frame, spans=[[2, 3]], course="empties")
    assert emptied.masks == opened(frame, spans=[[2, 3]]).masks


def test_loads_that_empty_or_fill_are_held_in_part() -> None:
    time, spans = np.array([0.9, 1.0, 1.5, 2.9, 3.0, 4.25, 5.0]), ((1.0, 3.0), (4.0, 5.0))
    shares = [0.0, 1.0, 0.75, 0.05, 0.0, 0.75, 0.0]
    np.testing.assert_allclose(
        Load(spans=spans, course="empties").held(time, None), shares, atol=1e-12
    )
    shares = [0.0, 0.0, 0.25, 0.95, 0.0, 0.25, 0.0]
    np.testing.assert_allclose(
        Load(spans=spans, course="fills").held(time, None), shares, atol=1e-12
    )


def test_what_is_beside_the_drives_is_held_where_rows_are_lost(frame: pl.DataFrame) -> None:
    # A ramp would be interpolated; here three rows are lost just as it changes.
    lost = frame.with_row_index().filter(~pl.col("index").is_in([998, 999, 1000])).drop("index")
    log = opened(lost, column="grip")
    rows = np.concatenate([block for part in log.segments(20.0) for block in part])
    state = rows[:, log.columns.extra_places][:, 0]
    assert len(rows) == len(frame)
    assert set(state) == {0.0, 1.0}
    assert np.flatnonzero(state)[[0, -1]].tolist() == [1001, 1499]


def test_what_is_beside_the_drives_comes_with_the_samples(frame: pl.DataFrame) -> None:
    columns = ColumnMapping(load=Load(column="grip"))
    kinematics = compiled(CLAVEL).kinematics
    (recording,) = open_recordings([frame], kinematics, columns)
    time, state = (
        np.concatenate([np.ravel(getattr(w.inner, name)) for w in recording.windows(kinematics)])
        for name in ("time", "extra")
    )
    np.testing.assert_array_equal(state, (time >= 2 - 1e-9) & (time < 3 - 1e-9))


@pytest.mark.parametrize("kind", ["parquet", "npz", "text", "pandas"])
def test_states_of_all_kinds_of_files(kind: str, frame: pl.DataFrame, tmp_path: Path) -> None:
    truth = frame.with_columns(pl.col("grip") == 1)
    path = tmp_path / f"log.{kind}"
    if kind == "parquet":
        truth.write_parquet(path)
    elif kind == "npz":
        np.savez(
            path, allow_pickle=False, **{name: truth[name].to_numpy() for name in truth.columns}
        )
    elif kind == "text":
        path = tmp_path / "log.csv"
        truth.with_columns(pl.col("grip").cast(pl.String).str.to_uppercase()).write_csv(path)
    elif kind == "pandas":
        pandas = pytest.importorskip("pandas")
        truth = pandas.DataFrame(truth.to_dict(as_series=False))
    log = opened(truth if kind == "pandas" else path, column="grip")
    np.testing.assert_array_equal(held(log), frame["grip"].to_numpy() == 1)


@pytest.mark.parametrize(
    ("load", "change", "fragment"),
    [
        ({"column": "gripper"}, {}, "has no column gripper"),
        ({"column": "grip"}, {"grip": 3.0}, "column grip of load load is 3, neither 0 nor 1"),
        ({"column": "grip"}, {"grip": None}, "column grip is empty"),
        ({"column": "tau1"}, {}, "column tau1 is declared 2 times"),
    ],
)
def test_columns_that_say_no_state(
    load: dict[str, object], change: dict[str, object], fragment: str, frame: pl.DataFrame
) -> None:
    rows = pl.int_range(pl.len()) == 700
    for name, value in change.items():
        frame = frame.with_columns(pl.when(rows).then(value).otherwise(pl.col(name)).alias(name))
    with pytest.raises(RecordingError) as error:
        opened(frame, **load)
    assert fragment in str(error.value)
    if change:
        assert "row 701" in str(error.value)


def test_numbers_of_other_states(frame: pl.DataFrame) -> None:
    codes = frame.with_columns(pl.col("grip") * 3 + 7)
    np.testing.assert_array_equal(
        held(opened(codes, column="grip", when=10)), held(opened(frame, column="grip"))
    )


def test_spans_beside_the_recording_are_reported(frame: pl.DataFrame) -> None:
    texts = [str(text) for text in opened(frame, spans=[[100, 200]]).warnings]
    assert any("load load is declared for spans in which nothing was recorded" in t for t in texts)


def test_arrays_have_states_too(frame: pl.DataFrame) -> None:
    q, tau = (np.rad2deg(frame[f"{k}1", f"{k}2", f"{k}3"].to_numpy()) for k in ("q", "tau"))
    arrays = Recording.from_arrays(
        rate=500.0, q=q, tau=np.deg2rad(tau), unit_q="deg", extra={"grip": frame["grip"]}
    )
    np.testing.assert_array_equal(
        held(opened(arrays, column="grip")), held(opened(frame, column="grip"))
    )
    with pytest.raises(RecordingError, match="has shape"):
        Recording.from_arrays(rate=500.0, q=q, extra={"grip": np.zeros(3)})
    with pytest.raises(RecordingError, match="tau1 is the name of a drive's column"):
        Recording.from_arrays(rate=500.0, q=q, tau=tau, extra={"tau1": frame["grip"]})


def test_one_mapping_for_all_recordings_or_one_each() -> None:
    default, other = ColumnMapping(), ColumnMapping(load=Load(always=True))
    assert mapping_each(None, 2) == [None, None]
    assert mapping_each(other, 2) == [other, other]
    assert mapping_each([other], 2) == [other, other]
    assert mapping_each([default, other], 2) == [default, other]
    assert mapping_each([None, other], 2) == [None, other]
    with pytest.raises(RecordingError, match="2 mappings are given for 3 recordings"):
        mapping_each([default, other], 3)


def test_columns_are_slopes_of_the_torques_and_their_sum_is_these() -> None:
    """τ(p) of a robot whose drives lose 5 % and 8 % of what they carry, without differences."""
    robot = load_robot("irb360-6-1600")
    laws = {drive: robot.friction[drive].changed(load=share)
            for drive, share in (("drive1", 0.05), ("drive4", 0.08))}  # fmt: skip
    dynamics = compiled(robot.changed(friction=dict(robot.friction) | laws))
    p, n = prior_parameters(dynamics.robot), 40
    motion = random_motion(dynamics.kinematics, np.random.default_rng(0))
    z, zd, zdd = motion.evaluate(np.linspace(0.3, motion.period, n))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    x = dynamics.carried(z, qd, qdd, p)
    w = SampleBlock(np.arange(n) / n, z, qd, qdd, 0 * qd, 1 + 0 * qd, np.zeros((n, 0)), 0 * qd)
    slope = LoadSlope.about(extended(dynamics, ()), p)
    np.testing.assert_array_equal(slope.shares, [0.05, 0, 0, 0.08])
    factor = slope.factor(w, x)
    sparse = dynamics.sparse_regressor(z, qd, qdd, x)
    Y = np.zeros((4, len(p), n))
    Y[sparse.rows, sparse.columns] = slope.scaled(sparse.values, factor)
    torque = dynamics.torque(z, qd, qdd, p).T
    np.testing.assert_allclose(np.einsum("dks,k->ds", Y, p), torque + factor * x.T, atol=1e-9)
    for name in (
        "EE.Izz",
        "rotor.drive4",
        "U.mcx",
        "coulomb.slide",
        "coulomb.drive1",
        "load.drive4",
    ):
        k = dynamics.layout.names.index(name)
        step = 1e-4 * max(abs(p[k]), 1e-3) * np.eye(len(p))[k]
        up, down = (dynamics.torque(z, qd, qdd, p + s).T for s in (step, -step))
        at = np.abs(x.T) > 1e-3  # |x| has no slope where nothing is carried
        slopes = (up - down) / (2 * step[k])
        np.testing.assert_allclose(Y[:, k][at], slopes[at], atol=1e-6 * np.abs(slopes).max())
