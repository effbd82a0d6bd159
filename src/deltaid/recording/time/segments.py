"""A recording as segments: runs of samples on an even grid, of rows that may not have been.

A short hole is bridged: positions and velocities go on as the motion about it does, no torque
counts there, and sensors show NaN. A long one ends a segment. Where samples were taken unevenly,
all of them are interpolated, as are channels with clocks of their own. What is recorded beside the
drives and sensors, such as the state of a gripper, stays as it was until it is recorded again.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
from jaxtyping import Float, Int

from deltaid.recording.time.clock import Clock
from deltaid.recording.time.signals import interpolate, weights_at

Rows = Float[np.ndarray, "_ _"]
Places = Float[np.ndarray, " _"]
# Samples on either side under the polynomial that bridges a hole.
_SIDE = 4
# Uneven samples so many periods apart say nothing of the torques between them.
_UNTOLD = 2.5


def longest_hole(rate: float, cutoff: float) -> int:
    """Rows that may be missing in a row and be bridged.

    Samples beside the hole are then no more than a quarter of a period of the cut-off apart, an
    eighth of that of the fastest motion; a polynomial of degree 7 through eight samples so far
    apart errs by less than 2e-4 of that motion.
    """
    return max(1, int(rate / (4 * cutoff)) - 1)


def segments(
    batches: Iterable[Rows],
    clock: Clock,
    longest: int,
    drives: int,
    held: int = 0,
    sensors: int = 0,
) -> Iterator[Iterator[Rows]]:
    """The samples of each segment, in blocks. Use each segment up before the next.

    Args:
        batches: all rows of the recording: time, other channels, at last one weight a drive.
        clock: what is known of their places.
        longest: rows missing that may be bridged.
        drives: number of weights in a row.
        held: number of channels before the weights that hold their value between rows.
        sensors: number of channels before these that are NaN where nothing was recorded.
    """
    if clock.steady:
        yield iter(batches)
        return
    parts = _parts(batches, clock, _Run(clock, longest, drives, held, sensors))
    for _, part in groupby(parts, key=lambda part: part[0]):
        yield (rows for _, rows in part)


def _parts(batches: Iterable[Rows], clock: Clock, run: "_Run") -> Iterator[tuple[int, Rows]]:
    """Consecutive samples with the number of their segment; `run` is the first, still empty."""
    cuts = clock.cuts(run.longest)
    steps = np.where(cuts, 0, clock.lost)
    number, start, empty = 0, 0, replace(run)
    for rows in batches:
        stop = start + len(rows)
        kept = np.ones(len(rows), dtype=bool)
        extra = slice(*np.searchsorted(clock.extra, [start, stop]))
        kept[clock.extra[extra] - start] = False
        here = slice(*np.searchsorted(clock.holes, [start, stop]))
        at = clock.holes[here] - start
        lost = np.zeros(len(rows), dtype=int)
        lost[at] = steps[here]
        ends = at[cuts[here]]
        pieces = zip(
            *(np.split(x, ends) for x in (rows, lost, kept)),
            strict=True,
        )
        for k, (values, missing, used) in enumerate(pieces):
            if k:
                yield from ((number, block) for block in run.end())
                begin = float(clock.until[here][cuts[here]][k - 1])
                number, run = number + 1, replace(empty, begin=begin)
            yield from ((number, block) for block in run.add(values[used], missing[used]))
        start = stop
    yield from ((number, block) for block in run.end())


@dataclass
class _Run:
    """One segment on its way: rows whose neighbours are still to come wait here."""

    clock: Clock
    longest: int
    drives: int
    held: int
    sensors: int
    begin: float = np.nan
    waiting: Rows = field(default_factory=lambda: np.zeros((0, 0)))
    places: Places = field(default_factory=lambda: np.zeros(0))
    next_place: float = 0.0
    given: int = 0

    @property
    def _beside(self) -> int:
        """Rows that must lie on either side of one that is interpolated."""
        return _SIDE * (self.longest + 1)

    @property
    def _shown(self) -> slice:
        stop = self.waiting.shape[1] - self.drives - self.held
        return slice(stop - self.sensors, stop)

    def add(self, rows: Rows, lost: Int[np.ndarray, " rows"]) -> Iterator[Rows]:
        """Take in consecutive rows; gives the samples that are ready."""
        if not len(rows):
            return
        if np.isnan(self.begin):
            self.begin = float(rows[0, 0])
        if self.clock.even is False:
            places = (rows[:, 0] - self.begin) / self.clock.period
        else:
            places = self.next_place + np.cumsum(1 + lost) - 1.0
            self.next_place = float(places[-1]) + 1
        self.waiting = np.concatenate([self.waiting, rows]) if self.waiting.size else rows
        self.places = np.concatenate([self.places, places])
        ready = len(self.places) - self._beside
        if ready > 2 * self._beside:
            yield self._samples(int(self.places[ready]))
            self.waiting = self.waiting[ready - self._beside :]
            self.places = self.places[ready - self._beside :]

    def end(self) -> Iterator[Rows]:
        if len(self.places):
            yield self._samples(int(self.places[-1]) + 1)

    def _samples(self, stop: int) -> Rows:
        """Samples from the first one not given yet up to a place."""
        wanted = np.arange(self.given, stop, dtype=float)
        self.given = stop
        first = self.waiting.shape[1] - self.drives
        if self.clock.even is False:
            out = interpolate(self.places, self.waiting, wanted)
            after = np.clip(np.searchsorted(self.places, wanted), 1, len(self.places) - 1)
            weights = np.minimum(self.waiting[after - 1, first:], self.waiting[after, first:])
            near = self.places[after] - self.places[after - 1] < _UNTOLD
            out[:, first:] = weights * near[:, None]
            out[~near, self._shown] = np.nan
        else:
            out = self._bridged(wanted, first)
        before = np.clip(np.searchsorted(self.places, wanted, side="right") - 1, 0, None)
        out[:, first - self.held : first] = self.waiting[before, first - self.held : first]
        out[:, 0] = self.begin + self.clock.period * wanted
        return out

    def _bridged(self, wanted: Places, first: int) -> Rows:
        """Rows where there are any, polynomials across the holes between them."""
        at = np.searchsorted(self.places, wanted)
        out = self.waiting[at]
        holes = np.flatnonzero(self.places[at] != wanted)
        if holes.size and len(self.places) < 2 * _SIDE:  # too short to be of use
            for k in range(out.shape[1]):
                out[holes, k] = np.interp(wanted[holes], self.places, self.waiting[:, k])
        elif holes.size:
            under = _about(self.places, at[holes])
            weights = weights_at(self.places[under], wanted[holes])
            out[holes] = np.einsum("np,npc->nc", weights, self.waiting[under])
        out[holes, first:] = 0.0
        out[holes, self._shown] = np.nan
        return out


def _about(places: Places, after: Int[np.ndarray, " holes"]) -> Int[np.ndarray, "holes points"]:
    """Rows about each sample that is missing: as far apart as those beside the hole, so that the
    polynomial does not swing in it. `after` is the row after the hole."""
    points = 2 * _SIDE
    room = np.minimum(after - 1, len(places) - 1 - after) // (_SIDE - 1)
    apart = np.clip((places[after] - places[after - 1]).astype(int), 1, np.maximum(1, room))
    steps = apart[:, None] * np.arange(_SIDE)
    under = np.hstack([(after - 1)[:, None] - steps[:, ::-1], after[:, None] + steps])
    near = np.clip(after - _SIDE, 0, len(places) - points)[:, None] + np.arange(points)
    return np.where((room < 1)[:, None], near, under)
