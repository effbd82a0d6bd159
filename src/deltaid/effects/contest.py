"""Which effects a residual shows: those that explain more of it than chance, the best first."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.effects.point import EffectCandidate
from deltaid.estimation.problem import Columns, Rows, Span, independent, lengths, level_along
from deltaid.estimation.scatter import surprise

# A candidate is detected where chance gives one like it once in so many decades of recordings.
SEEN = 6.0
# A preferred candidate is taken where it explains nearly as much as the best; one that bends with
# the place, such as a zero, only where the best has more columns and, unless that bends too, does
# not leave much less: to first order zeros may look like a drive's factor or offset.
_NEARLY, _MUCH_LESS = 0.9, 0.5
# Of so many candidates the scatter is computed, and so many are taken at most.
_CLOSE, _ROUNDS = 4, 5


@dataclass(frozen=True, eq=False)
class Contribution:
    """What a candidate explains of a residual.

    Attributes:
        gain: how much of the sum of squares.
        surprise: minus the decimal logarithm of the probability that noise explains as much to one
            of all that were tried.
        directions: orthonormal columns of what parameters leave of it.
    """

    candidate: EffectCandidate
    gain: float
    surprise: float
    directions: Columns

    @property
    def rank(self) -> int:
        return self.directions.shape[1]


@dataclass(frozen=True, eq=False)
class Account:
    """All effects of a residual, in the order they were detected.

    Attributes:
        found: each with what it adds to those before.
        span: of parameters and effects.
        left: what remains.
        first: how surprising each candidate is on its own, the best first.
    """

    found: tuple[Contribution, ...]
    span: Span
    left: Rows
    first: tuple[Contribution, ...]


def account(
    candidates: Sequence[EffectCandidate],
    searched: Callable[[Rows], Iterable[EffectCandidate]],
    groups: Int[np.ndarray, " rows"],
    span: Span,
    residual: Rows,
) -> Account:
    """Take the most surprising candidate, and again of what it leaves, until none is.

    Args:
        candidates: with columns that are known beforehand.
        searched: those that depend on the residual.
        groups: the stretch of time of each row.
        span: what parameters explain.
        residual: what they leave.
    """
    detected, first = list[Contribution](), tuple[Contribution, ...]()

    def unexplained(tried: Sequence[EffectCandidate]) -> list[Columns]:
        """Columns of unit length, without what is explained."""
        return [span.without(candidate.columns / lengths(candidate.columns)) for candidate in tried]

    bare = unexplained(candidates)
    for _ in range(_ROUNDS):
        more = tuple(searched(residual))
        columns = [*bare, *unexplained(more)]
        tries, freedom = float(np.log10(len(columns))), len(residual) - span.rank
        trials = [
            _Trial(candidate, A, basis, residual, freedom, candidate.tries + tries)
            for candidate, A in zip([*candidates, *more], columns, strict=True)
            if (basis := independent(A)).shape[1]
        ]
        ranked = _ranked(trials, groups)
        first = first or tuple(ranked)
        if not ranked or ranked[0].surprise < SEEN:
            break
        detected.append(ranked[0])
        U = ranked[0].directions
        residual = residual - U @ (U.T @ residual)
        bare = [A - U @ (U.T @ A) for A in bare]
        span = span.with_directions(U)
    return Account(tuple(detected), span, residual, first)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A candidate beside what has been explained.

    Attributes:
        A: its columns, less what has been explained.
        basis: orthonormal combinations of them.
        residual: what is to be explained.
        freedom: rows less the rank of what has been explained.
        tries: of how many candidates it is one, as a decimal logarithm.
    """

    candidate: EffectCandidate
    A: Columns
    basis: Float[np.ndarray, "columns rank"]
    residual: Rows
    freedom: int
    tries: float

    @cached_property
    def gain(self) -> float:
        return float(np.sum((self.basis.T @ (self.A.T @ self.residual)) ** 2))

    @cached_property
    def total(self) -> float:
        return float(self.residual @ self.residual)

    @property
    def rank(self) -> int:
        return self.basis.shape[1]

    @property
    def noise(self) -> float:
        """Variance of what it leaves."""
        after = max(self.total - self.gain, 1e-12 * self.total, 1e-300)
        return after / max(self.freedom - self.rank, 1)

    def surprise(self, level: float) -> float:
        """For noise of some variance."""
        return surprise(self.gain / level, self.rank) - self.tries

    def explained(self, groups: Int[np.ndarray, " rows"]) -> Contribution:
        """With the noise by its scatter between stretches of time where that is larger."""
        U = self.A @ self.basis
        after = self.residual - U @ (U.T @ self.residual)
        along = level_along(U, after, groups, max(self.freedom - self.rank, 1))
        return Contribution(self.candidate, self.gain, self.surprise(max(self.noise, along)), U)


def _ranked(trials: Sequence[_Trial], groups: Int[np.ndarray, " rows"]) -> list[Contribution]:
    """What trials explain, the most surprising first.

    One that explains hardly less with fewer columns goes first; so does a preferred one.
    """
    if not trials:
        return []
    ranked = sorted(trials, key=lambda trial: -trial.surprise(trial.noise))
    best = ranked[0]
    ranked.sort(key=lambda trial: not _is_taken_before(trial, best))
    close = [trial.explained(groups) for trial in ranked[:_CLOSE]]
    if close[0].candidate.is_preferred and close[0].surprise > SEEN:
        return close
    close.sort(key=lambda explained: -explained.surprise)
    simplest = _simplest(close, best.total, len(best.residual))
    return [simplest, *(explained for explained in close if explained is not simplest)]


def _is_taken_before(trial: _Trial, best: _Trial) -> bool:
    """Whether a preferred candidate explains enough to be taken in the place of the best."""
    if not trial.candidate.is_preferred or trial.gain < _NEARLY * best.gain:
        return False
    if not trial.candidate.bends:
        return True
    much_more = trial.total - trial.gain > max(best.total - best.gain, 0.0) / _MUCH_LESS
    return trial.rank < best.rank and (best.candidate.bends or not much_more)


def _simplest(ranked: Sequence[Contribution], total: float, rows: int) -> Contribution:
    """The first, or one of fewer columns that leaves hardly more (Bayesian information)."""
    best = ranked[0]
    for explained in ranked[1:]:
        fewer = best.rank - explained.rank
        if fewer > 0 and explained.surprise > SEEN:
            more = (total - explained.gain) / max(total - best.gain, 1e-300)
            if rows * np.log(max(more, 1e-300)) < 2 * fewer * np.log(rows):
                best = explained
    return best
