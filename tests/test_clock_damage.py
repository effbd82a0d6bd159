"""A damaged time column: right segments or one message, never a traceback, never long."""

import time
import warnings
from typing import NamedTuple

import numpy as np
import polars as pl
import pytest

import deltaid
from damaged_times import DAMAGE, damaged
from deltaid.checks.wiring.wiring import checked_wiring
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import RecordingError
from deltaid.recording.log import Log
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.recording.time.study import study
from test_clocks import even
from wired import bad, evidence_of, recorded

# A step of the number that stands for a row, in the column of the first torque.
_MARK = 1e-3


def opened(whole: pl.DataFrame, stamps: np.ndarray, at: np.ndarray, clavel: Dynamics) -> Log:
    """A recording whose first torque tells which row of the whole one each row is."""
    frame = whole[at].with_columns(t=pl.Series(stamps), tau1=pl.Series(_MARK * at))
    return open_log(deltaid.Recording.from_table(frame), clavel.kinematics)


class Judged(NamedTuple):
    """What opening came to: 'refused', 'uneven' or 'read'; rows left, and how many of them are not
    as far from the one before as they were."""

    end: str
    message: str = ""
    left: int = 0
    wrong: int = 0


def judged(whole: pl.DataFrame, stamps: np.ndarray, at: np.ndarray, clavel: Dynamics) -> Judged:
    rate = 1 / float(whole["t"][1] - whole["t"][0])
    try:
        log = with_filter(opened(whole, stamps, at, clavel), rate / 50).log
    except RecordingError as error:
        return Judged("refused", str(error))
    left = wrong = 0
    for segment in log.segments(rate / 50):
        rows = np.concatenate(list(segment))
        there = np.flatnonzero(rows[:, -1] > 0)
        marks = np.round(rows[there, 4] / _MARK)
        wrong += int(np.count_nonzero(np.diff(marks) != np.diff(there)))
        left += len(there)
    return Judged("uneven" if log.clock.even is False else "read", "", left, wrong)


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_times_give_right_segments_or_one_message(kind: str, clavel: Dynamics) -> None:
    """What damage to stamps alone leaves is in its place; swapped rows that noise hides are not."""
    ends: set[str] = set()
    for seed in range(6):
        rng = np.random.default_rng(seed)
        rate = float(rng.choice([125, 1000, 4000]))
        whole = even(rate, 12_000 / rate).frame[: int(10 ** rng.uniform(3.2, 4.0))]
        begun = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            found = judged(whole, *damaged([kind], whole["t"].to_numpy(), rng), clavel)
        assert time.process_time() - begun < 2
        assert found.end != "refused" or "→" in found.message
        ends.add(found.end)
        if found.end == "read":
            assert found.wrong <= max(6, 0.003 * len(whole)), seed
    assert ends - {"refused"}


def test_wild_stamps_are_excluded_and_reported(clavel: Dynamics) -> None:
    """A huge one, a tiny one, one before the recording: the rows about them stay where they are."""
    whole = even(1000.0).frame[:1500]
    stamps = whole["t"].to_numpy().copy()
    stamps[[30, 400, 900]] = [2031.616, 7.5e-320, -1e9]
    log = opened(whole, stamps, np.arange(1500), clavel)
    assert log.clock.wild == 3
    assert dict(zip(log.clock.holes.tolist(), log.clock.lost.tolist(), strict=True)) == {
        31: 1, 401: 1, 901: 1,
    }  # fmt: skip
    assert log.rate == pytest.approx(1000)
    assert log.clock.jitter < 1e-9
    message = "t of 3 rows are far off the stamps before and after, the first in row 31: excluded; "
    assert log.warnings[0].startswith(message)
    assert with_filter(log, 30.0).clock.segments == 1
    assert with_filter(log, 30.0).clock.out_of_place == 0


def test_wild_stamps_leave_uneven_samples_their_own(clavel: Dynamics) -> None:
    """Where positions follow the stamps, one that is far off takes no row after it along."""
    rng, fine = np.random.default_rng(7), even(20_000.0)
    at = 20 * np.arange(4000) + rng.integers(-8, 9, 4000) + 8
    stamps = fine.time[at].copy()
    stamps[[700, 2500]] = [3e4, -2.0]
    log = opened(fine.frame, stamps, at, clavel)
    assert log.clock.even is False
    assert log.clock.extra.tolist() == [700, 2500]
    assert log.clock.wild == 2
    (segment,) = [np.concatenate(list(segment)) for segment in log.segments(30.0)]
    marks = np.interp(segment[:, 0], fine.time[at], _MARK * at)
    np.testing.assert_allclose(segment[:, 4], marks, atol=30 * _MARK)


def test_uneven_samples_may_start_again() -> None:
    rng = np.random.default_rng(7)
    stamps = np.cumsum(1e-3 * rng.uniform(0.3, 1.7, 4000))
    stamps[2500:] -= 1.0
    values = np.column_stack([stamps, np.sin(5 * np.cumsum(np.diff(stamps, prepend=0.0)))])
    values[2500:, 1] = np.sin(5 * stamps[2500:])
    clock = study(iter([values]), 1)
    assert clock.even is False
    assert clock.lost[clock.holes == 2500].tolist() == [-1]
    assert not clock.extra.size


def test_zeroed_stamps_are_no_rows_of_their_own(clavel: Dynamics) -> None:
    whole = even(1000.0).frame[:1500]
    stamps = whole["t"].to_numpy().copy()
    stamps[239:304] = 0.0
    stamps[239] = 7.5e-320
    log = opened(whole, stamps, np.arange(1500), clavel)
    sizes = log.clock.segments(7)
    assert sizes.max() == 1500 - 304
    assert sizes.sum() >= 1500 - 65


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_column_that_jumps_about_is_no_time(share: float, clavel: Dynamics) -> None:
    rng = np.random.default_rng(4)
    whole = even(1000.0).frame[:3000]
    stamps = whole["t"].to_numpy().copy()
    rows = rng.choice(np.arange(1, 3000), int(share * 3000), replace=False)
    stamps[rows] = rng.uniform(50, 100, len(rows)) if share < 0.5 else rng.uniform(0, 3, len(rows))
    with pytest.raises(RecordingError, match="it is no time") as caught:
        opened(whole, stamps, np.arange(3000), clavel)
    assert "give the sampling rate in its place" in str(caught.value)


def test_a_block_of_wild_stamps_names_its_row(clavel: Dynamics) -> None:
    """Few steps go back, yet many stamps are wild."""
    whole = even(1000.0).frame[:1000]
    stamps = whole["t"].to_numpy().copy()
    for start in range(100, 1000, 150):
        stamps[start : start + 50] += 1e4
    with pytest.raises(RecordingError, match=r"row 101: column t jumps about: 300 of 1000 stamps"):
        opened(whole, stamps, np.arange(1000), clavel)


def test_time_that_hardly_runs_is_refused(clavel: Dynamics) -> None:
    whole = even(1000.0).frame[:4000]
    seconds, once = np.floor(whole["t"].to_numpy()), np.zeros(4000)
    once[200] = 7.5e-320
    for stamps, steps in ((seconds, 3), (once, 1)):
        message = f"column t changes in only {steps} of 4000 rows, too few"
        with pytest.raises(RecordingError, match=message):
            opened(whole, stamps, np.arange(4000), clavel)
    with pytest.raises(RecordingError, match=r"a sampling rate of .* Hz; at most"):
        opened(whole, 1e-310 * np.arange(4000) ** 1.1, np.arange(4000), clavel)


def test_stamps_that_hardly_step_take_no_longer(clavel: Dynamics) -> None:
    """A hundred rows share a stamp: medians are as wide as the recording."""
    whole = even(4000.0).frame[:20_000]
    stamps = np.floor(whole["t"].to_numpy() / 0.15) * 0.15
    begun = time.process_time()
    log = opened(whole, stamps, np.arange(20_000), clavel)
    assert time.process_time() - begun < 2
    assert log.rate == pytest.approx(4000, rel=0.01)


def test_places_of_holes_cost_no_more_than_rows() -> None:
    """A few stamps far off widen no search for holes; nor does jitter of a hundred rows."""
    rng, rows = np.random.default_rng(2), 20_000
    stamps = np.floor(np.arange(rows) / 4000 / 0.05) * 0.05 + 1e-3 * rng.random(rows)
    stamps[rng.choice(rows, 300, replace=False)] += 0.08 * rng.standard_normal(300)
    values = np.column_stack([stamps, np.sin(np.arange(rows) / 500)])
    begun = time.process_time()
    study(iter([values]), 1)
    assert time.process_time() - begun < 2


def test_long_stale_stretches_are_gaps(clavel: Dynamics) -> None:
    """Nobody knows the motion of a tenth of a second; a few rows are bridged."""
    whole = even(1000.0).frame
    values = whole.to_numpy().copy()
    for first, last in ((1000, 1005), (2000, 2199), (5800, 5999)):
        values[first : last + 1, 1:] = values[first - 1, 1:]
    frame = pl.DataFrame(values, schema=whole.schema)
    log = open_log(deltaid.Recording.from_table(frame), clavel.kinematics)
    assert log.clock.steady
    recording = with_filter(log, 30.0)
    assert "1 gap of up to 201 ms (1.999 to 2.2 s)" in recording.log.warnings[-1]
    assert recording.clock.gaps == (pytest.approx((1.999, 2.2)),)
    assert recording.clock.out_of_place == 0
    first, second = (np.concatenate(list(segment)) for segment in log.segments(30.0))
    np.testing.assert_allclose(first[:, 1:4], whole.to_numpy()[:2000, 1:4], atol=3e-5)
    np.testing.assert_array_equal(second[:, 1:4], whole.to_numpy()[2200:5800, 1:4])
    np.testing.assert_allclose(second[:, 0], whole["t"][2200:5800], atol=1e-9)
    kept = open_log(deltaid.Recording.from_table(frame), clavel.kinematics, keep_all=True)
    assert kept.laid.steady


def test_stale_rows_beside_holes_are_one_hole() -> None:
    """Rows are lost in a stale stretch, and the row after it is there twice."""
    rng = np.random.default_rng(3)
    rows = even(1000.0).without(np.array([50, 700, 701, 900])).doubling(0, rng)
    clock = study(iter([rows.log.to_numpy()]), 3)
    assert clock.lost.tolist() == [1, 2, 1]
    cut = clock.without(np.array([[600, 750]]))
    assert cut.holes.tolist() == [50, 751, 897]
    assert cut.lost.tolist() == [1, 153, 1]
    assert cut.since[1] == pytest.approx(0.600)
    assert cut.until[1] == pytest.approx(0.754)
    assert cut.segments(7).tolist() == [601, 6000 - 754]


def test_masks_are_timed_by_holes() -> None:
    """Rounded stamps jump from row to row; only holes are kept to tell the time of a row by."""
    rows = even(2700.0, 4.0).gap(1.0, 0.5).rounded(1e-3)
    clock = study(iter([rows.log.to_numpy()]), 3)
    assert len(clock.holes) == 1
    at = np.array([0, 2000, len(rows.at) - 1, *(clock.holes - 1), *clock.holes])
    np.testing.assert_allclose(clock.stamps(at), rows.time[at], rtol=0, atol=1.1e-3)


@pytest.mark.parametrize("back", [0.1, 1.0, 3.0])
def test_a_clock_that_is_set_back_is_no_fault_of_columns(back: float) -> None:
    """Rows of the same seconds before and after are two stretches, not one that leaps."""
    columns = recorded("clavel-delta3")
    half = np.arange(len(columns["t"])) >= len(columns["t"]) // 2
    assert not bad(
        checked_wiring(evidence_of("clavel-delta3", columns | {"t": columns["t"] - back * half}))
    )


@pytest.mark.parametrize("rows", [3000, 30_000, 140_000])
@pytest.mark.parametrize("filled", ["zeros", "last row", "motion"])
def test_rows_in_which_time_stands_count_for_no_rate(
    filled: str, rows: int, clavel: Dynamics
) -> None:
    """An array longer than its recording, or a clock that hangs: such rows shortened the period."""
    whole = even(1000.0, 4.0).frame
    assert len(whole) == 4000
    time = whole["t"].to_numpy()
    at = np.append(np.arange(4000), np.full(rows, 3999))
    if filled == "motion":
        at = np.append(np.arange(4000), np.resize(np.arange(3999, 0, -1), rows))
    log = opened(whole, np.append(time, np.full(rows, time[-1])), at, clavel)
    if filled == "zeros":
        end = pl.DataFrame({name: np.zeros(rows) for name in whole.columns})
        log = open_log(deltaid.Recording.from_table(pl.concat([whole, end])), clavel.kinematics)
    assert log.clock.period == pytest.approx(time[1] - time[0], rel=1e-6)
    said = next(doubt for doubt in log.warnings if "stands still" in str(doubt))
    assert "the first row 4001" in str(said) or "the first row 4002" in str(said)
    assert "longer than the recording" in str(said)
    (usable,) = [size for size in log.clock.segments(1) if size > 100]
    assert usable == pytest.approx(4000, abs=64)


def test_a_rate_that_changes_is_no_lost_row(clavel: Dynamics) -> None:
    whole = even(1000.0, 4.0).frame
    at = np.append(np.arange(2000), np.arange(2000, 4000, 2))
    log = opened(whole, whole["t"].to_numpy()[at], at, clavel)
    (said,) = with_filter(log, 20.0).log.warnings
    assert str(said).startswith("1000 rows from row 2001 on come at 500 Hz, others at 1000 Hz; ")
    assert "the rate was changed while recording" in str(said)
    few = np.delete(np.arange(4000), np.arange(2001, 2101, 2))  # every second of 100 rows
    log = opened(whole, whole["t"].to_numpy()[few], few, clavel)
    (said,) = with_filter(log, 20.0).log.warnings
    assert str(said).startswith("50 rows are missing in 50 places ")
