"""Torques that were joined at another row than positions.

Of the torque u(t) of a drive with rows y(t) of the regressor, the share

    min_p Σ (u(t + δ) − y(t) p)² / Σ u(t + δ)²

that no parameters explain is least at the lag δ. It is sharp where the correlation with the prior's
torques is not: 40 ms in a motion of 1 Hz hardly change the latter. Friction that yields before it
slips may look like a short lag, but leaves a larger share.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.checks.wiring.candidate import ALONG, SENSIBLE
from deltaid.checks.wiring.course import CLEARER, TINY, OfDrives, TorqueCourse, Torques, gains
from deltaid.checks.wiring.explained import RemappedRecording
from deltaid.estimation.problem import Span
from deltaid.estimation.traces import LARGEST_LAG
from deltaid.model.verdict import Grade, Verdict, listed, percent

# Lag [s] from which a motion may repeat. Below, friction that yields before it slips may look like
# a lag, but leaves more of each drive's torque than this share of what a lag of zero leaves; for
# a single drive its square counts.
_DELAY, _LEFT = 0.15, 0.1
# Least number of samples for each column; most samples that are compared.
_PER_COLUMN, _MOST = 2, 500


@dataclass(frozen=True, eq=False)
class _Lag:
    """A lag [s] of some drives, and the shares of their torques that are unexplained with it and
    without (RMS)."""

    late: float
    with_it: float
    without: float


@dataclass(frozen=True, eq=False)
class _Profile:
    """Unexplained shares at lags of −`reach` to `reach`, in steps of the fine torques."""

    course: TorqueCourse
    places: Int[np.ndarray, " places"]  # compared samples
    reach: int
    shares: Float[np.ndarray, "moving lags"]

    @classmethod
    def from_course(cls, course: TorqueCourse) -> "_Profile | None":
        """None where the recording is too short to leave enough samples."""
        _, count, columns = course.regressor.shape
        margin = min(count // 4, (count - _PER_COLUMN * columns) // 2)
        used = np.flatnonzero(np.any(course.regressor, axis=(0, 2)))
        used = used[(used >= margin) & (used < count - margin)]
        reach = (margin - 1) * course.every
        if reach * course.step / course.every <= LARGEST_LAG or len(used) < _PER_COLUMN * columns:
            return None
        chosen = np.linspace(0, len(used) - 1, min(_MOST, len(used))).astype(int)
        places = used[chosen]
        begin = course.first + places * course.every - reach
        windows = np.lib.stride_tricks.sliding_window_view(course.fine, 2 * reach + 1, axis=1)
        shares = [
            unexplained(Y[places], torques[begin])
            for Y, torques in zip(course.regressor, windows, strict=True)
        ]
        return cls(course, places, reach, np.array(shares))

    def lag_of(self, drives: Int[np.ndarray, " drives"], least: float) -> _Lag | None:
        """The lag of at least `least` s that some drives have in common; None where none is clear.
        A motion that repeats has the same lag again a period later."""
        short = min(int(_DELAY * self.course.every / self.course.step), self.reach)
        short_lag = self._best(drives, least, short)
        return short_lag if short_lag is not None else self._best(drives, least, self.reach)

    def _best(self, drives: Int[np.ndarray, " drives"], least: float, reach: int) -> _Lag | None:
        """The lag of least share, up to `reach` fine samples, if it is clear."""
        course, first = self.course, self.reach - reach
        mean = self.shares[drives, first : first + 2 * reach + 1].mean(axis=0)
        k = int(np.argmin(mean[1:-1])) + 1
        before, here, after = mean[k - 1 : k + 2].tolist()
        shift = k - reach
        place = shift + 0.5 * (before - after) / max(before - 2 * here + after, TINY)  # a parabola
        late = place * course.step / course.every
        if abs(late) < least or here > min(before, after):  # still falling at the end
            return None
        with_it, without = self.shares[drives][:, [self.reach + shift, self.reach]].T
        along = gains(course.prior[:, self.places], self.torques(shift))[1][drives]
        if abs(late) < _DELAY:
            is_clear = bool(np.all(with_it < (_LEFT if len(drives) > 1 else _LEFT**2) * without))
        else:
            goes_along, peak = self._goes_along(drives, shift), float(along.mean())
            is_clear = goes_along <= ALONG and 1 - peak**2 <= CLEARER * (1 - goes_along**2)
        if not is_clear or np.any(along < SENSIBLE[0]):
            return None
        return _Lag(late, float(np.sqrt(with_it.mean())), float(np.sqrt(without.mean())))

    def _goes_along(self, drives: Int[np.ndarray, " drives"], shift: int) -> float:
        """Correlation of torques as recorded with the prior's, also in the rows that are compared
        at a lag: if something disturbs only the others, torques fit a period earlier or later."""
        there = self.places + round(shift / self.course.every)
        at_lag = gains(self.course.prior[:, there], self.course.recorded[:, there])[1]
        return max(float(along[drives].mean()) for along in (self.as_recorded, at_lag))

    def torques(self, shift: int) -> Torques:
        """Torques of the compared samples that many fine samples later."""
        return self.course.fine[:, self.course.first + self.places * self.course.every + shift]

    @property
    def as_recorded(self) -> OfDrives:
        """Correlations of torques with those of the prior without a lag."""
        return gains(self.course.prior[:, self.places], self.torques(0))[1]


def lag_of_all(course: TorqueCourse) -> float | None:
    """The lag that torques of all drives have in common [s]; None where none is clear."""
    profile = _Profile.from_course(course) if course.drives.size else None
    lag = profile and profile.lag_of(np.arange(len(course.drives)), 0.0)
    return lag and lag.late


def joined_verdicts(log: RemappedRecording, course: TorqueCourse) -> Iterator[Verdict]:
    """Torques of all drives, or of single ones, that positions explain at a lag only."""
    if (profile := _Profile.from_course(course)) is None:
        return
    every = np.arange(len(course.drives))
    lags = [(every, profile.lag_of(every, LARGEST_LAG))]
    apart = profile.as_recorded <= ALONG
    if lags[0][1] is None and apart.mean() < 0.5:
        lags = [(every[[i]], profile.lag_of(every[[i]], LARGEST_LAG)) for i in every]
    for group, lag in lags:
        # Columns in another order or unit may explain as much.
        if lag is not None and lag.with_it < np.sqrt(CLEARER) * log.best.unexplained:
            yield _verdict(log, course.drives[group].tolist(), lag)


def _verdict(log: RemappedRecording, drives: list[int], lag: _Lag) -> Verdict:
    milliseconds = 1e3 * lag.late
    count = round(lag.late / log.evidence.rows.step)
    columns = listed([log.evidence.columns.torque[i].column for i in drives])
    columns = columns if log.whose(drives) else "the torque columns"
    return Verdict(
        "torque-lag",
        Grade.WRONG,
        f"the torque of {log.all_or(drives)} comes {abs(milliseconds):.0f} ms "
        f"{'late' if lag.late > 0 else 'early'} against positions, some {abs(count)} rows, more "
        f"than any drive delays it: {percent(lag.with_it)} of it is unexplained then, and "
        f"{percent(lag.without)} as recorded",
        log.whose(drives),
        cause="positions and torques were recorded apart and joined at another row, or by clocks "
        "that differ",
        cure=f"join them by stamps of one clock, which shifts {columns} by some {-count:+d} rows, "
        "or record both at once",
        number=milliseconds,
        unit="ms",
    )


def unexplained(
    Y: Float[np.ndarray, "samples columns"], torques: Float[np.ndarray, "samples *lags"]
) -> Float[np.ndarray, "*lags"]:
    """Share of squared torques that neither the columns Y nor a constant explain."""
    span = Span.of_columns(np.column_stack([Y, np.ones(len(Y))]))
    total = np.sum(torques**2, axis=0)
    return 1.0 - np.sum((span.Q.T @ torques) ** 2, axis=0) / np.maximum(total, TINY)
