"""Filtered windows of a recording: equal to the whole, true, and at any rate as one low-pass."""

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.estimation.information import merge
from deltaid.identification.gathering import gather
from deltaid.identification.torque_error import torque_error
from deltaid.recording import windows as windowing
from deltaid.recording.filter import design_low_pass
from deltaid.recording.opening import open_log
from deltaid.recording.recording import PreparedRecording, with_filter
from deltaid.recording.windows import Window
from logs import names, recorded, true_parameters, write

RATE = 1000.0


def together(recording: PreparedRecording, dynamics: Dynamics) -> list[np.ndarray]:
    """Time, motion, torques and decimated torques of all windows."""

    def parts(w: Window) -> list[np.ndarray]:
        inner, thinned = w.inner, w.filtered(lambda s: s.tau.T).T
        np.testing.assert_array_equal(w.trimmed(w.wide.z), inner.z)
        return [inner.time, inner.z, inner.qd, inner.qdd, inner.tau, thinned]

    pieces = list(recording.evaluate(dynamics.kinematics, parts))
    return [np.concatenate(column) for column in zip(*pieces, strict=True)]


@pytest.mark.parametrize("samples", [1000, 1401, 1499])
@pytest.mark.parametrize("window", [61, 400, 700, 8000])
@pytest.mark.parametrize("recorded_rates", ["", "qd", "qd qdd"])
def test_windows_equal_the_whole(
    tmp_path, clavel: Dynamics, monkeypatch, samples: int, window: int, recorded_rates: str
) -> None:
    frame = recorded(1500, derivatives=True).head(samples)
    columns = names("t", "q", *recorded_rates.split(), "tau")
    log = open_log(write(tmp_path / "log.parquet", frame.select(columns)), clavel.kinematics)
    for low_pass in [design_low_pass(60.0, RATE)] + [None] * log.has_derivatives:
        monkeypatch.setattr(windowing, "WINDOW", 10**6)
        whole = together(PreparedRecording(log, low_pass), clavel)
        monkeypatch.setattr(windowing, "WINDOW", window)
        pieces = together(PreparedRecording(log, low_pass), clavel)
        lost = 2 * (low_pass.margin + low_pass.half) if low_pass else 0
        kept = len(whole[0])
        assert kept == samples - lost
        assert len(whole[-1]) == -(-kept // (low_pass.decimation if low_pass else 1))
        for piece, other in zip(pieces, whole, strict=True):
            scale = np.abs(other).max()
            np.testing.assert_allclose(piece, other, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("recorded_rates", ["", "qd", "qd qdd"])
def test_windows_hold_the_true_motion(tmp_path, clavel: Dynamics, recorded_rates: str) -> None:
    frame = recorded(1500, derivatives=True)
    columns = names("t", "q", *recorded_rates.split(), "tau")
    log = open_log(write(tmp_path / "log.parquet", frame.select(columns)), clavel.kinematics)
    low_pass = design_low_pass(60.0, RATE)
    (window,) = PreparedRecording(log, low_pass).windows(clavel.kinematics)
    lost = low_pass.margin + low_pass.half
    inner, found = slice(lost, len(frame) - lost), window.inner
    z = clavel.kinematics.forward(frame.select(names("q")).to_numpy())
    truth = [z, *(frame.select(names(kind)).to_numpy() for kind in ("qd", "qdd"))]
    for mine, true in zip((found.z, found.qd, found.qdd), truth, strict=True):
        assert np.abs(mine - true[inner]).max() < 1e-3 * np.abs(true).max()
    np.testing.assert_array_equal(found.time, frame["t"].to_numpy()[inner])
    np.testing.assert_array_equal(found.tau, frame.select(names("tau")).to_numpy()[inner])


HIGH = 20_000.0  # Hz


def at_high_rate() -> pl.DataFrame:
    """A second of the three-drive robot with steps of friction."""
    return recorded(20_000, derivatives=True, rate=HIGH)


@pytest.mark.parametrize(
    "recorded_rates", ["", pytest.param("qd", marks=pytest.mark.slow), "qd qdd"]
)
def test_two_stages_are_the_same_low_pass(
    tmp_path, clavel: Dynamics, monkeypatch, recorded_rates: str
) -> None:
    frame = at_high_rate()
    columns = names("t", "q", *recorded_rates.split(), "tau")
    log = open_log(write(tmp_path / "log.parquet", frame.select(columns)), clavel.kinematics)
    two_stages, one_stage = (
        PreparedRecording(log, design_low_pass(50.0, HIGH, single=s)) for s in (False, True)
    )
    assert (two_stages.filter.stride, one_stage.filter.stride) == (5, 1)
    found, expected = together(two_stages, clavel), together(one_stage, clavel)
    time = frame["t"].to_numpy()
    (first,) = np.flatnonzero(time == found[0][0])
    kept = slice(first, first + len(found[0]))
    np.testing.assert_array_equal(found[0], time[kept])
    np.testing.assert_array_equal(found[4], frame.select(names("tau")).to_numpy()[kept])
    (offset,) = np.flatnonzero(expected[0] == found[0][0])
    for mine, other in zip(found[1:4], expected[1:4], strict=True):
        same = other[offset : offset + len(mine)]
        assert np.abs(mine[: len(same)] - same).max() < 2e-5 * np.abs(other).max()
    for size in (61, 400):
        monkeypatch.setattr(windowing, "WINDOW", size)
        for mine, at_once in zip(together(two_stages, clavel), found, strict=True):
            scale = np.abs(at_once).max()
            np.testing.assert_allclose(mine, at_once, rtol=0, atol=1e-12 * scale)


def test_two_stages_judge_as_one(tmp_path, clavel: Dynamics) -> None:
    """Torque errors of the true parameters and of others, and what the regressor says of them."""
    frame, truth = at_high_rate(), true_parameters()
    log = open_log(write(tmp_path / "log.parquet", frame), clavel.kinematics)
    two_stages, one_stage = (
        PreparedRecording(log, design_low_pass(50.0, HIGH, single=s)) for s in (False, True)
    )
    for p in (truth, prior_parameters(clavel.robot)):
        a, b = (torque_error(clavel, p, recording) for recording in (two_stages, one_stage))
        np.testing.assert_allclose(a.rms, b.rms, rtol=0.05)
        np.testing.assert_allclose(a.rms_unfiltered, b.rms_unfiltered, rtol=0.05)
    a, b = (merge(gather(clavel, recording)) for recording in (two_stages, one_stage))
    np.testing.assert_allclose(a.rms(truth), b.rms(truth), rtol=0.05)
    assert a.rms(truth).max() < 1e-4 * a.torque_max.max()


def test_filter_is_chosen_by_what_is_recorded(tmp_path, clavel: Dynamics) -> None:
    frame = recorded(1500, derivatives=True)
    path = write(tmp_path / "log.parquet", frame)
    log = open_log(path, clavel.kinematics)
    assert with_filter(log).low_pass is None
    assert with_filter(log, 30.0).cutoff == 30.0
    positions = write(tmp_path / "positions.parquet", frame.select(names("t", "q", "tau")))
    log = open_log(positions, clavel.kinematics)
    chosen = with_filter(log)
    assert chosen.cutoff == log.suggested_cutoff


@pytest.mark.parametrize(
    ("samples", "cutoff", "reason"),
    [
        (200, None, "has 200 samples, too few to filter and differentiate (at least 256)"),
        (400, 20.0, "has 400 samples, too few to filter and differentiate at 20 Hz (at least"),
        (1500, 0.01, "has 1500 samples, too few"),
        (1500, 200.0, "a cut-off of 200 Hz does not go with a sampling rate of 1000 Hz"),
    ],
)
def test_logs_that_no_filter_fits(tmp_path, clavel: Dynamics, samples, cutoff, reason) -> None:
    path = write(tmp_path / "log.parquet", recorded(samples))
    log = open_log(path, clavel.kinematics)
    with pytest.raises(RecordingError) as caught:
        with_filter(log, cutoff)
    assert str(caught.value).startswith(f"{path}: {reason}")


@pytest.mark.parametrize(("resting", "rows"), [(200, 200), (3900, 4000)])
def test_rest_is_no_lack_of_rows(tmp_path, clavel: Dynamics, resting: int, rows: int) -> None:
    """A longer recording of the same kind would not do."""
    frame = recorded(rows).with_columns(
        pl.when(pl.int_range(rows) < resting).then(pl.first(k)).otherwise(k).alias(k)
        for k in names("q")
    )
    with pytest.raises(RecordingError) as caught:
        with_filter(open_log(write(tmp_path / "log.parquet", frame), clavel.kinematics))
    assert f"has {rows} samples, {resting} of them at rest, too few" in str(caught.value)
    assert "record a motion" in str(caught.value)
