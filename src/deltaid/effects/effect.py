"""What an effect is: a physical cause of a difference between a recording and the rigid robot; and
which effects a residual shows: those that explain more of it than chance, the best first.

Everything that is particular to a cause is in a file of its own; `deltaid.effects.all` lists them.
A study asks each effect for its columns, `account` decides which explain more than chance; an
effect that no other check judges words what was detected of it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.estimation.drive_rows import POSITION_ERROR
from deltaid.estimation.problem import Columns, Explanation, Rows, Span, independent, lengths
from deltaid.estimation.scatter import surprise
from deltaid.model.verdict import Proposal, percent
from deltaid.recording.carried import Load
from deltaid.recording.recording import PreparedRecording

# A candidate is detected where chance gives one like it once in so many decades of recordings.
SEEN = 6.0
# A preferred candidate is taken where it explains nearly as much as the best; one that bends with
# the place, such as a zero, only where the best has more columns and, unless that bends too, does
# not leave less than half: to first order zeros may look like a drive's factor or offset.
_NEARLY = 0.9
# Of so many candidates the scatter is computed, and so many are taken at most.
_CLOSE, _ROUNDS = 4, 5
# The share that a single drive explains of what all do, where it is about this one.
_MOSTLY = 0.7
# A cause counts if it explains this share of all that is explained; smaller ones may be what the
# first-order columns of another one leave.
SHARE = 0.15


@dataclass(frozen=True, eq=False)
class Contribution(Explanation):
    """What a candidate explains of a residual.

    Attributes:
        surprise: minus the decimal logarithm of the probability that noise explains as much to one
            of all that were tried.
    """

    candidate: EffectCandidate
    surprise: float


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
        tries = float(np.log10(len(columns)))
        trials = [
            _Trial(candidate, A, basis, residual, span.rank, candidate.tries + tries)
            for candidate, A in zip([*candidates, *more], columns, strict=True)
            if (basis := independent(A)).shape[1]
        ]
        ranked = _ranked(trials, groups)
        first = first or tuple(ranked)
        if not ranked or ranked[0].surprise < SEEN:
            break
        detected.append(ranked[0])
        U, residual = ranked[0].directions, ranked[0].left
        bare = [A - U @ (U.T @ A) for A in bare]
        span = span.with_directions(U)
    return Account(tuple(detected), span, residual, first)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A candidate beside what has been explained.

    Attributes:
        A: its columns, less what has been explained, whose rank is `beside`.
        basis: orthonormal combinations of them.
        residual: what is to be explained.
        tries: of how many candidates it is one, as a decimal logarithm.
    """

    candidate: EffectCandidate
    A: Columns
    basis: Float[np.ndarray, "columns rank"]
    residual: Rows
    beside: int
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
        return after / max(len(self.residual) - self.beside - self.rank, 1)

    def surprise(self, level: float) -> float:
        return surprise(self.gain / level, self.rank) - self.tries

    def explained(self, groups: Int[np.ndarray, " rows"]) -> Contribution:
        """With the noise by its scatter between stretches of time where that is larger."""
        U = self.A @ self.basis
        own = Explanation.by_columns(U, self.residual, groups, self.beside)
        more = self.surprise(max(self.noise, own.level))
        return Contribution(U, self.gain, own.left, own.level, self.candidate, more)


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
    much_more = trial.total - trial.gain > 2.0 * max(best.total - best.gain, 0.0)
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


@dataclass(frozen=True, eq=False)
class Cause:
    """An effect that was detected, with all that it explains."""

    kind: str
    # fit, account: where, and beside what else
    fit: RigidFit
    account: Account
    found: tuple[Contribution, ...]  # its candidates, in the order they were detected
    rms: Float[np.ndarray, " dof"]  # of what it explains in each drive's torque [N m or N]

    @property
    def first(self) -> EffectCandidate:
        return self.found[0].candidate

    @property
    def shares(self) -> Float[np.ndarray, " dof"]:
        """Of each drive's rms torque without its mean."""
        return self.rms / np.maximum(self.fit.model.std(axis=1), 1e-300)

    @property
    def others(self) -> Span:
        """What parameters and all other causes explain."""
        span = self.fit.span
        for explained in self.account.found:
            if explained.candidate.kind != self.kind:
                span = span.with_columns(explained.directions)
        return span


def causes_of(fit: RigidFit, account: Account) -> list[Cause]:
    """The effects of a residual that count."""
    total = sum(part.gain for part in account.found)
    least = POSITION_ERROR * np.abs(fit.model).max(axis=1)
    causes = []
    for kind in dict.fromkeys(part.candidate.kind for part in account.found):
        parts = tuple(part for part in account.found if part.candidate.kind == kind)
        added = np.sum([part.directions @ (part.directions.T @ fit.tau) for part in parts], axis=0)
        rms = np.sqrt(np.mean(fit.rows.of_drives(added) ** 2, axis=1))
        if sum(part.gain for part in parts) > SHARE * total and np.any(rms > least):
            causes.append(Cause(kind, fit, account, parts, rms))
    return causes


class Effect:
    """A cause, called `kind`; another check judges it, unless it is a `DescribedEffect`."""

    kind: ClassVar[str]
    # whether nothing but the contest of causes corrects what it is of
    is_contested: ClassVar[bool] = False

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        """Columns that it would add to the torques, to first order, known beforehand."""
        return ()

    def search(self, fit: RigidFit) -> Callable[[Rows], Iterable[EffectCandidate]]:
        """A search for columns in the residual torques."""
        return lambda residual: ()

    def held(self, cause: Cause, recording: PreparedRecording) -> Load | None:
        """The load that a cause is, and when it is held; None for no load, or where that is not
        known."""
        return None

    def of_each(
        self, subjects: Sequence[str], columns: Columns, words: str = ""
    ) -> Iterable[EffectCandidate]:
        """A candidate for each subject's column, and one for all."""
        for i, subject in enumerate(subjects):
            yield EffectCandidate(self.kind, subject, columns[:, [i]], words)
        yield EffectCandidate(self.kind, "", columns, words)


class DescribedEffect(Effect):
    """A cause that a verdict on the residual is about."""

    likeliest: ClassVar[str] = ""  # its likeliest cause in words, where that is always the same
    fix: ClassVar[str] = ""  # what to do about it
    follows: ClassVar[str] = "the position"  # what torques follow, where `seen` says this

    @property
    def key(self) -> str:
        return self.kind

    def subject(self, cause: Cause) -> str:
        """The drive or joint that it is about; empty for all."""
        named = cause.first.subject
        if named and all(part.candidate.subject in ("", named) for part in cause.found):
            return named
        for trial in cause.account.first:
            if trial.candidate.kind == cause.kind and trial.candidate.subject:
                mostly = trial.gain > _MOSTLY * cause.found[0].gain
                return trial.candidate.subject if mostly else ""
        return ""

    def seen(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        """A number, its unit, and what was detected in words, for the drive or joint `subject` and
        the share that it makes of the torque of the drive that has most of it."""
        part = f"{percent(share)} of {torque_of(subject)} follows {self.follows}"
        return 100 * share, "%", f"{part} and is not explained: {cause.first.words}"

    def why(self, cause: Cause) -> str:
        return self.likeliest

    def cure(self, cause: Cause) -> str:
        return self.fix

    def proposals(self, cause: Cause, recording: PreparedRecording) -> tuple[Proposal, ...]:
        return ()


def torque_of(subject: str) -> str:
    return f"{subject}'s torque" if subject else "the torques"
