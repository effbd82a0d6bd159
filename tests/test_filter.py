"""The zero-phase filter, its derivatives, and filtering in windows against filtering at once."""

import numpy as np
import polars as pl
import pytest
from scipy import signal

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.identification.gathering import gather
from deltaid.identification.information import merge
from deltaid.identification.torque_error import torque_error
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import simulate_recording, surrogate_parameters
from deltaid.recording import windows as windowing
from deltaid.recording.convolution import apply
from deltaid.recording.filter import design_low_pass
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.opening import open_log
from deltaid.recording.recording import Recording, with_filter
from deltaid.recording.spectrum import SpectrumEstimate, power_of
from deltaid.recording.windows import Window
from deltaid.robot.load import load_robot
from logs import names, recorded, write

RATE = 1000.0


@pytest.mark.parametrize("decimation", [1, 2, 3, 5, 7, 16])
@pytest.mark.parametrize(("taps", "samples"), [(1, 20), (9, 9), (9, 50), (32, 101), (33, 200)])
def test_apply_is_convolution(decimation: int, taps: int, samples: int) -> None:
    rng = np.random.default_rng(taps * samples)
    h, x = rng.standard_normal(taps), rng.standard_normal((3, samples))
    direct = np.stack([np.convolve(row, h, mode="valid")[::decimation] for row in x])
    np.testing.assert_allclose(apply(h, x, decimation), direct, rtol=0, atol=1e-13 * taps)


def multi_sine(time: np.ndarray, order: int) -> np.ndarray:
    """Sines of 0.3 to 14 Hz with generic phases, or a derivative of them."""
    rng = np.random.default_rng(2)
    total = np.zeros_like(time)
    for frequency in (0.3, 1.1, 2.9, 6.7, 14.0):
        w, phase = 2 * np.pi * frequency, rng.uniform(0, 2 * np.pi)
        total += rng.uniform(0.5, 1) * w**order * np.sin(w * time + phase + order * np.pi / 2)
    return total


@pytest.mark.parametrize("rate", [RATE, 4000.0])
@pytest.mark.parametrize(("taps", "order"), [("smooth", 0), ("first", 1), ("second", 2)])
def test_derivatives_are_right_and_not_delayed(rate: float, taps: str, order: int) -> None:
    low_pass = design_low_pass(40.0, rate)  # passes up to 24 Hz
    time = np.arange(2000) / rate
    h = getattr(low_pass, taps)
    result = apply(h, multi_sine(time, 0)[None])[0]
    margin = len(h) // 2
    expected = multi_sine(time, order)[margin : len(time) - margin]
    assert np.abs(result - expected).max() < 1e-3 * np.abs(expected).max()
    # The filter's own ripple is common to all three; relative to it the derivatives are exact.
    smooth = apply(low_pass.smooth, multi_sine(time, order)[None])[0]
    trim = margin - len(low_pass.smooth) // 2
    assert np.abs(result - smooth[trim : len(smooth) - trim]).max() < 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize("cutoff", [5.0, 42.0, 100.0])
def test_bands(cutoff: float) -> None:
    low_pass = design_low_pass(cutoff, RATE)
    assert len(low_pass.smooth) % 2 == 1
    np.testing.assert_allclose(low_pass.smooth, low_pass.smooth[::-1], rtol=0, atol=1e-16)
    np.testing.assert_allclose(low_pass.first, -low_pass.first[::-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(low_pass.second, low_pass.second[::-1], rtol=0, atol=1e-9)
    frequency, response = signal.freqz(low_pass.smooth, worN=8192, fs=RATE)
    gain = np.abs(response)
    # 80 dB: what the pass band bends is a bias, and what the stop band lets through folds back.
    assert np.abs(gain[frequency < 0.6 * cutoff] - 1).max() < 2e-4
    assert gain[frequency > 1.4 * cutoff].max() < 2e-4
    assert np.interp(cutoff, frequency, gain) == pytest.approx(0.5, abs=0.01)
    # What is left after thinning does not fold back.
    assert RATE / low_pass.decimation >= 2 * 1.4 * cutoff


@pytest.mark.parametrize("cutoff", [100.1, 1e9, np.inf, np.nan, 0.0, -5.0, 1e-300])
def test_cutoffs_that_do_not_go_with_the_rate(cutoff: float) -> None:
    with pytest.raises(RecordingError, match="does not go with a sampling rate of 1000 Hz"):
        design_low_pass(cutoff, RATE)


def spectrum_of(q: np.ndarray) -> SpectrumEstimate:
    spectrum = SpectrumEstimate(q.shape[1])
    spectrum.add(power_of(q))
    return spectrum


def test_cutoff_from_the_spectrum() -> None:
    time, rng = np.arange(30_000) / RATE, np.random.default_rng(0)
    noise = 1e-5 * rng.standard_normal((len(time), 2))
    q = np.column_stack([np.sin(2 * np.pi * 0.7 * time), 0.1 * np.sin(2 * np.pi * 9 * time)])
    assert spectrum_of(q + noise).cutoff(RATE) == pytest.approx(2 * 9, abs=4)
    assert spectrum_of(q[:, :1] + noise[:, :1]).cutoff(RATE) < 6
    assert spectrum_of((q + noise)[:300]).cutoff(RATE) is not None
    assert spectrum_of((q + noise)[:255]).cutoff(RATE) is None


@pytest.mark.parametrize("highest", [3.0, 9.0, 30.0])
def test_cutoff_is_twice_the_highest_frequency_of_the_motion(highest: float) -> None:
    time, rng = np.arange(40_000) / RATE, np.random.default_rng(1)
    q = sum(np.sin(2 * np.pi * f * time) for f in (0.2 * highest, 0.7 * highest, highest))
    found = spectrum_of((q + 1e-3 * rng.standard_normal(len(time)))[:, None]).cutoff(RATE)
    main_lobe = 4 * RATE / 4096  # by which the window widens a line of the spectrum
    assert 2 * highest <= found <= 2 * (highest + 1.2 * main_lobe)


@pytest.mark.parametrize(("level", "seen"), [(16.0, False), (24.0, True)])
def test_a_line_counts_where_it_stands_20_decibels_over_the_noise(level: float, seen: bool) -> None:
    # Power of a sine of amplitude A over that of white noise σ: (A/σ)² (Σw)² / 4Σw².
    time, rng = np.arange(40 * 4096) / RATE, np.random.default_rng(2)
    w = signal.windows.blackmanharris(4096, sym=False)
    amplitude = np.sqrt(10 ** (level / 10) * 4 * np.sum(w**2)) / np.sum(w)
    line = 100 * RATE / 4096  # in the middle of a bin
    weak = amplitude * np.sin(2 * np.pi * line * time) + rng.standard_normal(len(time))
    slow = 300 * np.sin(2 * np.pi * 3.0 * time)
    found = spectrum_of((weak + slow)[:, None]).cutoff(RATE)
    assert (found > 2 * line - 1) == seen
    assert found > 6


@pytest.mark.parametrize("rate", [1000.0, 4000.0])
def test_steps_of_a_coarse_encoder_are_no_motion(rate: float) -> None:
    """Where the position stays on them for tens of samples, their noise is far from white."""
    time, rng = np.arange(round(8 * rate)) / rate, np.random.default_rng(3)
    for step in (2e-3, 5e-3):
        phase = rng.uniform(0, 2 * np.pi, (3, 2))
        q = sum(0.1 / k * np.sin(2 * np.pi * 0.6 * k * time[:, None] + phase[k - 1])
                for k in (1, 2, 3))  # fmt: skip
        assert np.mean(np.diff(np.round(q / step), axis=0) == 0) > 0.5
        assert 2 * 1.8 < spectrum_of(step * np.round(q / step)).cutoff(rate) < 12


def test_short_stretches_count_until_one_is_full() -> None:
    time, rng = np.arange(6000) / RATE, np.random.default_rng(4)
    noise = 1e-4 * rng.standard_normal(6000)
    slow, fast = (np.sin(2 * np.pi * f * time) + noise for f in (2.0, 12.0))
    spectrum = SpectrumEstimate(1)
    for q, least, most in (
        (slow[:200], None, None),  # too short to count
        (slow[:900], 4, 14),
        (fast[:900], 24, 36),
        (slow, 4, 7),
        (fast[:3000], 4, 7),
    ):
        spectrum.add(power_of(q[:, None]))
        found = spectrum.cutoff(RATE)
        assert found is None if least is None else least <= found <= most


def together(recording: Recording, dynamics: Dynamics) -> list[np.ndarray]:
    """Time, motion, torques and decimated torques of all windows."""

    def parts(w: Window) -> list[np.ndarray]:
        own, thinned = w.own, w.filtered(lambda s: s.tau.T).T
        np.testing.assert_array_equal(w.trimmed(w.wide.z), own.z)
        return [own.time, own.z, own.qd, own.qdd, own.tau, thinned]

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
        whole = together(Recording(log, low_pass), clavel)
        monkeypatch.setattr(windowing, "WINDOW", window)
        pieces = together(Recording(log, low_pass), clavel)
        lost = 2 * (low_pass.margin + low_pass.half) if low_pass else 0
        kept = len(whole[0])
        assert kept == samples - lost
        assert len(whole[-1]) == -(-kept // (low_pass.decimation if low_pass else 1))
        for one, other in zip(pieces, whole, strict=True):
            scale = np.abs(other).max()
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("recorded_rates", ["", "qd", "qd qdd"])
def test_windows_hold_the_true_motion(tmp_path, clavel: Dynamics, recorded_rates: str) -> None:
    frame = recorded(1500, derivatives=True)
    columns = names("t", "q", *recorded_rates.split(), "tau")
    log = open_log(write(tmp_path / "log.parquet", frame.select(columns)), clavel.kinematics)
    low_pass = design_low_pass(60.0, RATE)
    (window,) = Recording(log, low_pass).windows(clavel.kinematics)
    lost = low_pass.margin + low_pass.half
    inner, found = slice(lost, len(frame) - lost), window.own
    z = clavel.kinematics.forward(frame.select(names("q")).to_numpy())
    truth = [z, *(frame.select(names(kind)).to_numpy() for kind in ("qd", "qdd"))]
    for mine, true in zip((found.z, found.qd, found.qdd), truth, strict=True):
        assert np.abs(mine - true[inner]).max() < 1e-3 * np.abs(true).max()
    np.testing.assert_array_equal(found.time, frame["t"].to_numpy()[inner])
    np.testing.assert_array_equal(found.tau, frame.select(names("tau")).to_numpy()[inner])


HIGH = 20_000.0  # Hz


def at_high_rate() -> tuple[pl.DataFrame, np.ndarray]:
    """Two seconds of the three-drive robot with steps of friction, and its parameters."""
    dynamics, rng = Dynamics(load_robot("clavel-delta3")), np.random.default_rng(5)
    motion = random_motion(dynamics.kinematics, rng, period=4.0)
    p = surrogate_parameters(dynamics.robot, rng)
    return simulate_recording(dynamics, p, motion, rng, duration=2.0, rate=HIGH), p


def test_stages_of_a_high_rate() -> None:
    """The first passes all that the second lets through, and nothing that would fold there."""
    for rate in (16_000.0, HIGH, 200_000.0):
        low_pass = design_low_pass(50.0, rate)
        assert 4000 <= rate / low_pass.stride < 8000
        frequency, response = signal.freqz(low_pass.lead, worN=1 << 16, fs=rate)
        gain = np.abs(response)
        assert np.abs(gain[frequency < 70] - 1).max() < 2e-5
        spacing = rate / low_pass.stride
        folded = np.abs(frequency - spacing * np.round(frequency / spacing)) < 70
        assert gain[folded & (frequency > 70)].max() < 2e-5
        assert rate / low_pass.thinned >= 2 * 1.4 * 50.0
        one = design_low_pass(50.0, rate, single=True)
        assert (one.stride, one.lead.tolist(), one.rate) == (1, [1.0], rate)
        assert low_pass.noise_gain == pytest.approx(np.linalg.norm(one.smooth), rel=1e-3)


def test_a_row_costs_the_same_at_any_rate() -> None:
    """Multiplications a row and channel for position, velocity and acceleration."""

    def multiplications(rate: float) -> float:
        f = design_low_pass(50.0, rate)
        lead = len(f.lead) if f.stride > 1 else 0
        return (lead + 3 * len(f.first)) / f.stride

    usual = multiplications(1000.0)
    assert all(multiplications(rate) < 1.01 * usual for rate in (2e4, 5e4, 2e5, 1e6))


@pytest.mark.parametrize("recorded_rates", ["", "qd", "qd qdd"])
def test_two_stages_are_the_same_low_pass(
    tmp_path, clavel: Dynamics, monkeypatch, recorded_rates: str
) -> None:
    frame, _ = at_high_rate()
    columns = names("t", "q", *recorded_rates.split(), "tau")
    log = open_log(write(tmp_path / "log.parquet", frame.select(columns)), clavel.kinematics)
    two, one = (Recording(log, design_low_pass(50.0, HIGH, single=s)) for s in (False, True))
    assert (two.stride, one.stride) == (5, 1)
    found, expected = together(two, clavel), together(one, clavel)
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
        for mine, at_once in zip(together(two, clavel), found, strict=True):
            scale = np.abs(at_once).max()
            np.testing.assert_allclose(mine, at_once, rtol=0, atol=1e-12 * scale)


def test_two_stages_judge_as_one(tmp_path, clavel: Dynamics) -> None:
    """Torque errors of the true parameters and of others, and what the regressor says of them."""
    frame, truth = at_high_rate()
    log = open_log(write(tmp_path / "log.parquet", frame), clavel.kinematics)
    two, one = (Recording(log, design_low_pass(50.0, HIGH, single=s)) for s in (False, True))
    for p in (truth, prior_parameters(clavel.robot)):
        a, b = (torque_error(clavel, p, recording) for recording in (two, one))
        np.testing.assert_allclose(a.rms, b.rms, rtol=0.05)
        np.testing.assert_allclose(a.rms_unfiltered, b.rms_unfiltered, rtol=0.05)
    a, b = (merge(gather(clavel, recording)) for recording in (two, one))
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


def test_milliseconds_declared(tmp_path, clavel: Dynamics) -> None:
    frame = recorded(1500).with_columns(t=1000 * recorded(1500)["t"])
    mapping = ColumnMapping.model_validate({"time": {"unit": "ms"}})
    log = open_log(write(tmp_path / "log.csv", frame), clavel.kinematics, mapping)
    assert log.rate == pytest.approx(RATE)
