"""Jitter, lost and doubled rows, gaps, uneven sampling: places right to the row, fits unharmed."""

from functools import cache

import numpy as np
import polars as pl
import pytest

import deltaid
from clocks import Rows
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.recording.log import Log
from deltaid.recording.opening import open_log
from deltaid.recording.recording import PreparedRecording, with_filter
from deltaid.recording.resolution import resolve_columns
from deltaid.recording.time.clock import Clock
from deltaid.recording.time.signals import longest_hole, segments
from deltaid.recording.time.study import study


@cache
def even(rate: float, duration: float = 6.0) -> Rows:
    """A recording of the three-drive robot: encoder steps, torque noise."""
    dynamics, rng = compiled(deltaid.load_robot("clavel-delta3")), np.random.default_rng(8)
    motion = random_motion(dynamics.kinematics, rng, period=4.0)
    p = surrogate_parameters(dynamics.robot, rng)
    noise = SensorNoise(torque=0.02, encoder_step=2 * np.pi / 2**20)
    made = simulate_recording(dynamics, p, motion, rng, duration=duration, rate=rate, noise=noise)
    return Rows.whole(made)


def clock_of(rows: Rows) -> Clock:
    """What a study finds."""
    return study(iter([rows.log.to_numpy()]), 3)


def opened(rows: Rows, clavel: Dynamics) -> Log:
    return open_log(deltaid.Recording.from_table(rows.log), clavel.kinematics)


def holes_of(clock: Clock) -> dict[int, int]:
    return dict(zip(clock.holes.tolist(), clock.lost.tolist(), strict=True))


@pytest.mark.parametrize("rate", [125.0, 1000.0, 20_000.0])
@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.3, 0.4])
@pytest.mark.parametrize("share", [1e-4, 1e-3, 0.03])
def test_places_are_right_to_the_row(rate: float, jitter: float, share: float) -> None:
    rng = np.random.default_rng(int(100 * jitter + 1e5 * share))
    whole = even(rate, 4000 / rate)
    rows = whole.gap(1500 / rate, 87 / rate).losing(share, rng).jittering(jitter, rng)
    clock = clock_of(rows)
    missed = rows.holes.items() ^ holes_of(clock).items()
    # Where many rows are lost, two stamps may leave open between which rows one is missing.
    assert len(missed) <= (6 if jitter > 0.35 and share > 0.01 else 0), missed
    assert clock.lost.sum() == sum(rows.holes.values())
    assert clock.rate == pytest.approx(rate, rel=1e-4 if jitter else 1e-9)
    assert clock.jitter * rate == pytest.approx(jitter / np.sqrt(3), rel=0.1, abs=1e-6)
    assert clock.even or not jitter
    assert not clock.extra.size


def test_doubled_rows_are_counted() -> None:
    rng = np.random.default_rng(3)
    for jitter in (0.0, 0.3):
        rows = even(1000.0).losing(2e-3, rng).jittering(jitter, rng)
        twice = rows.doubling(25, rng)
        clock = clock_of(twice)
        again = np.flatnonzero(np.diff(twice.at) == 0) + 1
        np.testing.assert_array_equal(clock.extra, again)
        assert clock.doubled == 25
        assert clock.lost.sum() == sum(rows.holes.values())


def test_rows_too_many_are_excluded_however_they_are_stamped() -> None:
    """A logger that writes a row again gives it a time of its own."""
    rng = np.random.default_rng(12)
    rows = even(1000.0).losing(1e-3, rng)
    clock = clock_of(rows.doubling(15, rng).jittering(0.3, rng))
    assert len(clock.extra) == 15
    assert clock.doubled >= 13
    assert clock.lost.sum() == sum(rows.holes.values())


def test_rows_out_of_order_are_excluded() -> None:
    rows = even(1000.0)
    at = rows.at.copy()
    at[[800, 801]] = at[[801, 800]]
    clock = clock_of(Rows(rows.frame, at, rows.time[at]))
    assert clock.extra.tolist() == [801]
    assert holes_of(clock) == {800: 1}
    assert clock.doubled == 0


def test_late_stamps_are_no_gap() -> None:
    """A logger that stalls stamps some rows late, and catches up."""
    rows = even(1000.0)
    time = rows.time.copy()
    for first in (700, 2500, 5000):
        time[first : first + 40] = np.maximum(time[first : first + 40], time[first] + 0.017)
    clock = clock_of(Rows(rows.frame, rows.at, time + 1e-9 * rows.at))
    assert not clock.holes.size
    assert not clock.extra.size


def test_time_that_starts_again_begins_a_segment(clavel: Dynamics) -> None:
    rows = even(1000.0)
    time = np.where(rows.at < 3000, rows.time, rows.time - 3.0)
    log = opened(Rows(rows.frame, rows.at, time), clavel)
    assert holes_of(log.clock) == {3000: -1}
    (warning,) = with_filter(log).log.warnings
    assert warning.startswith("time starts again in 1 place, the first in row 3001: a new segment")


@pytest.mark.parametrize("rate", [2000.0, 4000.0, 7300.0])
def test_rounded_stamps_are_even(rate: float, clavel: Dynamics) -> None:
    rows = even(rate, 2.0).rounded(1e-3)
    log = opened(rows, clavel)
    assert not log.clock.holes.size
    assert not log.clock.extra.size
    assert log.clock.even
    assert log.rate == pytest.approx(rate, rel=1e-4)
    values = np.vstack([block for segment in log.segments(30.0) for block in segment])
    np.testing.assert_array_equal(values[:, 1:7], rows.frame.to_numpy()[:, 1:7])
    np.testing.assert_allclose(np.diff(values[:, 0]), 1 / rate, rtol=1e-4)


@pytest.mark.parametrize("start", [10_000.0, 20_000.0])
@pytest.mark.parametrize("gap", [0.0, 0.05])
def test_seconds_of_single_precision_are_even_after_hours(start: float, gap: float) -> None:
    """Their steps are about as long as one or two periods: no row is lost every 42 rows."""
    rows = even(1000.0).gap(3.0, gap)
    time = (rows.log["t"].to_numpy() + start).astype(np.float32).astype(float)
    clock = study(iter([rows.log.with_columns(t=pl.Series(time)).to_numpy()]), 3)
    assert clock.rate == pytest.approx(1000.0, rel=2e-4)
    np.testing.assert_allclose(clock.lost, [*rows.holes.values()], atol=1)


@pytest.mark.parametrize(("rate", "step"), [(2000.0, 1e-3), (2700.0, 1e-3), (1000.0, 15.6e-3)])
def test_positions_know_where_rows_are_missing(rate: float, step: float) -> None:
    """Several rows share a stamp, whose clock drifts: stamps alone see a row too much or too few
    now and then, and not which one."""
    rng = np.random.default_rng(2)
    rows = even(rate, 4.0)
    rows = rows.without(np.arange(200, 3600, 300) + rng.integers(0, 150, 12))
    rows = Rows(rows.frame, rows.at, rows.time * (1 + 4e-5)).rounded(step)
    assert holes_of(clock_of(rows)) == rows.holes


def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    rows = even(1000.0).gap(2.0, 0.05).losing(5e-3, rng).jittering(0.3, rng).doubling(9, rng)
    whole = clock_of(rows)
    monkeypatch.setattr("deltaid.recording.time.study.BATCH_ROWS", 1500)
    monkeypatch.setattr("deltaid.recording.time.study._EDGE", 300)
    parts = study(iter(np.array_split(rows.log.to_numpy(), 17)), 3)
    for name in ("holes", "lost", "since", "until", "extra"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    assert (parts.rows, parts.doubled, parts.even) == (whole.rows, whole.doubled, whole.even)
    assert parts.period == pytest.approx(whole.period, rel=1e-5)


def test_holes_are_bridged_and_gaps_cut() -> None:
    """Samples of each segment lie on the grid; bridged ones are the motion and weigh nothing."""
    rng = np.random.default_rng(5)
    whole = even(1000.0)
    rows = whole.gap(2.0, 0.05).gap(4.0, 0.005).losing(0.01, rng).doubling(20, rng)
    clock, longest = clock_of(rows), longest_hole(1000.0, 30.0)
    assert longest == 7
    log = np.hstack([rows.log.to_numpy(), np.ones((len(rows.at), 3))])
    table = deltaid.Recording.from_table(rows.log).table
    columns = resolve_columns(table, (False,) * 3)
    for cuts in (1, 13):
        rows_of = segments(np.array_split(log, cuts), clock, longest, columns)
        parts = [np.vstack(list(segment)) for segment in rows_of]
        assert [len(part) for part in parts] == clock.segments(longest).tolist() == [2001, 3950]
        for start, part in zip((0, 2050), parts, strict=True):
            truth = whole.frame.to_numpy()[start : start + len(part)]
            recorded = np.isin(np.arange(start, start + len(part)), rows.at)
            np.testing.assert_array_equal(part[recorded, 1:7], truth[recorded, 1:])
            np.testing.assert_allclose(part[:, 1:4], truth[:, 1:4], rtol=0, atol=3e-5)
            np.testing.assert_allclose(part[:, 0], truth[:, 0], rtol=0, atol=1e-9)
            np.testing.assert_array_equal(part[:, 7:], np.repeat(recorded[:, None], 3, axis=1))


def test_no_window_holds_rows_of_both_sides_of_a_gap(clavel: Dynamics) -> None:
    """Each window's samples are evenly spaced, and windows follow one another in the blocks."""
    rng = np.random.default_rng(6)
    whole = even(2000.0)
    for trial in range(3):
        rows = whole
        for start in rng.uniform(0.2, 5.7, 5):
            rows = rows.gap(start, float(rng.uniform(0.015, 0.4)))
        recording = with_filter(opened(rows, clavel), float(rng.uniform(20, 100)))
        edges = np.flatnonzero(np.diff(rows.at) > 1)
        before, after = rows.time[edges], rows.time[edges + 1]
        start = 0
        for window in recording.windows(clavel.kinematics):
            time = window.wide.time
            np.testing.assert_allclose(np.diff(time), 1 / 2000, rtol=0, atol=1e-9)
            assert not ((time[0] < before) & (time[-1] > after)).any(), trial
            assert window.start >= start
            assert window.start % recording.filter.thinned == 0
            start = window.start + len(window.inner.time)


def test_stretches_that_are_too_short_are_reported(clavel: Dynamics) -> None:
    rows = even(1000.0).gap(2.0, 0.1).gap(2.15, 0.1)
    warnings = with_filter(opened(rows, clavel), 30.0).log.warnings
    assert "2 gaps of up to 100 ms (2 to 2.1 s, 2.15 to 2.25 s): no filter" in warnings[0]
    assert "1 of 3 stretches between gaps are shorter than the 429 samples" in warnings[1]
    assert "and excluded: 0.88 % of the recording; likeliest cause: gaps follow" in warnings[1]


def test_what_was_done_is_reported_in_numbers(clavel: Dynamics) -> None:
    rng = np.random.default_rng(13)
    rows = even(1000.0).gap(2.0, 0.1).gap(2.15, 0.1).gap(4.0, 0.004).doubling(7, rng)
    log = opened(rows, clavel)
    report = with_filter(log, 30.0).clock
    gaps = np.array([[2.0, 2.1], [2.15, 2.25]])
    np.testing.assert_allclose(report.gaps, gaps, rtol=0, atol=1e-9)
    assert (report.doubled, report.out_of_place, report.bridged) == (7, 0, 3)
    assert (report.segments, report.restarts, report.steady, report.even) == (2, 0, False, True)
    assert report.too_short == pytest.approx(51 / 5802)
    assert report.rate_hz == pytest.approx(1000)
    assert report.jitter_s == pytest.approx(0, abs=1e-9)
    assert with_filter(opened(even(1000.0), clavel)).clock.steady


def test_uneven_samples_are_interpolated(clavel: Dynamics) -> None:
    """Positions follow the stamps: the same motion, taken at uneven times."""
    rng, fine = np.random.default_rng(7), even(20_000.0)
    at = 20 * np.arange(5999) + rng.integers(-8, 9, 5999) + 8  # by up to 40 % of 1 ms
    rows = Rows(fine.frame, at, fine.time[at]).gap(3.0, 0.08)
    log = opened(rows, clavel)
    assert log.clock.even is False
    assert log.rate == pytest.approx(1000, rel=1e-3)
    assert list(holes_of(log.clock).values()) in ([79], [80])
    assert log.warnings[0].startswith("samples were taken at uneven times, off by 0.2")
    parts = [np.vstack(list(segment)) for segment in log.segments(30.0)]
    assert len(parts) == 2
    for part in parts:
        truth = np.column_stack(
            [np.interp(part[:, 0], fine.time, fine.frame[f"q{i}"]) for i in (1, 2, 3)]
        )
        np.testing.assert_allclose(part[:, 1:4], truth, rtol=0, atol=4e-5)
        np.testing.assert_array_equal(part[:, 7:], 1.0)


def test_standing_does_not_decide() -> None:
    frame = pl.DataFrame({"t": np.arange(500) / 1000, "q1": 0.5, "q2": 0.1, "q3": 0.2})
    rows = Rows.whole(frame.with_columns(tau1=pl.Series(np.random.default_rng(1).normal(size=500))))
    clock = clock_of(rows.jittering(0.3, np.random.default_rng(2)))
    assert clock.even is None
    assert not clock.holes.size


DAMAGED = {
    "jitter": lambda rows, rng: rows.jittering(0.4, rng),
    "lost": lambda rows, rng: rows.losing(0.03, rng),
    "gaps": lambda rows, rng: rows.gap(1.5, 0.3).gap(3.2, 0.02).gap(4.4, 0.005),
    "all": lambda rows, rng: (
        rows.gap(2.5, 0.05).losing(1e-3, rng).doubling(6, rng).jittering(0.3, rng)
    ),
}


@cache
def fitted(name: str) -> tuple[np.ndarray, np.ndarray]:
    """M at home and friction, by a recording damaged in one way."""
    robot = deltaid.load_robot("clavel-delta3")
    rows = even(1000.0)
    if name:
        rows = DAMAGED[name](rows, np.random.default_rng(9))
    model = deltaid.identify(robot, deltaid.Recording.from_table(rows.log)).model
    dynamics = compiled(robot)
    q = dynamics.kinematics.inverse(dynamics.kinematics.home[None])
    friction = model.p[np.r_[dynamics.layout.viscous, dynamics.layout.coulomb]]
    return dynamics.terms(q, 0 * q, model.p).M[0], friction


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n == "all" else pytest.mark.slow) for n in DAMAGED]
)
def test_fits_stay_at_the_level_of_the_whole_recording(name: str) -> None:
    (M, friction), (M_whole, friction_whole) = fitted(name), fitted("")
    assert np.abs(M - M_whole).max() < 2e-3 * np.abs(M_whole).max()
    np.testing.assert_allclose(friction, friction_whole, rtol=0.015)


def test_a_whole_recording_takes_no_notice(clavel: Dynamics) -> None:
    """Rows of an unbroken log come as they are, to the last bit."""
    rows = even(1000.0)
    log = opened(rows, clavel)
    assert log.clock.steady
    recording: PreparedRecording = with_filter(log)
    assert not recording.log.warnings
    assert recording.log.laid.steady
    ((values,),) = [list(segment) for segment in recording.log.segments(30.0)]
    np.testing.assert_array_equal(values[:, :7], rows.frame.to_numpy())
