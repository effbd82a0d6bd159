"""Values at other instants, and channels with clocks of their own on one grid."""

import numpy as np
import pytest

from deltaid.recording.time.resampling import Signal, fastest, interpolate, merge


def wave(time: np.ndarray, frequency: float = 10.0) -> np.ndarray:
    """Two channels of one frequency [Hz], and a polynomial of degree 7."""
    phase = 2 * np.pi * frequency * time
    return np.column_stack([np.sin(phase), np.cos(phase), (time - 0.5) ** 7])


@pytest.mark.parametrize("uneven", [0.0, 0.2])
def test_band_limited_values_at_other_instants(uneven: float) -> None:
    rng = np.random.default_rng(1)
    time = (np.arange(100) + uneven * rng.uniform(-1, 1, 100)) / 100  # ten samples a period
    at = rng.uniform(0.05, 0.94, 20_000)
    found = interpolate(time, wave(time), at)
    np.testing.assert_allclose(found, wave(at), atol=3e-4 if uneven else 6e-5)
    np.testing.assert_allclose(found[:, 2], wave(at)[:, 2], atol=1e-14)


def test_samples_are_kept_where_instants_meet_them() -> None:
    time = np.arange(20) / 7
    np.testing.assert_array_equal(interpolate(time, wave(time), time[::-1]), wave(time[::-1]))
    few = time[:3]  # a parabola through three samples
    np.testing.assert_allclose(interpolate(few, few[:, None] ** 2, time)[:, 0], time**2)


def test_signals_meet_on_the_grid_of_the_fastest() -> None:
    slow, fast = np.arange(0.1, 2, 1 / 250), np.arange(0, 1.9, 1 / 1000) + 3e-4
    slow = np.concatenate([slow[:200], slow[199:200], slow[200:]])  # a doubled sample
    signals = [Signal(slow, wave(slow)), Signal(fast, wave(fast))]
    assert fastest(signals) == 1
    at, (low, high) = merge(signals)
    inside = (fast >= slow[0]) & (fast <= slow[-1])
    np.testing.assert_array_equal(at, fast[inside])
    np.testing.assert_array_equal(high, wave(at))
    np.testing.assert_allclose(low, wave(at), atol=1e-4)
    at, (low, high) = merge(signals, onto=0)
    assert set(at) <= set(slow)
    np.testing.assert_array_equal(low, wave(at))
    np.testing.assert_allclose(high, wave(at), atol=1e-9)


def test_a_hole_in_one_signal_is_one_of_all() -> None:
    fast = np.arange(1000) / 1000
    slow = fast[::4]
    slow = slow[(slow < 0.301) | (slow > 0.37)]
    at, _ = merge([Signal(fast, wave(fast)), Signal(slow, wave(slow))])
    np.testing.assert_array_equal(at, np.concatenate([fast[:301], fast[372:997]]))
