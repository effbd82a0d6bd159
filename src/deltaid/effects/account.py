"""The effects that a residual shows: those that explain more of it than chance, the best first.

A study asks all effects for columns; `account` takes the most surprising candidate, then that of
the remaining residual, and so on."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.effects.point import EffectCandidate
from deltaid.estimation.problem import Columns, Explanation, Rows, Span, independent, lengths
from deltaid.estimation.scatter import surprise
from deltaid.levels import NEVER

# Surprise of what chance never explains [decades]: from it, a candidate is detected.
DETECTED = -float(np.log10(NEVER))
# Share of the best candidate's gain from which a preferred one takes its place.
_NEARLY = 0.9
# Number of best candidates whose scatter is computed, and of candidates that are taken at most.
_CLOSE, _ROUNDS = 4, 5


@dataclass(frozen=True, eq=False)
class Contribution(Explanation):
    """What a candidate explains of a residual.

    Attributes:
        surprise: minus the decimal logarithm of the probability that noise alone explains as much
            by any of the candidates that were tried.
    """

    candidate: EffectCandidate
    surprise: float


@dataclass(frozen=True, eq=False)
class Account:
    """All effects that were detected in a residual.

    Attributes:
        detected: what each adds to those before it.
        span: of parameters and effects.
        left: the residual beside all of them.
        first: what the best candidates explain alone, the most surprising first.
    """

    detected: tuple[Contribution, ...]
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
    """Take the most surprising candidate, then that of the remaining residual, until none is
    surprising.

    Args:
        candidates: those whose columns do not depend on the residual.
        searched: makes candidates for a residual.
        groups: the stretch of time of each row.
        span: of the parameters.
        residual: beside the parameters.
    """
    detected, first = list[Contribution](), tuple[Contribution, ...]()

    def unexplained(tried: Sequence[EffectCandidate]) -> list[Columns]:
        """Columns of unit length, less their part in the span."""
        return [span.without(candidate.columns / lengths(candidate.columns)) for candidate in tried]

    bare = unexplained(candidates)
    for _ in range(_ROUNDS):
        more = tuple(searched(residual))
        columns = [*bare, *unexplained(more)]
        tries = float(np.log10(len(columns)))
        trials = [
            _Trial(candidate, A, basis, residual, span.rank, candidate.tries + tries)
            for candidate, A in zip([*candidates, *more], columns, strict=True)
            if (basis := independent(A)).shape[1]
        ]
        ranked = _ranked(trials, groups)
        first = first or tuple(ranked)
        if not ranked or ranked[0].surprise < DETECTED:
            break
        detected.append(ranked[0])
        U, residual = ranked[0].directions, ranked[0].left
        bare = [A - U @ (U.T @ A) for A in bare]
        span = span.with_directions(U)
    return Account(tuple(detected), span, residual, first)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A candidate beside all that is explained already.

    Attributes:
        A: its columns, less their part in the explained span.
        basis: makes an orthonormal basis A @ basis of them.
        explained_rank: rank of the explained span.
        tries: decimal logarithm of the number of candidates that it was chosen from.
    """

    candidate: EffectCandidate
    A: Columns
    basis: Float[np.ndarray, "columns rank"]
    residual: Rows
    explained_rank: int
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
        after = max(self.total - self.gain, 1e-12 * self.total, 1e-300)
        return after / max(len(self.residual) - self.explained_rank - self.rank, 1)

    def surprise(self, level: float) -> float:
        return surprise(self.gain / level, self.rank) - self.tries

    def explained(self, groups: Int[np.ndarray, " rows"]) -> Contribution:
        """What it explains, with the noise level by rows or, if larger, by scatter between
        stretches of time."""
        U = self.A @ self.basis
        own = Explanation.by_columns(U, self.residual, groups, self.explained_rank)
        more = self.surprise(max(self.noise, own.level))
        return Contribution(U, self.gain, own.left, own.level, self.candidate, more)


def _ranked(trials: Sequence[_Trial], groups: Int[np.ndarray, " rows"]) -> list[Contribution]:
    """What the best trials explain, the most surprising first; before it a preferred one, or one
    with fewer columns, that explains hardly less."""
    if not trials:
        return []
    ranked = sorted(trials, key=lambda trial: -trial.surprise(trial.noise))
    best = ranked[0]
    ranked.sort(key=lambda trial: not _is_taken_before(trial, best))
    close = [trial.explained(groups) for trial in ranked[:_CLOSE]]
    if close[0].candidate.is_preferred and close[0].surprise > DETECTED:
        return close
    close.sort(key=lambda explained: -explained.surprise)
    simplest = _simplest(close, best.total, len(best.residual))
    return [simplest, *(explained for explained in close if explained is not simplest)]


def _is_taken_before(trial: _Trial, best: _Trial) -> bool:
    """Whether a candidate is preferred and explains nearly as much as the best.

    One that bends with the place must have fewer columns than the best too and, unless this bends
    as well, leave at most twice as much: to first order zeros look like a drive's factor or offset.
    """
    if not trial.candidate.is_preferred or trial.gain < _NEARLY * best.gain:
        return False
    if not trial.candidate.bends:
        return True
    much_more = trial.total - trial.gain > 2.0 * max(best.total - best.gain, 0.0)
    return trial.rank < best.rank and (best.candidate.bends or not much_more)


def _simplest(ranked: Sequence[Contribution], total: float, rows: int) -> Contribution:
    """The first, or one with fewer columns that leaves hardly more (Bayesian information)."""
    best = ranked[0]
    for explained in ranked[1:]:
        fewer = best.rank - explained.rank
        if fewer > 0 and explained.surprise > DETECTED:
            more = (total - explained.gain) / max(total - best.gain, 1e-300)
            if rows * np.log(max(more, 1e-300)) < 2 * fewer * np.log(rows):
                best = explained
    return best
