"""Channels with times of their own as one, and a recording as segments of samples on an even grid.

What is sampled a few times faster than it moves is a polynomial over a handful of samples. Through
the eight nearest of them, whether evenly spaced or not, Lagrange's polynomial errs by less than
3e-5 of a motion's amplitude up to a tenth of the sampling rate, which is as far as positions are
differentiated anyway; and it needs no filter length at the ends.

A short hole of a recording is bridged: positions and velocities go on as the motion about it does,
no torque counts there, and sensors show NaN. A long one ends a segment. Where samples were taken
unevenly, all of them are interpolated. What is recorded beside the drives and sensors, such as the
state of a gripper, stays as it was until it is recorded again.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
from jaxtyping import Float, Int

from deltaid.errors import RecordingError
from deltaid.recording.source import BATCH_ROWS
from deltaid.recording.time.clock import Clock

# Samples on either side of an instant under the polynomial.
SIDE = 4
# Instants that are interpolated together: under them lie as many samples as a batch has.
_CHUNK = BATCH_ROWS // (2 * SIDE)
# Samples so many periods apart have a gap between them, in which nothing is known.
GAP = 3.0
Times = Float[np.ndarray, " samples"]
Instants = Float[np.ndarray, " instants"]
Values = Float[np.ndarray, "samples channels"]
Rows = Float[np.ndarray, "_ _"]
Places = Float[np.ndarray, " _"]


def interpolate(
    time: Times, values: Values, at: Instants
) -> Float[np.ndarray, "instants channels"]:
    """Channels at other instants, by the polynomial of degree 7 through the samples about each.

    Args:
        time: of the samples, strictly increasing [s]; need not be even.
        values: one row a sample.
        at: instants, in any order; outside of `time` the polynomial at the end goes on.
    """
    points = min(2 * SIDE, len(time))
    out = np.empty((len(at), values.shape[1]))
    for start in range(0, len(at), _CHUNK):
        part = at[start : start + _CHUNK]
        first = np.clip(np.searchsorted(time, part) - points // 2, 0, len(time) - points)
        under = first[:, None] + np.arange(points)
        weights = weights_at(time[under], part)
        out[start : start + _CHUNK] = np.einsum("np,npc->nc", weights, values[under])
    return out


def weights_at(
    nodes: Float[np.ndarray, "instants points"], at: Instants
) -> Float[np.ndarray, "instants points"]:
    """Lagrange's weights of the nodes about each instant: ℓ_j = Π (t − t_i) / (t_j − t_i)."""
    away = at[:, None] - nodes
    apart = nodes[:, :, None] - nodes[:, None, :]
    itself = np.arange(nodes.shape[1])
    apart[:, itself, itself] = 1.0
    ratio = away[:, None, :] / apart
    ratio[:, itself, itself] = 1.0
    return ratio.prod(axis=2)


@dataclass(frozen=True, eq=False)
class Signal:
    """Channels that share one clock.

    Attributes:
        time: of the samples [s], on an axis that all signals of a recording share.
        values: one row a sample, one column a channel.
    """

    time: Times
    values: Values


def merged(
    names: Iterable[str], parts: Iterable[Sequence[Signal]], where: str
) -> tuple[Signal, list[bool]]:
    """Signals, each in consecutive parts, as one at the instants of the fastest.

    Its own values, and those of signals with the same stamps, stay as they are; the others are
    interpolated. Instants of which one of the others tells nothing, before its start, after its
    end, in a hole, are left out, so that a hole in any signal is one of the whole recording. So are
    samples of the others that do not come after the one before them (doubled, or late).

    Args:
        names: of the signals, for messages as `where`.

    Returns:
        All channels in the order given, and which of the signals have just these instants.

    Raises:
        RecordingError: a signal has fewer than two samples.
    """
    signals = list[Signal]()
    for name, pieces in zip(names, parts, strict=True):
        if sum(len(part.time) for part in pieces) < 2:
            cure = "give a whole recording, or leave it out of the mapping"
            raise RecordingError(f"{name} has fewer than two samples", where=where, cure=cure)
        columns = zip(*((part.time, part.values) for part in pieces), strict=True)
        signals.append(Signal(*map(np.concatenate, columns)))
    at = min(signals, key=lambda signal: _period(signal.time)).time
    same, keep = [np.array_equal(signal.time, at) for signal in signals], np.ones(len(at), bool)
    for k, (signal, is_same) in enumerate(zip(signals, same, strict=True)):
        if not is_same:
            later = np.append(True, signal.time[1:] > np.maximum.accumulate(signal.time)[:-1])
            signals[k] = Signal(signal.time[later], signal.values[later])
            # There are samples close before and close after an instant.
            time = signals[k].time
            after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
            close = time[after] - time[after - 1] < GAP * _period(time)
            keep &= (at >= time[0]) & (at <= time[-1]) & (close | (time[after] == at))
    values = [
        signal.values[keep] if is_same else interpolate(signal.time, signal.values, at[keep])
        for signal, is_same in zip(signals, same, strict=True)
    ]
    return Signal(at[keep], np.hstack(values)), same


def _period(time: Times) -> float:
    steps = np.diff(time)
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else np.inf


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
        beside = SIDE * (self.longest + 1)  # rows on either side of one that is interpolated
        ready = len(self.places) - beside
        if ready > 2 * beside:
            yield self._samples(int(self.places[ready]))
            kept = slice(ready - beside, None)
            self.waiting, self.places = self.waiting[kept], self.places[kept]

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
            near = self.places[after] - self.places[after - 1] < GAP
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
        if holes.size and len(self.places) < 2 * SIDE:  # too short to be of use
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
    points = 2 * SIDE
    room = np.minimum(after - 1, len(places) - 1 - after) // (SIDE - 1)
    apart = np.clip((places[after] - places[after - 1]).astype(int), 1, np.maximum(1, room))
    steps = apart[:, None] * np.arange(SIDE)
    under = np.hstack([(after - 1)[:, None] - steps[:, ::-1], after[:, None] + steps])
    near = np.clip(after - SIDE, 0, len(places) - points)[:, None] + np.arange(points)
    return np.where((room < 1)[:, None], near, under)
