"""Channels with times of their own, as one at the instants of the fastest.

What is sampled a few times faster than it moves is a polynomial over a handful of samples. Through
the eight nearest of them, whether evenly spaced or not, Lagrange's polynomial errs by less than
3e-5 of a motion's amplitude up to a tenth of the sampling rate, which is as far as positions are
differentiated anyway; and it needs no filter length at the ends.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from deltaid.errors import RecordingError

# Samples under the polynomial, and instants worked on at once.
_POINTS, _CHUNK = 8, 1 << 14
# A channel tells nothing of an instant if its samples about it are this many periods apart.
_HOLE = 4.0
Times = Float[np.ndarray, " samples"]
Instants = Float[np.ndarray, " instants"]
Values = Float[np.ndarray, "samples channels"]


def interpolate(
    time: Times, values: Values, at: Instants
) -> Float[np.ndarray, "instants channels"]:
    """Channels at other instants, by the polynomial of degree 7 through the samples about each.

    Args:
        time: of the samples, strictly increasing [s]; need not be even.
        values: one row a sample.
        at: instants, in any order; outside of `time` the polynomial at the end goes on.
    """
    points = min(_POINTS, len(time))
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


def fastest(signals: Sequence[Signal]) -> int:
    """The signal with most samples a second."""
    return int(np.argmin([_period(signal.time) for signal in signals]))


def merge(
    signals: Sequence[Signal], onto: int | None = None
) -> tuple[Instants, list[Float[np.ndarray, "instants _"]]]:
    """All signals at the instants of one of them.

    Its own values, and those of signals with the same stamps, stay as they are; the others are
    interpolated. Instants of which one of the
    others tells nothing, before its start, after its end, in a hole, are left out, so that a hole
    in any signal is one of the whole recording.

    Args:
        signals: with two samples or more each. Samples that do not come after the one before them
            (doubled, or late) are left out, but for those of the signal of the instants.
        onto: which signal gives the instants; by default the fastest.

    Returns:
        Instants kept [s], and for each signal its values there, in the order given.
    """
    onto = fastest(signals) if onto is None else onto
    at = signals[onto].time
    others = {
        k: _increasing(signal)
        for k, signal in enumerate(signals)
        if not np.array_equal(signal.time, at)
    }
    keep = np.ones(len(at), dtype=bool)
    for signal in others.values():
        keep &= _covered(signal.time, at)
    at = at[keep]
    values = [
        interpolate(others[k].time, others[k].values, at) if k in others else signal.values[keep]
        for k, signal in enumerate(signals)
    ]
    return at, values


def merged(
    names: Iterable[str], parts: Iterable[Sequence[Signal]], where: str
) -> tuple[Signal, list[bool]]:
    """Signals, each in consecutive parts, as one at the instants of the fastest.

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
        columns = [
            np.concatenate(x) for x in zip(*((p.time, p.values) for p in pieces), strict=True)
        ]
        signals.append(Signal(*columns))
    onto = signals[fastest(signals)].time
    time, values = merge(signals)
    return Signal(time, np.hstack(values)), [np.array_equal(x.time, onto) for x in signals]


def _increasing(signal: Signal) -> Signal:
    highest = np.maximum.accumulate(signal.time)
    later = np.concatenate([[True], signal.time[1:] > highest[:-1]])
    return signal if later.all() else Signal(signal.time[later], signal.values[later])


def _period(time: Times) -> float:
    steps = np.diff(time)
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else np.inf


def _covered(time: Times, at: Instants) -> Bool[np.ndarray, " instants"]:
    """Whether there are samples close before and close after each instant."""
    after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    close = time[after] - time[after - 1] < _HOLE * _period(time)
    return (at >= time[0]) & (at <= time[-1]) & (close | (time[after] == at))
