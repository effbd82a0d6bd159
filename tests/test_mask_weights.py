"""Rows that masks leave out weigh nothing before the filter, and noise is judged without them."""

from dataclasses import replace

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.information import Information, merge
from deltaid.identification.gathering import gather
from deltaid.identification.torque_error import torque_error
from deltaid.recording.masks.masks import Mask, Weights, kept
from deltaid.recording.recording import with_filter
from interrupted import interrupted
from masked import CLAVEL, by_hand, opened


def test_weights_of_any_rows() -> None:
    masks = [
        Mask("on brakes", (0, 1), 10, 19, 0.0, 0.0),
        Mask("stale rows", (1,), 15, 30, 0.0, 0.0),
        Mask("stale rows", (1,), 16, 17, 0.0, 0.0),
        Mask("saturated torque", (1,), 40, 40, 0.0, 0.0),
    ]
    expected = np.ones((50, 2))
    expected[10:20] = 0
    expected[10:31, 1] = expected[40, 1] = 0
    weights = Weights(masks, 2)
    for row, count in ((0, 50), (12, 5), (19, 3), (31, 9), (30, 11), (40, 1), (41, 9)):
        np.testing.assert_array_equal(weights.of_rows(row, count), expected[row : row + count])
    np.testing.assert_allclose(kept(masks, 2, 50), expected.mean(axis=0))


@pytest.mark.parametrize(("rate", "cutoff"), [(1000.0, 30.0), (12000.0, 60.0), (1000.0, None)])
def test_rows_are_weighted_before_the_filter(tmp_path, rate, cutoff) -> None:
    """Against the whole filter as one, over all rows at once; masks differ from drive to drive."""
    one = interrupted(
        CLAVEL, np.random.default_rng(1), rate=rate, seconds=2.4 if rate < 8000 else 0.75
    )
    log = opened(one, tmp_path, keep_all=True)
    log = by_hand(log, ((0,), 300, 1500), ((1, 2), 1000, 1400), ((2,), 800, 805))
    recording = with_filter(replace(log, motion_cutoff=cutoff or log.motion_cutoff), cutoff)
    assert (recording.stride > 1) == (rate > 8000)
    low_pass = recording.low_pass
    assert low_pass is not None
    windows = list(recording.windows(one.dynamics.kinematics))
    (window,) = windows
    wide = window.wide
    values = one.dynamics.sparse_regressor(wide.z, wide.qd, wide.qdd).values
    drives, _ = one.dynamics.regressor_pattern
    first = round((wide.time[0] - one.frame["t"][0]) * rate)
    m = np.ones((len(one.q), 3))
    m[300:1501, 0] = m[1000:1401, 1] = m[1000:1401, 2] = m[800:806, 2] = 0
    m = m[first : first + len(wide.time)].T
    h = low_pass.response
    for k in (0, 17, len(values) - 1):
        direct = np.convolve(values[k] * m[drives[k]], h, "valid")[:: recording.thinned]
        got = window.filtered(lambda w: w.weighted(_entries(one.dynamics, w), drives))[k]
        count = min(len(got), len(direct))
        assert count > 5
        np.testing.assert_allclose(
            got[:count], direct[:count], rtol=0, atol=1e-9 * np.abs(direct).max()
        )
    worth = [np.convolve(x**2, h**2, "valid")[:: recording.thinned] / (h @ h) for x in m]
    counted = window.counted(recording.thinned)
    np.testing.assert_allclose(counted, np.array(worth)[:, : counted.shape[1]], atol=1e-12)
    information = merge(gather(one.dynamics, recording))
    np.testing.assert_allclose(information.samples, counted.sum(axis=1))


def _entries(dynamics: Dynamics, samples) -> np.ndarray:
    return dynamics.sparse_regressor(samples.z, samples.qd, samples.qdd).values


def test_noise_is_judged_rightly_under_masks(tmp_path) -> None:
    """Monte Carlo: σ̂ of the filtered noise does not depend on how much is left out where."""
    rng = np.random.default_rng(3)
    clean = interrupted(CLAVEL, rng, rate=500.0, seconds=40.0)
    noisy = clean.measured(rng, 20, 0.02, 20)
    sigma = 0.02 * np.abs(clean.tau).max(axis=0)
    log = opened(noisy, tmp_path, keep_all=True)
    at = np.sort(rng.integers(0, len(noisy.q), 800)).reshape(-1, 2)
    spans = [((int(k % 3), 1), int(a), int(min(b, a + 40 + k))) for k, (a, b) in enumerate(at)]
    recording = with_filter(by_hand(log, *spans), 20.0)
    assert recording.low_pass is not None
    left = kept(recording.log.masks, 3, log.samples)
    assert left.min() < 0.5
    assert np.ptp(left) > 0.1
    expected = sigma * recording.low_pass.noise_gain
    information = merge(gather(clean.dynamics, recording))
    np.testing.assert_allclose(information.rms(clean.truth), expected, rtol=0.15)
    error = torque_error(clean.dynamics, clean.truth, recording)
    np.testing.assert_allclose(error.rms, expected, rtol=0.15)
    np.testing.assert_allclose(error.rms_unfiltered, sigma, rtol=0.05)
    together = [_chi_squared(information, clean.truth, expected)]
    np.testing.assert_allclose(together, 1.0, atol=0.15)


def _chi_squared(information: Information, p: np.ndarray, sigma: np.ndarray) -> float:
    return float(np.mean((information.rms(p) / sigma) ** 2))
