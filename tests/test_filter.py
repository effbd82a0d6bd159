"""The zero-phase filter: derivatives, bands, stages, and the cut-off that a spectrum asks for."""

import numpy as np
import pytest
from scipy import signal

from deltaid.errors import RecordingError
from deltaid.recording.filter import design_low_pass
from deltaid.recording.spectrum import apply, spectrum_of

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
    # Thinned as far as the stop band allows, which begins at 1.4 times the cut-off.
    between = RATE / low_pass.stride
    assert between / low_pass.decimation >= 2 * 1.4 * cutoff
    assert between / (low_pass.decimation + 1) < 2 * 1.4 * cutoff


@pytest.mark.parametrize("cutoff", [100.1, 1e9, np.inf, np.nan, 0.0, -5.0, 1e-300])
def test_cutoffs_that_do_not_go_with_the_rate(cutoff: float) -> None:
    with pytest.raises(RecordingError, match="does not go with a sampling rate of 1000 Hz"):
        design_low_pass(cutoff, RATE)


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
    spectrum = spectrum_of(np.zeros((0, 1)))
    for q, least, most in (
        (slow[:200], None, None),  # too short to count
        (slow[:900], 4, 14),
        (fast[:900], 24, 36),
        (slow, 4, 7),
        (fast[:3000], 4, 7),
    ):
        spectrum += spectrum_of(q[:, None])
        found = spectrum.cutoff(RATE)
        assert found is None if least is None else least <= found <= most


def test_stages_of_a_high_rate() -> None:
    """The first passes all that the second lets through, and nothing that would fold there."""
    for rate in (16_000.0, 20_000.0, 200_000.0):
        low_pass = design_low_pass(50.0, rate)
        assert 4000 <= rate / low_pass.stride < 8000
        frequency, response = signal.freqz(low_pass.lead, worN=1 << 16, fs=rate)
        gain = np.abs(response)
        assert np.abs(gain[frequency < 70] - 1).max() < 2e-5
        spacing = rate / low_pass.stride
        folded = np.abs(frequency - spacing * np.round(frequency / spacing)) < 70
        assert gain[folded & (frequency > 70)].max() < 2e-5
        assert rate / low_pass.thinned >= 2 * 1.4 * 50.0
        one_stage = design_low_pass(50.0, rate, single=True)
        assert (one_stage.stride, one_stage.lead.tolist(), one_stage.rate) == (1, [1.0], rate)
        assert low_pass.noise_gain == pytest.approx(np.linalg.norm(one_stage.smooth), rel=1e-3)


def test_a_row_costs_the_same_at_any_rate() -> None:
    """Multiplications a row and channel for position, velocity and acceleration."""

    def multiplications(rate: float) -> float:
        f = design_low_pass(50.0, rate)
        lead = len(f.lead) if f.stride > 1 else 0
        return (lead + 3 * len(f.first)) / f.stride

    usual = multiplications(1000.0)
    assert all(multiplications(rate) < 1.01 * usual for rate in (2e4, 5e4, 2e5, 1e6))
