"""Where a robot is at rest, and where its drives are without torque.

At rest all drives stay within the steps and the noise of their encoders for longer than a reversal
takes. Slow motion stays there as well if steps are coarse, so in hindsight rest must also be slow
against the recording's largest speeds, as far as its length can tell; of what is not, parts may be.
A torque that does not change at all is off only if its channel has noise elsewhere: without, what
holds a robot at rest does not change either.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from deltaid.recording.masks.masks import NONE, Runs, joined, rolling, runs_of

# Rest lasts so long at least [s], and so many rows.
_LASTS, _ROWS = 0.04, 5
# In that time positions stay within so many encoder steps and so many times the narrowest band that
# the drive ever stayed in; over a whole rest within so many times that, or that a second.
_STEPS, _BANDS, _WANDER = 1.5, 2.0, 3.0
# A robot at rest is slower than this share of its drives' largest speeds.
_SLOW = 0.005
# Torque is off where for so long [s] and so many rows its mean and its range stay below these
# shares of the largest torque, or where no torque changes at all.
_OFF_LASTS, _OFF_ROWS, _OFF, _OFF_RANGE = 0.01, 5, 0.04, 0.2
# A channel has noise if so large a share of its changes go back on the one before; of white noise
# two thirds do, of a smooth torque next to none.
_NOISY = 0.2


@dataclass
class _Rest:
    """Rows at rest, the lowest and highest positions there, and parts that stay in a band each."""

    first: int
    last: int
    low: Float[np.ndarray, " dof"]
    high: Float[np.ndarray, " dof"]
    parts: list["_Rest"] = field(default_factory=list["_Rest"])


def _rest(q: Float[np.ndarray, "rows dof"], row: int) -> _Rest:
    return _Rest(row, row + len(q) - 1, q.min(axis=0), q.max(axis=0))


class RestSearch:
    """Looks for rest in blocks of rows that overlap by `overlap`.

    `add` them, then read `at_rest` and `off`.

    Attributes:
        period: time between two rows [s].
    """

    def __init__(self, dof: int, period: float) -> None:
        self.period = period
        self._step, self._band = np.full((2, dof), np.inf)
        self._speed, self._torque = np.zeros((2, dof))
        self._low, self._high = np.full(dof, np.inf), np.full(dof, -np.inf)
        self._rests: list[_Rest] = []
        self._off, self._constant = list[Runs](), list[Runs]()
        self._changes = np.zeros((2, dof))

    @property
    def steps(self) -> Float[np.ndarray, " dof"]:
        """Smallest change of each position so far, the step of its encoder; 0 without any."""
        return np.where(np.isfinite(self._step), self._step, 0.0)

    @property
    def length(self) -> int:
        """Rows of a rest at least."""
        return max(_ROWS, round(_LASTS / self.period))

    @property
    def overlap(self) -> int:
        """Rows that two blocks have in common."""
        return self.length - 1

    def add(
        self,
        q: Float[np.ndarray, "rows dof"],
        torque: Float[np.ndarray, "rows dof"],
        row: int,
    ) -> None:
        """Take in a block, the first row of which is number `row`."""
        if len(q) < self.length:
            return
        self._look_at_torque(torque, row)
        low, high = rolling(q, self.length)
        width = high - low
        change = np.abs(np.diff(q, axis=0))
        self._step = np.minimum(self._step, np.where(change > 0, change, np.inf).min(axis=0))
        self._band = np.minimum(self._band, width.min(axis=0))
        ways = np.abs(q[self.overlap :] - q[: len(q) - self.overlap])
        self._speed = np.maximum(self._speed, ways.max(axis=0) / (self.overlap * self.period))
        self._low = np.minimum(self._low, q.min(axis=0))
        self._high = np.maximum(self._high, q.max(axis=0))
        for first, last in runs_of(np.all(width <= self._widest, axis=1), row).tolist():
            stays = q[first - row : last - row + self.length]
            rest = _rest(stays, first)
            if np.any(rest.high - rest.low > self._widest):
                rest.parts = list(self._parts(stays, first))
            self._take(rest)

    @property
    def at_rest(self) -> Runs:
        """Runs of rows at rest."""
        rests = []
        for rest in self._rests:
            slow = [rest] if self._slow(rest) else filter(self._slow, rest.parts)
            rests += [(part.first, part.last) for part in slow]
        return joined(np.array(rests, dtype=np.int64).reshape(-1, 2))

    @property
    def off(self) -> Runs:
        """Runs without torque of any drive."""
        back, changes = self._changes
        noisy = np.any(back > _NOISY * changes)
        return joined(np.concatenate([NONE, *self._off, *(self._constant if noisy else [])]))

    @property
    def _widest(self) -> Float[np.ndarray, " dof"]:
        return _STEPS * self.steps + _BANDS * self._band

    def _take(self, rest: _Rest) -> None:
        if self._rests and rest.first <= self._rests[-1].last + 1:
            before = self._rests.pop()
            rest.first, rest.last = before.first, max(rest.last, before.last)
            rest.low = np.minimum(rest.low, before.low)
            rest.high = np.maximum(rest.high, before.high)
            rest.parts = before.parts + rest.parts
        self._rests.append(rest)

    def _parts(self, q: Float[np.ndarray, "rows dof"], row: int) -> Iterator[_Rest]:
        """Consecutive parts of rows, each as long as it stays in the band of rest."""
        start = 0
        while start < len(q):
            size, stays = self.length, np.ones(1, dtype=bool)
            while stays.all() and len(stays) < len(q) - start:  # no longer than needed
                size *= 2
                ahead = q[start : start + size]
                width = np.maximum.accumulate(ahead) - np.minimum.accumulate(ahead)
                stays = np.all(width <= self._widest, axis=1)
            count = len(stays) if stays.all() else int(np.argmin(stays))
            yield _rest(q[start : start + count], row + start)
            start += count

    def _slow(self, rest: _Rest) -> bool:
        time = (rest.last - rest.first) * self.period
        moves = self._high - self._low > self._widest
        width = rest.high - rest.low
        slow = width + self.steps <= _SLOW * self._speed * time
        steady = width <= self._widest * max(_WANDER, time)
        return bool(np.all((slow & steady) | ~moves) and moves.any())

    def _look_at_torque(self, torque: Float[np.ndarray, "rows dof"], row: int) -> None:
        length = max(_OFF_ROWS, round(_OFF_LASTS / self.period))
        if len(torque) < length:
            return
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
