"""What is no motion under power of the drives is found, left out, and told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from polars.testing import assert_frame_equal

import deltaid
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.errors import RecordingError
from deltaid.identification.gathering import gather
from deltaid.identification.information import Information, merge
from deltaid.identification.torque_error import torque_error
from deltaid.model.left_out import LeftOut, Span
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import Mask, Weights, kept
from deltaid.recording.masks.runs import joined, rolling, runs_of, without
from deltaid.recording.masks.search import MaskSearch
from deltaid.recording.masks.stale import bridge
from deltaid.recording.memory import Recording as RawRecording
from deltaid.recording.opening import open_log
from deltaid.recording.recording import Recording, open_recordings, with_filter
from deltaid.recording.time.clock import Clock
from deltaid.report.left_out import left_out_table, reversals
from interrupted import Interrupted, cost_of_masks, interrupted, mass_error
from logs import write

CLAVEL, IRB = "clavel-delta3", "irb360-6-1600"


def opened(one: Interrupted, folder: Path, **options: bool) -> Log:
    path = write(folder / "log.parquet", one.frame)
    return open_log(path, one.dynamics.kinematics, **options)


def searched(one: Interrupted, size: int = 1 << 16) -> tuple[Mask, ...]:
    """Masks by rule, without the rest of the survey."""
    search = MaskSearch(one.dynamics.dof, [np.inf] * one.dynamics.dof)
    rows = one.frame.to_numpy()
    for start in range(0, len(rows), size):
        search.add(rows[start : start + size], 1 / one.rate)
    clock = Clock(1 / one.rate, len(rows), 0.0, (len(rows) - 1) / one.rate)
    return search.masks(clock)


def by_hand(log: Log, *spans: tuple[tuple[int, ...], int, int]) -> Log:
    """A log without some drives' rows."""
    masks = (Mask("standing still", drives, a, b, 0.0, 0.0) for drives, a, b in spans)
    return replace(log, masks=tuple(masks), keep_all=True)


# Weights, before the filter


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
        np.testing.assert_array_equal(weights.of(row, count), expected[row : row + count])
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
    one = interrupted(name, rng, rate=rate, seconds=8.0, rests=rests)
    found = searched(one.measured(rng, bits, noise, gear))
    assert [mask.reason for mask in found] == ["standing still"] * 3
    for mask, (_, first, last) in zip(found, one.spans, strict=True):
        # Beyond the rest the motion is still within the encoder's steps.
        assert -0.001 < (first - mask.first) / rate < 0.12
        assert -0.001 < (mask.last - last) / rate < 0.12
        assert (mask.start, mask.end) == pytest.approx((mask.first / rate, mask.last / rate))


@pytest.mark.parametrize("size", [700, 1 << 16])
def test_an_emergency_stop_brakes_and_rest_after_it(size) -> None:
    rng = np.random.default_rng(8)
    one = interrupted(IRB, rng, seconds=8.0, rests=((4.0, 5.3),), ramp=0.12)
    one = one.without_torque("emergency stop", 3.9, 5.0).measured(rng, 17, 0.004, 20)
    found = [mask for mask in searched(one, size) if mask.last > 1]
    assert [mask.reason for mask in found] == ["emergency stop", "on brakes", "standing still"]
    edges = [(mask.start, mask.end) for mask in found]
    np.testing.assert_allclose(edges[0], (3.9, 4.0), atol=0.025)
    np.testing.assert_allclose(edges[1], (4.0, 5.0), atol=0.025)
    np.testing.assert_allclose(edges[2], (5.0, 5.3), atol=0.035)


def test_torque_that_does_not_change_is_off_only_where_it_has_noise() -> None:
    """Frozen on brakes; without noise what holds the robot against gravity does not change."""
    for noise, reason in ((0.0, "standing still"), (0.02, "on brakes")):
        rng = np.random.default_rng(12)
        one = interrupted(CLAVEL, rng, seconds=5.0, rests=((2.0, 3.0),))
        one = one.measured(rng, 18, noise, 10)
        rows = one.rows(2.0, 3.0)
        one.tau[rows] = 0.3 * np.abs(one.tau).max()
        (mask,) = searched(one)
        assert mask.reason == reason


@pytest.mark.parametrize(("step", "rate", "size"), [(5e-4, 1000.0, 700), (5e-4, 200.0, 1 << 16)])
def test_rest_on_a_coarse_encoder(step, rate, size) -> None:
    """Coming to rest is as still as rest for many rows, but goes over several steps."""
    rng = np.random.default_rng(1)
    one = interrupted("par4-linear", rng, rate=rate, seconds=8.0, rests=((-1, 1.2), (3.0, 4.5)))
    one = replace(one, q=step * np.round(one.q / step))
    for mask, (_, first, last) in zip(searched(one, size), one.spans, strict=True):
        assert mask.reason == "standing still"
        assert mask.first <= first + 0.02 * rate
        assert mask.last >= last - 0.02 * rate
        ways = np.ptp(one.q[mask.first : mask.last + 1], axis=0)
        assert ways.max() < 2.5 * step


@pytest.mark.parametrize("slowly", [1.0, 15.0])
@pytest.mark.parametrize(("bits", "steps"), [(12, 0), (16, 1000), (20, 30)])
def test_nothing_is_left_out_of_motion(slowly, bits, steps) -> None:
    """Slow motion and torques in coarse steps are neither rest nor saturation."""
    rng = np.random.default_rng(bits)
    for name in (IRB, "linear-delta"):
        one = interrupted(name, rng, seconds=6.0, slowly=slowly).measured(rng, bits, 0.01)
        if steps:
            step = np.abs(one.tau).max(axis=0) / steps
            one = replace(one, tau=step * np.round(one.tau / step))
        assert not searched(one)


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
    one = interrupted(CLAVEL, rng, seconds=6.0).measured(rng, 17, 0.02, 20)
    low, high = one.tau.min(axis=0), one.tau.max(axis=0)
    tau = one.tau.copy()
    tau[:, 0] = np.clip(tau[:, 0], 0.7 * low[0], 0.5 * high[0])
    tau[:, 2] = np.round(np.clip(tau[:, 2], -np.inf, 0.6 * high[2]), 2)
    found = searched(replace(one, tau=tau))
    assert {mask.reason for mask in found} == {"saturated torque"}
    weights = Weights(found, 3).of(0, len(tau))
    at_end = np.zeros_like(tau, dtype=bool)
    at_end[:, 0] = (tau[:, 0] == tau[:, 0].max()) | (tau[:, 0] == tau[:, 0].min())
    at_end[:, 2] = tau[:, 2] == tau[:, 2].max()
    assert not np.any(weights[at_end])
    # What noise took off the end for a moment goes with it, nothing else.
    between = (weights == 0) & ~at_end
    assert between.sum() < 0.3 * at_end.sum()
    assert not np.any(between[:, 1])


def test_a_limit_of_the_description_needs_less_evidence() -> None:
    rng = np.random.default_rng(6)
    one = interrupted(CLAVEL, rng, seconds=3.0).measured(rng, 17, 0.02, 20)
    limit = np.sort(np.abs(one.tau[:, 1]))[-2]
    tau = one.tau.copy()
    tau[:, 1] = np.clip(tau[:, 1], -limit, limit)
    for limits, count in (([np.inf] * 3, 0), ([np.inf, limit, np.inf], 1)):
        search = MaskSearch(3, limits)
        search.add(replace(one, tau=tau).frame.to_numpy(), 1e-3)
        assert (
            len({mask.reason for mask in search.masks(Clock(1e-3, len(tau), 0.0, 1.0))})
        ) == count


@pytest.mark.parametrize("size", [97, 1 << 16])
def test_stale_rows_are_found_to_the_row(size) -> None:
    rng = np.random.default_rng(7)
    one = interrupted(IRB, rng, seconds=4.0, rests=((-1, 0.5),)).measured(rng, 17, 0.02, 20)
    rows = ((700, 700), (1000, 1002), (1500, 1511), (2000, 2079), (3900, 3999))
    for first, last in rows:
        one = one.stale(first, last)
    found = [m for m in searched(one, size) if m.reason == "stale rows"]
    assert [(mask.first, mask.last) for mask in found] == list(rows)
    assert sum(mask.reason != "stale rows" for mask in searched(one, size)) == 1


def test_stale_rows_are_bridged() -> None:
    t = np.arange(400) / 1000
    q = np.column_stack([np.sin(20 * t), np.cos(15 * t + 1)])
    held = q.copy()
    runs = np.array([[50, 50], [54, 56], [100, 119], [300, 305]])
    for first, last in runs:
        held[first : last + 1] = held[first - 1]
    bridge(held, runs)
    np.testing.assert_allclose(held, q, atol=2e-5)


# Results


@pytest.mark.parametrize("name", [CLAVEL, IRB])
def test_what_is_left_gives_the_robot(name) -> None:
    """With everything at once M is as good as without; as it is taken it is far off."""
    rng = np.random.default_rng(11)
    rests = ((-1.0, 1.0), (4.0, 5.0), (9.0, 11.0))
    one = interrupted(name, rng, seconds=10.0, rests=rests, ramp=0.3)
    one = one.without_torque("on brakes", 4.2, 4.8).clipped(0.7).measured(rng, 17, 0.0, 20)
    tau = one.tau + 0.02 * np.abs(one.tau).max(axis=0) * rng.standard_normal(one.tau.shape)
    limit = 0.95 * np.abs(one.tau).max(axis=0)
    one = replace(one, tau=np.clip(tau, -limit, limit))
    for row in range(1500, 3500, 200):
        one = one.stale(row, row + 3)
    only = deltaid.Settings(friction="described")  # p of the robot that was moved
    found = deltaid.identify(name, one.frame, settings=only)
    taken = deltaid.identify(name, one.frame, settings=only.changed(keep_all=True))
    assert mass_error(one, found.model.p) < 0.03
    assert mass_error(one, taken.model.p) > 0.2
    (source,) = found.model.sources
    reasons = {one.reason for one in source.left_out}
    assert reasons >= {"standing still", "on brakes", "saturated torque", "stale rows", "reversal"}
    assert not taken.model.sources[0].left_out
    standing = next(one for one in source.left_out if one.reason == "standing still")
    assert standing.spans[0].start == 0
    assert standing.share == pytest.approx(0.24, abs=0.05)


def test_clean_recordings_lose_nothing() -> None:
    """Intervals are no wider for what is left out of a clean recording: reversals."""
    costs = [cost_of_masks(CLAVEL, rate, seed) for seed, rate in ((2, 200.0), (3, 1000.0))]
    for cost in costs:
        assert 0 < cost.lost < 0.02
        assert 1 <= cost.known_less.max() < 1.02
    assert np.mean([np.log(cost.widths).mean() for cost in costs]) < 0.02


def test_brakes_set_in_with_a_jump_of_acceleration() -> None:
    """The low-pass feels it a period ahead, and its spectrum is no motion's."""
    rng = np.random.default_rng(2)
    one = interrupted(
        CLAVEL, rng, seconds=8.0, rests=((3.0, 3.8), (6.0, 6.9)), ramp=0.4, braking=0.06
    )
    one = one.measured(rng, 16, 0.01)
    found = deltaid.identify(CLAVEL, one.frame)
    (recording,) = found.recordings
    assert mass_error(one, found.model.p) < 0.006
    stops = [mask for mask in recording.log.masks if mask.reason == "emergency stop"]
    before = [mask for mask in recording.log.masks if mask.reason == "before a stop"]
    for ahead, stop in zip(before, stops, strict=True):
        assert ahead.last == stop.first - 1
        assert stop.start - ahead.start == pytest.approx(1 / recording.motion_cutoff, abs=2e-3)
        assert ahead.end == pytest.approx(stop.start - 1e-3)
    # Found again, not found twice.
    assert with_filter(recording.log, recording.cutoff).log.masks == recording.log.masks
    taken = open_recordings(one.frame, one.dynamics.kinematics, keep_all=True)[0]
    assert taken.motion_cutoff > 2 * recording.motion_cutoff
    late = replace(recording.log, masks=tuple(stops))
    felt = [_error_at(one, Recording(log, recording.low_pass)) for log in (late, recording.log)]
    assert felt[1] < 0.5 * felt[0]


def _error_at(one: Interrupted, recording: Recording) -> float:
    """Torque error of the true robot, at its worst."""
    (window,) = recording.windows(one.dynamics.kinematics)
    drives = np.arange(one.dynamics.dof)

    def error(w) -> np.ndarray:
        return w.weighted((w.tau - one.dynamics.torque(w.z, w.qd, w.qdd, one.truth)).T, drives)

    return float(np.abs(window.filtered(error)).max())


def test_a_direction_that_is_not_known_does_not_count(tmp_path) -> None:
    """Rows in which a drive or the slide turns round are left out; masks see each drive alone."""
    one = interrupted(IRB, np.random.default_rng(4), seconds=4.0)
    recording = with_filter(opened(one, tmp_path))
    (window,) = recording.windows(one.dynamics.kinematics)
    own = window.own
    passive = one.dynamics.kinematics.passive_friction
    slide = passive.rates(own.z, own.qd, own.qdd).speed[:, 0]
    turns = [np.flatnonzero(np.diff(np.sign(x))) for x in (*own.qd.T, slide)]
    out = own.weights == 0
    for i in range(4):
        own_and_slide = np.concatenate([turns[i], turns[4]]) if i < 3 else turns[i]
        for row in own_and_slide:
            assert out[row : row + 2, i].any()
        assert out[:, i].sum() <= 4 * len(own_and_slide)
    assert passive.moved_by.tolist() == [[True, True, True, False]]
    np.testing.assert_array_equal(window.turning, out.sum(axis=0))
    everything = Recording(replace(recording.log, keep_all=True), recording.low_pass)
    (window,) = everything.windows(one.dynamics.kinematics)
    assert np.all(window.own.weights == 1)


def test_passive_joints_move_as_differences_say() -> None:
    dynamics = compiled(deltaid.load_robot("h4"))
    kinematics, h = dynamics.kinematics, 1e-5
    rng = np.random.default_rng(0)
    z = kinematics.home + 0.03 * rng.standard_normal((1, 4))
    zd, zdd = rng.standard_normal((2, 1, 4))
    at = [z + k * h * zd + 0.5 * (k * h) ** 2 * zdd for k in (-1, 0, 1)]
    speeds = [zd + k * h * zdd for k in (-1, 0, 1)]
    motions = [kinematics.drive_motion(a, b, zdd) for a, b in zip(at, speeds, strict=True)]
    passive = kinematics.passive_friction
    rates = [passive.rates(a, m[1], m[2]) for a, m in zip(at, motions, strict=True)]
    for name in passive.names:
        k = passive.names.index(name)
        change = (rates[2].speed[0, k] - rates[0].speed[0, k]) / (2 * h)
        assert rates[1].acceleration[0, k] == pytest.approx(change, rel=1e-5)
        slope = rates[1].slope[0, k] @ motions[1][1][0]
        assert slope == pytest.approx(rates[1].speed[0, k], rel=1e-9)


def test_nothing_left_is_refused(tmp_path) -> None:
    rng = np.random.default_rng(9)
    one = interrupted(CLAVEL, rng, seconds=8.0, rests=((-1, 7.9),)).measured(rng, 17, 0.02, 20)
    with pytest.raises(RecordingError, match=r"left for drive1: .* % standing still") as caught:
        opened(one, tmp_path)
    assert "--keep-all" in str(caught.value)
    assert not opened(one, tmp_path, keep_all=True).masks


def test_table_names_reason_drives_share_and_times() -> None:
    spans = tuple(Span(start=float(k), end=k + 0.25) for k in range(4))
    clipped = LeftOut(
        reason="saturated torque",
        why="the channel ends",
        drives=("drive2", "drive3"),
        share=0.125,
        spans=spans,
        more=7,
    )
    turning = LeftOut(reason="reversal", why="turns", drives=("drive1",), share=0.01)
    table = left_out_table([("a.csv", (clipped, turning))])
    assert table is not None
    first, second = table.rows
    assert first[:3] == ("saturated torque", "2, 3", "12 %")
    assert first[3] == "0.000–0.250, 1.000–1.250, 2.000–2.250 and 8 more"
    assert second == ("reversal", "1", "1 %", "")
    assert left_out_table([("a.csv", (turning,))]) is None
    assert reversals((clipped, turning)) == ", 1 % left out at reversals"
    several = left_out_table([("a.csv", (clipped,)), ("b.csv", (clipped,))])
    assert several is not None
    assert [row[0] for row in several.rows] == ["a.csv", "b.csv"]


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


def test_arrays_in_memory_stay_as_they_are() -> None:
    """Bridges are built in a copy."""
    rng = np.random.default_rng(3)
    one = interrupted(CLAVEL, rng, seconds=2.0).measured(rng, 17, 0.02, 20).stale(900, 903)
    table = one.frame
    before = table.clone()
    time = table["t"].to_numpy()
    raw = RawRecording.from_arrays(t=time, q=one.q, tau=one.tau)
    log = open_log(raw, one.dynamics.kinematics)
    rows = np.concatenate([batch.values for batch in log.batches()])
    assert not np.array_equal(rows[900:904, 1:4], one.q[900:904])
    assert_frame_equal(table, before)
