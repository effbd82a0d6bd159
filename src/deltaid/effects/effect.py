"""`Effect`, a physical cause of a difference between a recording and the rigid robot, and the
search for effects in a residual, by the one that explains most beyond chance, step by step.

Each effect is in a file of its own; `deltaid.effects.all` lists them. A study asks all for columns,
`account` decides which explain more than chance, and a `DescribedEffect` words its verdict."""

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

# A candidate is detected where chance explains as much once in 10^6 recordings; in decades.
DETECTED = 6.0
# Share of the best candidate's gain from which a preferred one takes its place.
_NEARLY = 0.9
# Number of best candidates whose scatter is computed, and of candidates that are taken at most.
_CLOSE, _ROUNDS = 4, 5
# Share of what a cause explains from which it is that of a single drive.
_MOSTLY = 0.7
# Share of all that is explained from which a cause counts; less may be what the first-order columns
# of another cause leave.
SHARE = 0.15


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
        beside: rank of the explained span.
        tries: decimal logarithm of the number of candidates that it was chosen from.
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
        """What it explains, with the noise level by rows or, if larger, by scatter between
        stretches of time."""
        U = self.A @ self.basis
        own = Explanation.by_columns(U, self.residual, groups, self.beside)
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


@dataclass(frozen=True, eq=False)
class Cause:
    """A detected effect, with all that it explains."""

    kind: str
    fit: RigidFit  # of the recording
    account: Account  # of all effects that were detected there
    detected: tuple[Contribution, ...]  # those of this effect, in the order of the account
    rms: Float[np.ndarray, " dof"]  # of each drive's torque that it explains [N m or N]

    @property
    def first(self) -> EffectCandidate:
        return self.detected[0].candidate

    @property
    def shares(self) -> Float[np.ndarray, " dof"]:
        """`rms` as a share of the standard deviation of each drive's torque."""
        return self.rms / np.maximum(self.fit.model.std(axis=1), 1e-300)

    @property
    def others(self) -> Span:
        """Span of the parameters and all other causes."""
        span = self.fit.span
        for explained in self.account.detected:
            if explained.candidate.kind != self.kind:
                span = span.with_columns(explained.directions)
        return span


def causes_of(fit: RigidFit, account: Account) -> list[Cause]:
    """Detected effects that explain a large share, and more than errors of positions may."""
    total = sum(part.gain for part in account.detected)
    least = POSITION_ERROR * np.abs(fit.model).max(axis=1)
    causes = []
    for kind in dict.fromkeys(part.candidate.kind for part in account.detected):
        parts = tuple(part for part in account.detected if part.candidate.kind == kind)
        added = np.sum([part.directions @ (part.directions.T @ fit.tau) for part in parts], axis=0)
        rms = np.sqrt(np.mean(fit.rows.of_drives(added) ** 2, axis=1))
        if sum(part.gain for part in parts) > SHARE * total and np.any(rms > least):
            causes.append(Cause(kind, fit, account, parts, rms))
    return causes


class Effect:
    """A physical cause. A check of its own judges it, unless it is a `DescribedEffect`."""

    kind: ClassVar[str]
    is_contested: ClassVar[bool] = False  # whether only the contest of causes can correct it

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        """Columns that it adds to the torques, to first order."""
        return ()

    def search(self, fit: RigidFit) -> Callable[[Rows], Iterable[EffectCandidate]]:
        """The same where columns depend on the residual: a function of it."""
        return lambda residual: ()

    def held(self, cause: Cause, recording: PreparedRecording) -> Load | None:
        """The load that this cause is, with the times it is held; None if it is none or these are
        unknown."""
        return None

    def of_each(
        self, subjects: Sequence[str], columns: Columns, words: str = ""
    ) -> Iterable[EffectCandidate]:
        """A candidate for each subject's column, and one for all."""
        for i, subject in enumerate(subjects):
            yield EffectCandidate(self.kind, subject, columns[:, [i]], words)
        yield EffectCandidate(self.kind, "", columns, words)


class DescribedEffect(Effect):
    """An effect with a verdict on the residual: what was detected, the likeliest cause, the fix."""

    likeliest: ClassVar[str] = ""
    fix: ClassVar[str] = ""
    follows: ClassVar[str] = "the position"  # what the torques vary with

    @property
    def key(self) -> str:
        return self.kind

    def subject(self, cause: Cause) -> str:
        """The drive or joint with the effect; empty for all."""
        named = cause.first.subject
        if named and all(part.candidate.subject in ("", named) for part in cause.detected):
            return named
        for trial in cause.account.first:
            if trial.candidate.kind == cause.kind and trial.candidate.subject:
                mostly = trial.gain > _MOSTLY * cause.detected[0].gain
                return trial.candidate.subject if mostly else ""
        return ""

    def finding(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        """A number, its unit, and a sentence on what was detected.

        Args:
            subject: the drive or joint; empty for all.
            share: of the torque of the drive with the largest one.
        """
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
