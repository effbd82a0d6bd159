"""Which candidates of a fit rows need, and which others might take their places."""

import numpy as np

from deltaid.estimation.drive_rows import POSITION_ERROR
from deltaid.estimation.shrinkage import Shrunk

# Of two fits, one is certain that is a hundred times as probable as the other.
_CERTAIN = float(np.log(100.0))

# A fit with another candidate, by the one that was kept and the one that takes its place.
Exchanges = dict[tuple[str, str], Shrunk]


def reduced(full: Shrunk, least: float) -> Shrunk:
    """A fit with those candidates that rows need beside all others.

    The least surprising is dropped first, until all exceed `least` [decades]; then others take
    the places of what is kept, one for one, where rows are more probable so.
    """
    now = full
    while now.candidates:
        groups = [group for group in now.groups if group.is_candidate]
        prices = {
            group.name: now.surprise(group) if now.size(group) > POSITION_ERROR else 0.0
            for group in groups
        }
        cheapest = min(prices, key=lambda name: prices[name])
        if prices[cheapest] >= least:
            break
        now = now.of_candidates([name for name in prices if name != cheapest])
    while better := _exchanges(full, now, least, 0.0):
        now = max(better.values(), key=lambda fit: fit.evidence)
    return now


def rivals(full: Shrunk, now: Shrunk, least: float) -> Exchanges:
    """Fits with another candidate in the place of one of those of `now` that are so nearly as
    probable that rows do not separate both."""
    return _exchanges(full, now, least, -_CERTAIN)


def _exchanges(full: Shrunk, now: Shrunk, least: float, more: float) -> Exchanges:
    """Those whose evidence exceeds that of a fit by more than this."""
    dropped = [name for name in full.candidates if name not in now.candidates]
    trials = {
        (kept, other): full.of_candidates([other, *(n for n in now.candidates if n != kept)])
        for kept in now.candidates for other in dropped
    }  # fmt: skip
    return {
        pair: trial for pair, trial in trials.items()
        if trial.evidence > now.evidence + more and trial.least_surprising >= least
    }  # fmt: skip
