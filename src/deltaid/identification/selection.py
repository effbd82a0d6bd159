"""Selection of the effects that the rows of a contest need: elimination of the least surprising
candidate, exchange of candidates, and fits that the rows do not separate from the selected one."""

from collections.abc import Iterator

import numpy as np

from deltaid.effects.unexplained import is_unexplained
from deltaid.estimation.drive_rows import POSITION_ERROR
from deltaid.estimation.shrinkage import Shrunk

# Logarithm of the odds from which one of two fits is certain.
CERTAIN_ODDS = float(np.log(100.0))


def reduced(full: Shrunk, least: float) -> Shrunk:
    """A fit with the candidates that rows need beside all others.

    The least surprising is dropped first, until all exceed `least` [decades]; then kept candidates
    are exchanged for others, one for one, or one is added again, in place of those that it makes
    needless, while the rows become more probable: each of several may be needless only beside
    others that are dropped later. A candidate that is smaller than the torque that no effect
    explains may be a part of it and is dropped, either from the start or only once all others are
    surprising, whichever makes the rows more probable.
    """
    now = _eliminated(full, least, by_size=True)
    if any(map(is_unexplained, full.candidates)):
        size_last = _eliminated(_eliminated(full, least, by_size=False), least, by_size=True)
        now = max(now, size_last, key=lambda fit: fit.evidence)
    while better := [*rivals(full, now, least, 0.0).values(), *_enlarged(full, now, least)]:
        now = max(better, key=lambda fit: fit.evidence)
    return now


def _enlarged(full: Shrunk, now: Shrunk, least: float) -> Iterator[Shrunk]:
    """More probable fits with one more candidate than `now`, in place of those without which, one
    after the other, the rows stay more probable than with `now`."""
    for name, trial in suspects(full, now).items():
        beside: Shrunk | None = trial
        while beside and (beside is trial or beside.evidence > now.evidence):
            needed = _eliminated(beside, least, by_size=True)
            after = full.of_candidates(needed.candidates)
            if set(needed.candidates) != set(now.candidates) and after.evidence > now.evidence:
                yield after
            beside = _without_cheapest(beside, np.inf, by_size=True, spared=name)


def _eliminated(now: Shrunk, least: float, *, by_size: bool) -> Shrunk:
    """Drop the least surprising candidate until all exceed `least`."""
    while fewer := _without_cheapest(now, least, by_size=by_size):
        now = fewer
    return now


def _without_cheapest(
    now: Shrunk, least: float, *, by_size: bool, spared: str = ""
) -> Shrunk | None:
    """Drop the least surprising candidate but the `spared` one; None if it exceeds `least`. Those
    that errors of positions may be count as not surprising, and with `by_size` those smaller than
    the unexplained torque."""
    unexplained = [now.size(group) for group in now.groups if is_unexplained(group.name)]
    least_named = max(POSITION_ERROR, by_size * float(np.linalg.norm(unexplained)))
    prices = dict[str, float]()
    for group in now.droppable:
        if group.name == spared:
            continue
        least_size = POSITION_ERROR if is_unexplained(group.name) else least_named
        is_so = now.size(group) > least_size and group.allows(now.x, now.covariance)
        prices[group.name] = now.surprise(group) if is_so else 0.0
    cheapest = min(prices, key=prices.__getitem__, default="")
    if prices.get(cheapest, least) >= least:
        return None
    return now.of_candidates([name for name in now.candidates if name != cheapest])


def rivals(
    full: Shrunk, now: Shrunk, least: float, more: float = -CERTAIN_ODDS
) -> dict[tuple[str, str], Shrunk]:
    """Fits with one candidate of `now` exchanged, by the kept candidate and the other one, whose
    evidence exceeds that of `now` by `more`: by default, those that rows do not separate."""
    dropped = [
        name for name in full.candidates if not (name in now.candidates or is_unexplained(name))
    ]
    trials = {
        (candidate.name, other): full.of_candidates(
            [other, *(name for name in now.candidates if name != candidate.name)]
        )
        for candidate in now.droppable if not is_unexplained(candidate.name) for other in dropped
    }  # fmt: skip
    return {
        pair: trial for pair, trial in trials.items()
        if trial.evidence > now.evidence + more and trial.least_surprising >= least
        and all(group.allows(trial.x, trial.covariance) for group in trial.groups)
    }  # fmt: skip


def suspects(full: Shrunk, now: Shrunk) -> dict[str, Shrunk]:
    """Fits with one more candidate than `now`, by this candidate, where physics allows it."""
    dropped = [
        group.name for group in full.droppable
        if not (group.name in now.candidates or is_unexplained(group.name))
    ]  # fmt: skip
    trials = {name: full.of_candidates([*now.candidates, name]) for name in dropped}
    return {
        name: trial
        for name, trial in trials.items()
        for group in trial.groups
        if group.name == name and group.allows(trial.x, trial.covariance)
    }
