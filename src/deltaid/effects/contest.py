"""Which effects a residual shows: those that explain more of it than chance, the best first."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammaincc, gammaln

from deltaid.effects.scene import Candidate
from deltaid.estimation.problem import level_along
from deltaid.estimation.span import Rows, Span, lengths

# Directions of columns shorter than this share of their length have been taken by parameters.
_TAKEN = 1e-3
# A candidate is detected where chance gives one like it once in so many decades of recordings.
SEEN = 6.0
# A preferred one is taken where it explains nearly as much as the best; one that bends with the
# place, such as a zero, only where the best has more columns and, unless that bends too, does not
# leave much less: to first order zeros may look like a drive's factor or offset.
_NEARLY, _MUCH_LESS = 0.9, 0.5
# Of so many candidates the scatter is looked at, and so many are taken at most.
_CLOSE, _ROUNDS = 4, 5


@dataclass(frozen=True, eq=False)
class Explained:
    """What a candidate explains of a residual.

    Attributes:
        candidate: which.
        gain: how much of the sum of squares.
        surprise: minus the decimal logarithm of the probability that noise explains as much to one
            of all that were tried.
        directions: orthonormal columns of what parameters leave of it.
    """

    candidate: Candidate
    gain: float
    surprise: float
    directions: Float[np.ndarray, "rows rank"]


@dataclass(frozen=True, eq=False)
class Account:
    """All effects of a residual, in the order they were found.

    Attributes:
        found: each with what it adds to those before.
        span: of parameters and effects.
        left: what remains.
        first: how surprising each candidate is on its own, the best first.
    """

    found: tuple[Explained, ...]
    span: Span
    left: Rows
    first: tuple[Explained, ...]


def account(
    candidates: Sequence[Candidate],
    searched: Callable[[Rows], Iterable[Candidate]],
    groups: Int[np.ndarray, " rows"],
    span: Span,
    left: Rows,
) -> Account:
    """Take the most surprising candidate, and again of what it leaves, until none is.

    Args:
        candidates: with columns that are known beforehand.
        searched: those that depend on what is left.
        groups: the stretch of time of each row.
        span: what parameters explain.
        left: what they leave.
    """
    found: list[Explained] = []
    first: tuple[Explained, ...] = ()
    bare = [span.without(_scaled(one.columns)) for one in candidates]
    for _ in range(_ROUNDS):
        more = tuple(searched(left))
        columns = [*bare, *(span.without(_scaled(one.columns)) for one in more)]
        tried = zip([*candidates, *more], columns, strict=True)
        ranked = _ranked([(one, F) for one, F in tried], groups, span, left)
        first = first or tuple(ranked)
        if not ranked or ranked[0].surprise < SEEN:
            break
        best = ranked[0]
        found.append(best)
        U = best.directions
        left = left - U @ (U.T @ left)
        bare = [F - U @ (U.T @ F) for F in bare]
        span = span.with_directions(U)
    return Account(tuple(found), span, left, first)


def _ranked(
    candidates: Sequence[tuple[Candidate, Float[np.ndarray, "rows _"]]],
    groups: Int[np.ndarray, " rows"],
    span: Span,
    left: Rows,
) -> list[Explained]:
    """The candidates that explain anything, the most surprising first.

    One that explains hardly less with fewer columns goes first. The noise is that of what they
    leave or, for the first few, its scatter between stretches of
    time if that is larger.
    """
    count, total = len(candidates), float(left @ left)
    judged = []
    for candidate, F in candidates:
        values, vectors = np.linalg.eigh(F.T @ F)
        kept = values > _TAKEN**2
        if not kept.any():
            continue
        by = vectors[:, kept] / np.sqrt(values[kept])
        gain, rank = float(np.sum((by.T @ (F.T @ left)) ** 2)), by.shape[1]
        freedom = max(len(left) - span.rank - rank, 1)
        noise = max(total - gain, 1e-12 * total, 1e-300) / freedom
        tries = candidate.tries + float(np.log10(count))
        judged.append((surprise(gain / noise, rank) - tries, gain, noise, tries, candidate, F, by))
    judged.sort(key=lambda one: -one[0])
    if judged:
        best, enough, most = judged[0], _NEARLY * judged[0][1], judged[0][6].shape[1]
        much = np.inf if best[4].bends else max(total - best[1], 0.0) / _MUCH_LESS
        judged.sort(
            key=lambda one: (
                not one[4].is_preferred
                or one[1] < enough
                or (one[4].bends and (one[6].shape[1] >= most or total - one[1] > much))
            )
        )
    close = []
    for _, gain, noise, tries, candidate, F, by in judged[:_CLOSE]:
        U = F @ by
        freedom = max(len(left) - span.rank - U.shape[1], 1)
        level = max(noise, level_along(U, left - U @ (U.T @ left), groups, freedom))
        close.append(Explained(candidate, gain, surprise(gain / level, U.shape[1]) - tries, U))
    if close and close[0].candidate.is_preferred and close[0].surprise > SEEN:
        return close
    close.sort(key=lambda one: -one.surprise)
    if close:
        simplest = _simplest(close, total, len(left))
        close = [simplest, *(one for one in close if one is not simplest)]
    return close


def _simplest(ranked: Sequence[Explained], total: float, rows: int) -> Explained:
    """The first, or one of fewer columns that leaves hardly more (Bayesian information)."""
    best = ranked[0]
    for one in ranked[1:]:
        fewer = best.directions.shape[1] - one.directions.shape[1]
        if fewer > 0 and one.surprise > SEEN:
            more = (total - one.gain) / max(total - best.gain, 1e-300)
            if rows * np.log(max(more, 1e-300)) < 2 * fewer * np.log(rows):
                best = one
    return best


def _scaled(columns: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
    return columns / lengths(columns)


def surprise(x: float, freedom: int) -> float:
    """−log₁₀ of the probability that χ² exceeds x, also where that is too small for a number."""
    a, half = 0.5 * freedom, 0.5 * x
    tail = float(gammaincc(a, half))
    if tail > 1e-280:
        return -float(np.log10(tail)) if a > 0 else 0.0
    return float((half - (a - 1) * np.log(half) + gammaln(a)) / np.log(10))
