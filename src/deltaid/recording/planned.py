"""Extends planned motions beyond their ends, so that filters over positions lose no rows.

Beyond an end at rest a plan rests, and a periodic plan repeats, so rows are added there. Beyond an
end at which the plan moves, the motion is unknown, and the filter's length is lost.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, compress
from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.levels import SURE
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.columns import Rows
from deltaid.recording.filter import LowPass, design_low_pass
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import RESTS
from deltaid.recording.masks.stuck import FEWEST, STIFF
from deltaid.recording.recording import PreparedRecording, with_filter
from deltaid.recording.spectrum import HIGHEST, SEGMENT, SpectrumEstimate, spectrum_of
from deltaid.recording.windows import SampleBlock, Window

Drives = Float[np.ndarray, " drives"]
End = Literal["first", "last"]

# Number of rows that are inspected at each end.
_ROWS = SEGMENT // 2
# Largest error of a speed or acceleration that is accepted, as a share of its largest or rms value:
# it changes torques by a few percent.
UNSURE = 0.1


@dataclass(frozen=True)
class PlanEnds:
    """Rows at both ends of a plan, columns as in `Log.batches`.

    Attributes:
        log: the plan.
        head, tail: first and last rows, as many as are inspected or the filter needs.
        speed: largest speed of each drive [rad/s or m/s].
    """

    log: Log
    head: Rows
    tail: Rows
    speed: Drives

    def beyond(self, end: End, count: int, period: int) -> Rows:
        """`count` rows beyond an end of a plan that repeats after `period` rows, or rests if that
        is 0."""
        c, rate, ahead = self.log.columns, self.log.rate, end == "first"
        places = np.arange(-count, 0) if ahead else self.log.samples + np.arange(count)
        edge, row = (self.head[0], 0) if ahead else (self.tail[-1], self.log.samples - 1)
        added = np.repeat(edge[None], count, axis=0)
        added[:, 1 + len(c.position) : c.motion_places.stop] = 0.0
        if period:
            at = np.mod(places, period)
            behind = at >= len(self.head)
            added = self.head[np.where(behind, 0, at)]
            added[behind] = self.tail[at[behind] - (self.log.samples - len(self.tail))]
        added[:, 0] = edge[0] + (places - row) / rate
        return added

    @property
    def noise(self) -> Drives:
        """Standard deviation of positions, including the steps of their digits [rad or m]."""
        step = spectrum_of(self.positions(np.vstack([self.head, self.tail]))).step
        step = np.where(np.isfinite(step), step, 0.0)
        return np.maximum(step / np.sqrt(12), self.log.position_noise)

    def positions(self, rows: Rows) -> Rows:
        return rows[:, 1 : 1 + len(self.log.columns.position)]

    def state(self, end: End, cutoff: float) -> tuple[Drives, Drives, Drives]:
        """Position and speed at an end, and the standard deviation of the speed, by a
        least-squares cubic over half a period of the cut-off [Hz]."""
        c, rate = self.log.columns, self.log.rate
        rows = self.head if end == "first" else self.tail[::-1]
        q = self.positions(rows)
        if c.velocity:
            n = len(c.position)
            return q[0], rows[0, 1 + n : 1 + 2 * n], np.zeros(n)
        count = min(len(q), max(FEWEST, round(rate / (2 * cutoff))))
        time = np.arange(count) / rate * (1 if end == "first" else -1)
        fit = np.linalg.pinv(np.vander(time, min(STIFF, count - 1) + 1, increasing=True))
        return fit[0] @ q[:count], fit[1] @ q[:count], np.linalg.norm(fit[1]) * self.noise

    def is_at_rest(self, end: End, cutoff: float) -> bool:
        """Whether no drive moves at an end."""
        _, speed, spread = self.state(end, cutoff)
        # Where the parabola through the three rows at the end reverses, the motion starts from
        # rest, even if rows are too far apart for a cubic.
        rows = self.positions(self.head if end == "first" else self.tail[::-1])
        first, second = np.diff(rows[:3], axis=0) * self.log.rate
        speed = np.minimum(
            np.abs(speed), np.maximum(np.sign(first) * (1.5 * first - 0.5 * second), 0)
        )
        limit = RESTS * self.speed + np.minimum(SURE * spread, UNSURE * self.speed)
        return not np.any((speed > limit) & (self.speed > 0))

    def period(self, cutoff: float) -> int:
        """Number of rows of a period: the last row equals the first one, or the next row would.

        Raises:
            RecordingError: the plan is not periodic.
        """
        (q, v, spread), (q_last, v_last, spread_last) = (
            self.state(end, cutoff) for end in ("first", "last")
        )
        largest, unsure = self.speed / self.log.rate, SURE * self.noise
        apart = {
            self.log.samples - 1: np.abs(q_last - q),
            self.log.samples: np.abs(q_last + v_last / self.log.rate - q),
        }
        closing = {rows: gap - UNSURE * largest - 2 * unsure for rows, gap in apart.items()}
        period = min(closing, key=lambda rows: closing[rows].max())
        jump = np.abs(v_last - v) - 2 * RESTS * self.speed - SURE * (spread + spread_last)
        if closing[period].max() > 0:
            k = int(np.argmax(closing[period]))
            what = f"the drive is at {q_last[k]:.6g} in the last row and at {q[k]:.6g} in the first"
        elif jump.max() > 0:
            k = int(np.argmax(jump))
            what = f"the drive ends with a speed of {v_last[k]:.4g} and begins with {v[k]:.4g}"
        else:
            return period
        raise RecordingError(
            f"does not go on as it begins: {what}",
            where=f"{self.log.path}, column {self.log.columns.position[k].column}",
            cure="write one whole period, with or without its first row again, or omit --periodic",
        )


def planned(log: Log, cutoff: float | None = None, *, periodic: bool = False) -> PreparedRecording:
    """Planned motion with its filter over positions, and with rows beyond its ends.

    Torques are not filtered: each row of the plan that the filter reaches gives one sample.

    Args:
        log: the plan; without steady rows, no rows are added beyond its ends.
        cutoff: least cut-off [Hz], as far as the rate allows it.
        periodic: whether the plan repeats.

    Raises:
        RecordingError: the ends do not fit a period, or the plan is too short for the filter and
            does not rest at both ends.
    """
    if log.has_derivatives and cutoff is None:
        return with_filter(log)
    if not log.laid.steady:
        if periodic:
            raise RecordingError(
                "has time stamps that are not even, so it is no period of a motion",
                where=str(log.path),
                cure="write rows at even times, or omit --periodic",
            )
        recording = with_filter(log, cutoff if log.has_derivatives else None)
        return replace(recording, low_pass=_only_motion(recording.filter))
    least = min(max(cutoff or 0.0, log.motion_cutoff or 0.0), HIGHEST * log.rate)
    ends = _ends(log, _ROWS + 1)
    # A plan that is too short for a spectrum counts as the fastest motion.
    judged = max(cutoff or 0.0, log.motion_cutoff or HIGHEST * log.rate)
    period = ends.period(judged) if periodic else 0
    known = [periodic or ends.is_at_rest(end, judged) for end in ("first", "last")]
    spectra = [spectrum_of(ends.positions(rows)) for rows in _stretches(ends, period, known)]
    motion = max([least, *(spectrum.cutoff(log.rate) or 0.0 for spectrum in spectra)])
    if not motion:
        raise _too_short(log, SpectrumEstimate.SHORTEST, "first")
    low_pass = _only_motion(design_low_pass(motion, log.rate))
    first, all_lost = low_pass.first_row, low_pass.reach
    last = all_lost + low_pass.stride - first
    needed = all_lost - sum(compress((first, last), known))
    if log.samples <= max(0, needed):
        raise _too_short(log, needed + 1, "last" if known[0] else "first")
    ends = ends if max(first, last) <= _ROWS else _ends(log, max(first, last) + 1)
    before = (ends.beyond("first", first, period),) if known[0] else ()
    after = (ends.beyond("last", last, period),) if known[1] else ()
    return PreparedRecording(log, low_pass, before=before, after=after)


def motion_of(recording: PreparedRecording, kinematics: Kinematics) -> Iterator[SampleBlock]:
    """Samples along a plan, part by part, without the rows that were added beyond its end.

    The speed of resting drives is 0.
    """
    left = recording.log.samples - sum(recording.without)
    for samples in recording.evaluate(kinematics, stilled(recording)):
        part = samples.part(slice(max(0, left))) if recording.after else samples
        left -= len(part.time)
        yield part


def stilled(recording: PreparedRecording) -> Callable[[Window], SampleBlock]:
    """Function that returns the inner samples of a window, with zero speed of resting drives.

    Otherwise the sign of the speed, and so friction, would follow rounding and steps of positions,
    and at an end at rest the filtered motion nearby.
    """
    still, last = _still_speed(recording), recording.log.samples - 1
    ends = [row for row, rows in ((0, recording.before), (last, recording.after)) if _rest(rows)]

    def samples(window: Window) -> SampleBlock:
        qd = np.where(np.abs(window.inner.qd) > still, window.inner.qd, 0.0)
        qd[[row - window.start for row in ends if 0 <= row - window.start < len(qd)]] = 0.0
        return replace(window.inner, qd=qd)

    return samples


def _rest(rows: tuple[Rows, ...]) -> bool:
    """Whether a plan rests in the rows beyond an end."""
    return bool(rows) and not np.ptp(rows[0][:, 1:], axis=0).any()


def _still_speed(recording: PreparedRecording) -> Drives:
    """Speed of each drive below which it counts as resting [rad/s or m/s]."""
    low_pass, log = recording.filter, recording.log
    ends = _ends(log, _ROWS + 1)
    largest = np.abs(ends.positions(np.vstack([ends.head, ends.tail]))).max(axis=0)
    digit = np.finfo(float).eps * largest
    if recording.low_pass is None:  # a speed that changes no digit of a position in one row
        return digit * log.rate
    rounding = digit * np.abs(low_pass.first).sum()
    return np.maximum(rounding, SURE * ends.noise * low_pass.speed_gain)


def _too_short(log: Log, needed: int, end: End) -> RecordingError:
    return RecordingError(
        f"has {log.samples} samples, too few to filter and differentiate (at least {needed:g}), "
        f"because it does not rest at its {end} row",
        where=str(log.path),
        cure="begin and end at rest, or write velocities and accelerations as well; "
        "deltaid torque also takes a motion that goes on as it begins, with --periodic",
    )


def _only_motion(low_pass: LowPass) -> LowPass:
    return replace(low_pass, smooth=np.ones(1), decimation=1)


def _ends(log: Log, count: int) -> PlanEnds:
    c, drives = log.columns, len(log.columns.position)
    head = tail = np.zeros((0, c.extra_places.stop + len(c.torque)))
    speed = np.zeros(drives)
    for values in chain.from_iterable(log.segments(None)):
        head = np.vstack([head, values[: count - len(head)]])
        joined = np.vstack([tail, values])
        steps = np.abs(np.diff(joined[:, 1 : 1 + drives], axis=0))
        speed = np.maximum(speed, steps.max(axis=0, initial=0.0) * log.rate)
        tail = joined[-count:]
    return PlanEnds(log, head, tail, speed)


def _stretches(ends: PlanEnds, period: int, known: list[bool]) -> list[Rows]:
    """Rows around each end with a known continuation, half of them beyond it."""
    if all(known) and ends.log.samples < _ROWS:  # a short plan is the middle of one stretch
        half = _ROWS - ends.log.samples // 2
        around = [ends.beyond(end, half, period) for end in ("first", "last")]
        return [np.vstack([around[0], ends.head, around[1]])]
    first = [ends.beyond("first", _ROWS, period), ends.head[:_ROWS]]
    last = [ends.tail[-_ROWS:], ends.beyond("last", _ROWS, period)]
    return [np.vstack(rows) for rows in compress((first, last), known)]
