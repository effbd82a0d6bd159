"""Detects rest, and torques that are off.

At rest, all drives stay within steps and noise of their encoders for longer than a reversal takes.
With coarse steps, slow motion does so too, so rest must also be slow against the largest speeds of
the recording, as far as its duration shows; if it is not, parts of it may still be rest. A constant
torque means that the drive is off only if its channel has noise elsewhere: without noise, the
torque that holds a robot at rest is constant too.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from deltaid.recording.masks.masks import NOISY, NONE, Runs, as_runs, joined, rolling, runs_of

# Least duration of rest, also on brakes [s]; fewest rows of rest, and of torque that is off.
LASTS, _ROWS = 0.04, 5
# Width of the band of rest during that time, in encoder steps plus narrowest bands of the drive;
# and largest width of a whole rest, in bands of rest: this, or its duration in seconds if larger.
_STEPS, _BANDS, _WANDER = 1.5, 2.0, 3.0
# Largest speed of a robot at rest, as a share of its drives' largest speeds.
_SLOW = 0.005
# Torque that is off: least duration [s], and largest mean and range, as shares of the largest
# torque.
_OFF_LASTS, _OFF, _OFF_RANGE = 0.01, 0.04, 0.2
DriveRows = Float[np.ndarray, "rows dof"]


@dataclass
class _Rest:
    """Rows at rest, their range of positions, and parts that each stay in the band of rest."""

    first: int
    last: int
    low: Float[np.ndarray, " dof"]
    high: Float[np.ndarray, " dof"]
    parts: list["_Rest"] = field(default_factory=list["_Rest"])


def _rest(q: DriveRows, row: int) -> _Rest:
    return _Rest(row, row + len(q) - 1, q.min(axis=0), q.max(axis=0))


class RestSearch:
    """Running search for rest; `add` blocks of rows, then read `at_rest` and `off`.

    Attributes:
        period: time between two rows [s].
        length: fewest rows of a rest.
        overlap: number of rows that two blocks share, `length` − 1.
    """

    def __init__(self, dof: int, period: float) -> None:
        self.period, self.length = period, max(_ROWS, round(LASTS / period))
        self.overlap = self.length - 1
        self._step, self._band, self._low = np.full((3, dof), np.inf)
        self._speed, self._torque = np.zeros((2, dof))
        self._high, self._changes = np.full(dof, -np.inf), np.zeros((2, dof))
        self._rests, self._off, self._constant = list[_Rest](), list[Runs](), list[Runs]()

    @property
    def steps(self) -> Float[np.ndarray, " dof"]:
        """Smallest change of each position [rad or m], its encoder's step; 0 without changes."""
        return np.where(np.isfinite(self._step), self._step, 0.0)

    def add(self, q: DriveRows, torque: DriveRows, row: int) -> None:
        """Add a block; `row` is the number of its first row."""
        if len(q) < self.length:
            return
        self._add_torque(torque, row)
        low, high = rolling(q, self.length)
        width, change = high - low, np.abs(np.diff(q, axis=0))
        self._step = np.minimum(self._step, np.where(change > 0, change, np.inf).min(axis=0))
        self._band = np.minimum(self._band, width.min(axis=0))
        travel = np.abs(q[self.overlap :] - q[: len(q) - self.overlap])
        self._speed = np.maximum(self._speed, travel.max(axis=0) / (self.overlap * self.period))
        self._low = np.minimum(self._low, q.min(axis=0))
        self._high = np.maximum(self._high, q.max(axis=0))
        for first, last in runs_of(np.all(width <= self.still, axis=1), row).tolist():
            stays = q[first - row : last - row + self.length]
            rest = _rest(stays, first)
            if np.any(rest.high - rest.low > self.still):
                rest.parts = list(self._parts(stays, first))
            if self._rests and rest.first <= self._rests[-1].last + 1:
                before = self._rests.pop()
                low, high = np.minimum(rest.low, before.low), np.maximum(rest.high, before.high)
                end, parts = max(rest.last, before.last), before.parts + rest.parts
                rest = _Rest(before.first, end, low, high, parts)
            self._rests.append(rest)

    @property
    def at_rest(self) -> Runs:
        rests = [
            (part.first, part.last)
            for rest in self._rests
            for part in ([rest] if self._slow(rest) else filter(self._slow, rest.parts))
        ]
        return joined(as_runs(rests))

    @property
    def off(self) -> Runs:
        back, changes = self._changes
        noisy = np.any(back > NOISY * changes)
        return joined(np.concatenate([NONE, *self._off, *(self._constant if noisy else [])]))

    @property
    def still(self) -> Float[np.ndarray, " dof"]:
        """Width of the band of rest of each position [rad or m]."""
        return _STEPS * self.steps + _BANDS * self._band

    def _parts(self, q: DriveRows, row: int) -> Iterator[_Rest]:
        """Consecutive parts of rows that stay in the band of rest."""
        start = 0
        while start < len(q):
            size, stays = self.length, np.ones(1, dtype=bool)
            while stays.all() and len(stays) < len(q) - start:  # checks no more rows than needed
                size *= 2
                ahead = q[start : start + size]
                width = np.maximum.accumulate(ahead) - np.minimum.accumulate(ahead)
                stays = np.all(width <= self.still, axis=1)
            count = len(stays) if stays.all() else int(np.argmin(stays))
            yield _rest(q[start : start + count], row + start)
            start += count

    def _slow(self, rest: _Rest) -> bool:
        time, width = (rest.last - rest.first) * self.period, rest.high - rest.low
        moves = self._high - self._low > self.still
        slow = width + self.steps <= _SLOW * self._speed * time
        steady = width <= self.still * max(_WANDER, time)
        return bool(np.all((slow & steady) | ~moves) and moves.any())

    def _add_torque(self, torque: DriveRows, row: int) -> None:
        length = max(_ROWS, round(_OFF_LASTS / self.period))
        self._torque = np.maximum(self._torque, np.abs(torque).max(axis=0))
        low, high = rolling(torque, length)
        sums = np.cumsum(np.vstack([np.zeros_like(torque[:1]), torque]), axis=0)
        mean = (sums[length:] - sums[:-length]) / length
        near = (np.abs(mean) <= _OFF * self._torque) & (high - low <= _OFF_RANGE * self._torque)
        for spans, flags in ((self._off, near), (self._constant, high == low)):
            spans.append(joined(runs_of(np.all(flags, axis=1), row) + np.array([0, length - 1])))
        change = np.diff(torque, axis=0)
        turned = change[1:] * change[:-1]
        self._changes += [np.count_nonzero(turned < 0, axis=0), np.count_nonzero(change, axis=0)]
