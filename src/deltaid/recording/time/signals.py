"""Merges channels with different clocks, and cuts recordings into segments on an even grid.

A signal that is sampled fast against its motion is interpolated by Lagrange's polynomial through
the eight nearest samples, evenly spaced or not. Its error is below 3e-5 of a motion's amplitude up
to a tenth of the sampling rate, the limit of differentiation. No samples are lost at the ends.

A short hole in a recording is bridged: positions and their derivatives are interpolated, torques
have weight 0, and sensors are NaN. A long hole ends a segment. Uneven samples are all interpolated.
States, such as that of a gripper, hold their value until the next one is recorded.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, groupby

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import RecordingError
from deltaid.recording.columns import Columns, Rows
from deltaid.recording.source import BATCH_ROWS
from deltaid.recording.time.clock import Clock
from deltaid.recording.units import SIDE

# Instants that are interpolated together: they depend on as many samples as a batch has.
_CHUNK = BATCH_ROWS // (2 * SIDE)
# Least distance of two samples between which the motion is unknown [periods].
GAP = 3.0
Times = Float[np.ndarray, " samples"]
Instants = Float[np.ndarray, " instants"]
Values = Float[np.ndarray, "samples channels"]
Places = Float[np.ndarray, " _"]
# Consecutive rows of a segment: number of the segment, its first time [s] (NaN for that of the
# first row), rows, and number of rows missing before each.
_Part = tuple[int, float, Rows, Int[np.ndarray, " rows"]]


def interpolate(
    time: Times, values: Values, at: Instants
) -> Float[np.ndarray, "instants channels"]:
    """Interpolate channels by the polynomial of degree 7 through the samples around each instant.

    Args:
        time: times of the samples [s], strictly increasing; they need not be even.
        values: one row per sample.
        at: instants [s] in any order; outside `time` the outermost polynomial extrapolates.
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
    """Lagrange's weights of the nodes around each instant: ℓ_j = Π (t − t_i) / (t_j − t_i)."""
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
        time: times of the samples [s], with the same origin for all signals of a recording.
        values: one row per sample, one column per channel.
    """

    time: Times
    values: Values


def merged(
    names: Iterable[str], parts: Iterable[Sequence[Signal]], where: str
) -> tuple[Signal, list[bool]]:
    """Merge signals at the instants of the fastest one.

    The fastest signal, and signals with the same stamps, keep their values; others are
    interpolated, without their doubled and late samples. Instants before the start, after the end
    or in a hole of another signal are dropped, so a hole of any signal is one of the recording.

    Args:
        names, where: names of the signals and of the recording, for messages.
        parts: consecutive parts of each signal.

    Returns:
        All channels in the given order, and whether each signal has exactly these instants.

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
            later = are_later(signal.time)
            signals[k] = Signal(signal.time[later], signal.values[later])
            # Samples must lie close before and after an instant.
            time = signals[k].time
            after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
            close = time[after] - time[after - 1] < GAP * _period(time)
            keep &= (at >= time[0]) & (at <= time[-1]) & (close | (time[after] == at))
    values = [
        signal.values[keep] if is_same else interpolate(signal.time, signal.values, at[keep])
        for signal, is_same in zip(signals, same, strict=True)
    ]
    return Signal(at[keep], np.hstack(values)), same


def are_later(time: Times) -> Bool[np.ndarray, " samples"]:
    """Whether the stamp of each sample is later than all before it."""
    return np.append(True, time[1:] > np.maximum.accumulate(time)[:-1])


def _period(time: Times) -> float:
    steps = np.diff(time)
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else np.inf


def longest_hole(rate: float, cutoff: float) -> int:
    """Largest number of consecutive missing rows that are bridged, at a rate and cut-off [Hz].

    Samples around such a hole are at most a quarter of a period of the cut-off apart, which is an
    eighth of a period of the fastest motion. A polynomial of degree 7 through eight samples that
    far apart has an error below 2e-4 of that motion.
    """
    return max(1, int(rate / (4 * cutoff)) - 1)


def segments(
    batches: Iterable[Rows], clock: Clock, longest: int, columns: Columns
) -> Iterator[Iterator[Rows]]:
    """Samples of each segment, in blocks. Consume a segment before the next one.

    Args:
        batches: all rows of the recording, columns as in `Columns.all`; weights may follow.
        clock: times of the rows.
        longest: most missing rows that are bridged.
        columns: columns of the rows.
    """
    if clock.steady:
        yield iter(batches)
        return
    for _, parts in groupby(_parts(batches, clock, longest), key=lambda part: part[0]):
        yield _samples(parts, clock, longest, columns)


def _parts(batches: Iterable[Rows], clock: Clock, longest: int) -> Iterator[_Part]:
    """Consecutive rows of each segment, without excluded rows."""
    cuts = clock.cuts(longest)
    steps, begins = np.where(cuts, 0, clock.lost), [np.nan, *clock.until[cuts].tolist()]
    number = start = 0
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
        pieces = zip(*(np.split(x, ends) for x in (rows, lost, kept)), strict=True)
        for k, (values, missing, used) in enumerate(pieces):
            number += k > 0
            if used.any():
                yield number, begins[number], values[used], missing[used]
        start = stop


def _samples(
    parts: Iterable[_Part], clock: Clock, longest: int, columns: Columns
) -> Iterator[Rows]:
    """Samples of a segment; rows wait in memory until later neighbours are read."""
    reach = SIDE * (longest + 1)  # largest distance of rows that interpolate a row
    waiting, places, begin, given = np.zeros((0, 0)), np.zeros(0), np.nan, 0
    sampled = _interpolated if clock.even is False else _bridged
    states = slice(columns.sensor_places.stop, columns.extra_places.stop)
    next_place = 0.0
    for part in chain(parts, [None]):
        ready = len(places)
        if part is not None:
            _, until, rows, lost = part
            if not len(places):
                begin = float(rows[0, 0]) if np.isnan(until) else until
            if clock.even is False:
                new = (rows[:, 0] - begin) / clock.period
            else:
                new = next_place + np.cumsum(1 + lost) - 1.0
                next_place = float(new[-1]) + 1
            waiting = np.concatenate([waiting, rows]) if waiting.size else rows
            places = np.concatenate([places, new])
            ready = len(places) - reach
            if ready <= 2 * reach:
                continue
        stop = int(places[-1]) + 1 if part is None else int(places[ready])
        wanted, given = np.arange(given, stop, dtype=float), stop
        out = sampled(waiting, places, wanted, columns)
        before = np.clip(np.searchsorted(places, wanted, side="right") - 1, 0, None)
        out[:, states] = waiting[before, states]
        out[:, 0] = begin + clock.period * wanted
        yield out
        kept = slice(max(ready - reach, 0), None)
        waiting, places = waiting[kept], places[kept]


def _interpolated(rows: Rows, places: Places, wanted: Places, columns: Columns) -> Rows:
    weights = slice(columns.extra_places.stop, None)
    out = interpolate(places, rows, wanted)
    after = np.clip(np.searchsorted(places, wanted), 1, len(places) - 1)
    near = places[after] - places[after - 1] < GAP
    out[:, weights] = np.minimum(rows[after - 1, weights], rows[after, weights]) * near[:, None]
    out[~near, columns.sensor_places] = np.nan
    return out


def _bridged(rows: Rows, places: Places, wanted: Places, columns: Columns) -> Rows:
    """Existing rows at the wanted places, and polynomials across holes."""
    at = np.searchsorted(places, wanted)
    out = rows[at]
    holes = np.flatnonzero(places[at] != wanted)
    if holes.size and len(places) < 2 * SIDE:  # a segment that is too short to be used
        for k in range(out.shape[1]):
            out[holes, k] = np.interp(wanted[holes], places, rows[:, k])
    elif holes.size:
        under = _about(places, at[holes])
        weights = weights_at(places[under], wanted[holes])
        out[holes] = np.einsum("np,npc->nc", weights, rows[under])
    out[holes, columns.extra_places.stop :] = 0.0
    out[holes, columns.sensor_places] = np.nan
    return out


def _about(places: Places, after: Int[np.ndarray, " holes"]) -> Int[np.ndarray, "holes points"]:
    """Rows that interpolate each missing sample, as far apart as the hole is wide, so that the
    polynomial does not oscillate; `after` is the row after the hole."""
    points = 2 * SIDE
    room = np.minimum(after - 1, len(places) - 1 - after) // (SIDE - 1)
    apart = np.clip((places[after] - places[after - 1]).astype(int), 1, np.maximum(1, room))
    steps = apart[:, None] * np.arange(SIDE)
    under = np.hstack([(after - 1)[:, None] - steps[:, ::-1], after[:, None] + steps])
    near = np.clip(after - SIDE, 0, len(places) - points)[:, None] + np.arange(points)
    return np.where((room < 1)[:, None], near, under)
