"""What is no motion under power is found, row by row, and weighs nothing before the filter."""

from dataclasses import replace

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.information import merge
from deltaid.identification.gathering import gather
from deltaid.identification.torque_error import torque_error
from deltaid.recording.masks.masks import (
    Mask,
    joined,
    kept_shares,
    left_out,
    rolling,
    runs_of,
    within,
    without,
)
from deltaid.recording.masks.search import MaskSearch
from deltaid.recording.masks.stuck import Extreme, bridge
from deltaid.recording.recording import with_filter
from interrupted import CLAVEL, IRB, by_hand, interrupted, opened, searched

# Rules


@pytest.mark.parametrize(
    ("name", "rate", "bits", "gear", "noise"),
    [
        (CLAVEL, 1000.0, 12, 1.0, 0.02),
        (IRB, 1000.0, 17, 20.0, 0.02),
        ("h4", 200.0, 18, 1.0, 0.005),
        ("par4-linear", 2000.0, 20, 10.0, 0.05),
    ],
)
def test_standing_still_at_the_ends_and_in_between(name, rate, bits, gear, noise) -> None:
    rng = np.random.default_rng(bits)
    rests = ((-1.0, 1.0), (4.0, 4.8), (7.0, 9.0))
    recording = interrupted(name, rng, rate=rate, seconds=8.0, rests=rests)
    found = searched(recording.measured(rng, bits, noise, gear))
    assert [mask.reason for mask in found] == ["standing still"] * 3
    for mask, (_, first, last) in zip(found, recording.spans, strict=True):
        # Beyond the rest the motion is still within the encoder's steps.
        assert -0.001 < (first - mask.first) / rate < 0.12
        assert -0.001 < (mask.last - last) / rate < 0.12
        assert (mask.start, mask.end) == pytest.approx((mask.first / rate, mask.last / rate))


@pytest.mark.parametrize("size", [700, 1 << 16])
def test_an_emergency_stop_brakes_and_rest_after_it(size) -> None:
    rng = np.random.default_rng(8)
    recording = interrupted(IRB, rng, seconds=8.0, rests=((4.0, 5.3),), ramp=0.12)
    recording = recording.without_torque("emergency stop", 3.9, 5.0).measured(rng, 17, 0.004, 20)
    found = [mask for mask in searched(recording, size) if mask.last > 1]
    assert [mask.reason for mask in found] == ["emergency stop", "on brakes", "standing still"]
    edges = [(mask.start, mask.end) for mask in found]
    np.testing.assert_allclose(edges[0], (3.9, 4.0), atol=0.025)
    np.testing.assert_allclose(edges[1], (4.0, 5.0), atol=0.025)
    np.testing.assert_allclose(edges[2], (5.0, 5.3), atol=0.035)


def test_torque_that_does_not_change_is_off_only_where_it_has_noise() -> None:
    """Frozen on brakes; without noise what holds the robot against gravity does not change."""
    for noise, reason in ((0.0, "standing still"), (0.02, "on brakes")):
        rng = np.random.default_rng(12)
        recording = interrupted(CLAVEL, rng, seconds=5.0, rests=((2.0, 3.0),))
        recording = recording.measured(rng, 18, noise, 10)
        rows = recording.rows(2.0, 3.0)
        recording.tau[rows] = 0.3 * np.abs(recording.tau).max()
        (mask,) = searched(recording)
        assert mask.reason == reason


@pytest.mark.parametrize(("step", "rate", "size"), [(5e-4, 1000.0, 700), (5e-4, 200.0, 1 << 16)])
def test_rest_on_a_coarse_encoder(step, rate, size) -> None:
    """Coming to rest is as still as rest for many rows, but goes over several steps."""
    rng = np.random.default_rng(1)
    recording = interrupted(
        "par4-linear", rng, rate=rate, seconds=8.0, rests=((-1, 1.2), (3.0, 4.5))
    )
    recording = replace(recording, q=step * np.round(recording.q / step))
    for mask, (_, first, last) in zip(searched(recording, size), recording.spans, strict=True):
        assert mask.reason == "standing still"
        assert mask.first <= first + 0.02 * rate
        assert mask.last >= last - 0.02 * rate
        ways = np.ptp(recording.q[mask.first : mask.last + 1], axis=0)
        assert ways.max() < 2.5 * step


@pytest.mark.parametrize("slowly", [1.0, 15.0])
@pytest.mark.parametrize(("bits", "steps"), [(12, 0), (16, 1000), (20, 30)])
def test_nothing_is_excluded_from_motion(slowly, bits, steps) -> None:
    """Slow motion and torques in coarse steps are neither rest nor saturation."""
    rng = np.random.default_rng(bits)
    for name in (IRB, "linear-delta"):
        recording = interrupted(name, rng, seconds=6.0, slowly=slowly).measured(rng, bits, 0.01)
        if steps:
            step = np.abs(recording.tau).max(axis=0) / steps
            recording = replace(recording, tau=step * np.round(recording.tau / step))
        assert not searched(recording)


def test_slow_motion_beside_fast_one_is_no_rest() -> None:
    """A hundredth of the speed for two seconds, with an encoder as coarse as there are."""
    rng = np.random.default_rng(2)
    fast = interrupted(CLAVEL, rng, seconds=4.0)
    slow = interrupted(CLAVEL, np.random.default_rng(2), seconds=4.0, slowly=100.0)
    both = replace(fast, q=np.vstack([fast.q[::-1], slow.q]), tau=np.vstack([fast.tau, slow.tau]))
    for bits, gear in ((13, 1.0), (17, 20.0)):
        assert not searched(both.measured(rng, bits, 0.02, gear))


def test_saturation_is_found_drive_by_drive_and_at_both_ends() -> None:
    rng = np.random.default_rng(5)
    recording = interrupted(CLAVEL, rng, seconds=6.0).measured(rng, 17, 0.02, 20)
    low, high = recording.tau.min(axis=0), recording.tau.max(axis=0)
    tau = recording.tau.copy()
    tau[:, 0] = np.clip(tau[:, 0], 0.7 * low[0], 0.5 * high[0])
    tau[:, 2] = np.round(np.clip(tau[:, 2], -np.inf, 0.6 * high[2]), 2)
    found = searched(replace(recording, tau=tau))
    assert {mask.reason for mask in found} == {"saturated torque"}
    rows = np.arange(len(tau))
    weights = 1.0 - np.stack([within(left_out(found, i), rows) for i in range(3)], axis=1)
    at_end = np.zeros_like(tau, dtype=bool)
    at_end[:, 0] = (tau[:, 0] == tau[:, 0].max()) | (tau[:, 0] == tau[:, 0].min())
    at_end[:, 2] = tau[:, 2] == tau[:, 2].max()
    assert not np.any(weights[at_end])
    # Noise takes a torque off the end for a moment, the same noise with less torque never gets
    # there: what is within 3 ms goes with it, nothing else.
    beside = np.ones(2 * round(3e-3 * recording.rate) + 1)
    for i in range(3):
        expected = np.convolve(at_end[:, i], beside, mode="same") > 0
        assert np.array_equal(weights[:, i] == 0, expected)


@pytest.mark.parametrize("every", [2, 4])
def test_saturation_of_torques_that_are_held_between_updates(every) -> None:
    rng = np.random.default_rng(5)
    recording = interrupted(CLAVEL, rng, seconds=6.0).measured(rng, 17, 0.02, 20)
    held = replace(recording, tau=recording.tau[np.arange(len(recording.tau)) // every * every])
    assert not searched(held)
    end = 0.6 * held.tau[:, 0].max()
    clipped = replace(held, tau=np.minimum(held.tau, [end, np.inf, np.inf]))
    found = searched(clipped)
    assert {(mask.reason, mask.drives) for mask in found} == {("saturated torque", (0,))}
    assert np.all(within(left_out(found, 0), np.flatnonzero(held.tau[:, 0] >= end)))


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("number", [None, 0.0])
@pytest.mark.parametrize("size", [700, 1 << 16])
def test_a_channel_that_freezes_is_excluded(every: int, number: float | None, size: int) -> None:
    """Also one whose torques are held between updates, with runs over several blocks."""
    rng = np.random.default_rng(5)
    recording = interrupted(CLAVEL, rng, seconds=6.0).measured(rng, 17, 0.02, 20)
    tau = recording.tau[np.arange(len(recording.tau)) // every * every]
    tau[1500:3900, 1] = tau[1500, 1] if number is None else number
    masks = searched(replace(recording, tau=tau), size)
    assert [(mask.reason, mask.drives) for mask in masks] == [("frozen torque", (1,))]
    assert (masks[0].first, masks[0].last) == (1500, 3899)


def test_a_torque_that_repeats_for_a_reason_is_not_frozen() -> None:
    """At rest, in steps wider than its noise, without noise, and within what chance does."""
    rng = np.random.default_rng(5)
    recording = interrupted(CLAVEL, rng, seconds=6.0)
    noisy = recording.measured(rng, 17, 0.02, 20)
    step = np.abs(noisy.tau).max() / 20
    torques = [step * np.round(x / step) for x in (noisy.tau, recording.tau)]
    chance = noisy.tau.copy()
    chance[2000:2003, 0] = chance[2000, 0]
    assert not any(searched(replace(noisy, tau=tau)) for tau in (*torques, chance))
    resting, q = noisy.tau.copy(), noisy.q.copy()
    resting[1500:3900, 1], q[1500:3900, 1] = resting[1500, 1], q[1500, 1]
    assert "frozen torque" not in {m.reason for m in searched(replace(noisy, tau=resting, q=q))}


def test_a_limit_of_the_description_needs_less_evidence() -> None:
    rng = np.random.default_rng(6)
    recording = interrupted(CLAVEL, rng, seconds=3.0).measured(rng, 17, 0.02, 20)
    limit = np.sort(np.abs(recording.tau[:, 1]))[-2]
    tau = recording.tau.copy()
    tau[:, 1] = np.clip(tau[:, 1], -limit, limit)
    for limits, count in (([np.inf] * 3, 0), ([np.inf, limit, np.inf], 1)):
        search = MaskSearch(3, limits)
        search.add(replace(recording, tau=tau).frame.to_numpy(), 1e-3)
        assert len({reason for reason, _, _ in search.runs()}) == count


@pytest.mark.parametrize("size", [97, 1 << 16])
def test_stale_rows_are_found_to_the_row(size) -> None:
    rng = np.random.default_rng(7)
    recording = interrupted(IRB, rng, seconds=4.0, rests=((-1, 0.5),)).measured(rng, 17, 0.02, 20)
    rows = ((700, 700), (1000, 1002), (1500, 1511), (2000, 2079), (3900, 3999))
    for first, last in rows:
        recording = recording.stale(first, last)
    found = [m for m in searched(recording, size) if m.reason == "stale rows"]
    assert [(mask.first, mask.last) for mask in found] == list(rows)
    assert sum(mask.reason != "stale rows" for mask in searched(recording, size)) == 1


def test_stale_rows_are_bridged() -> None:
    t = np.arange(400) / 1000
    q = np.column_stack([np.sin(20 * t), np.cos(15 * t + 1)])
    held = q.copy()
    runs = np.array([[50, 50], [54, 56], [100, 119], [300, 305]])
    for first, last in runs:
        held[first : last + 1] = held[first - 1]
    bridge(held, runs)
    np.testing.assert_allclose(held, q, atol=2e-5)


# Runs


def test_runs() -> None:
    flags = np.array([1, 1, 0, 1, 0, 0, 1], dtype=bool)
    runs = runs_of(flags, 10)
    assert runs.tolist() == [[10, 11], [13, 13], [16, 16]]
    assert joined(runs, 1).tolist() == [[10, 13], [16, 16]]
    assert joined(np.array([[0, 9], [2, 3], [10, 12]])).tolist() == [[0, 12]]
    cut = without(np.array([[0, 9], [20, 29]]), np.array([[3, 4], [8, 21], [25, 40]]))
    assert cut.tolist() == [[0, 2], [5, 7], [22, 24]]


@pytest.mark.parametrize(("rows", "length"), [(5, 5), (23, 4), (64, 8), (9, 2)])
def test_rolling(rows, length) -> None:
    x = np.random.default_rng(rows).standard_normal((rows, 2))
    windows = np.lib.stride_tricks.sliding_window_view(x, length, axis=0)
    low, high = rolling(x, length)
    np.testing.assert_array_equal(low, windows.min(axis=2))
    np.testing.assert_array_equal(high, windows.max(axis=2))


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
    spans = [left_out(masks, i) for i in range(2)]
    for row, count in ((0, 50), (12, 5), (19, 3), (31, 9), (30, 11), (40, 1), (41, 9)):
        gone = np.stack([within(runs, np.arange(row, row + count)) for runs in spans], axis=1)
        np.testing.assert_array_equal(1.0 - gone, expected[row : row + count])
    np.testing.assert_allclose(kept_shares(masks, 2, 50), expected.mean(axis=0))


@pytest.mark.parametrize(("rate", "cutoff"), [(1000.0, 30.0), (12000.0, 60.0), (1000.0, None)])
def test_rows_are_weighted_before_the_filter(tmp_path, rate, cutoff) -> None:
    """Against the whole filter as one, over all rows at once; masks differ from drive to drive."""
    simulated = interrupted(
        CLAVEL, np.random.default_rng(1), rate=rate, seconds=2.4 if rate < 8000 else 0.75
    )
    log = opened(simulated, tmp_path, keep_all=True)
    log = by_hand(log, ((0,), 300, 1500), ((1, 2), 1000, 1400), ((2,), 800, 805))
    recording = with_filter(replace(log, motion_cutoff=cutoff or log.motion_cutoff), cutoff)
    assert (recording.filter.stride > 1) == (rate > 8000)
    low_pass = recording.low_pass
    assert low_pass is not None
    windows = list(recording.windows(simulated.dynamics.kinematics))
    (window,) = windows
    wide = window.wide
    values = simulated.dynamics.sparse_regressor(wide.z, wide.qd, wide.qdd).values
    drives, _ = simulated.dynamics.regressor_pattern
    first = round((wide.time[0] - simulated.frame["t"][0]) * rate)
    m = np.ones((len(simulated.q), 3))
    m[300:1501, 0] = m[1000:1401, 1] = m[1000:1401, 2] = m[800:806, 2] = 0
    m = m[first : first + len(wide.time)].T
    h = low_pass.response
    for k in (0, 17, len(values) - 1):
        direct = np.convolve(values[k] * m[drives[k]], h, "valid")[:: recording.filter.thinned]
        got = window.filtered(lambda w: w.weighted(_entries(simulated.dynamics, w), drives))[k]
        count = min(len(got), len(direct))
        assert count > 5
        np.testing.assert_allclose(
            got[:count], direct[:count], rtol=0, atol=1e-9 * np.abs(direct).max()
        )
    worth = [np.convolve(x**2, h**2, "valid")[:: recording.filter.thinned] / (h @ h) for x in m]
    counted = window.counted(recording.filter.thinned)
    np.testing.assert_allclose(counted, np.array(worth)[:, : counted.shape[1]], atol=1e-12)
    information = merge(gather(simulated.dynamics, recording))
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
    left = kept_shares(recording.log.masks, 3, log.samples)
    assert left.min() < 0.5
    assert np.ptp(left) > 0.1
    expected = sigma * recording.low_pass.noise_gain
    information = merge(gather(clean.dynamics, recording))
    np.testing.assert_allclose(information.rms(clean.truth), expected, rtol=0.15)
    error = torque_error(clean.dynamics, clean.truth, recording)
    np.testing.assert_allclose(error.rms, expected, rtol=0.15)
    np.testing.assert_allclose(error.rms_unfiltered, sigma, rtol=0.05)
    together = np.mean((information.rms(clean.truth) / expected) ** 2)
    np.testing.assert_allclose(together, 1.0, atol=0.15)


@pytest.mark.parametrize(
    ("torques", "other", "is_placeholder"),
    [
        ([9999.0] * 4, 3.0, True),
        ([9999.0] * 3, 3.0, False),  # outliers
        ([9999.0] * 4, -2000.0, False),
        ([29.0] * 4, 3.0, False),  # the end of a channel
        ([1.0] * 4, -0.0, False),  # a channel of two numbers, without the torques of `usual`
    ],
)
def test_a_number_far_beyond_all_others_is_none(
    torques: list[float], other: float, is_placeholder: bool
) -> None:
    usual = np.zeros(20) if torques[0] == 1 else np.linspace(-3, 3, 20)
    values = np.concatenate([usual, torques])
    top = Extreme()
    top.add(values, np.ones(len(values), dtype=bool), 0)
    assert top.is_placeholder(other) == is_placeholder
    assert top.first_row == 20
