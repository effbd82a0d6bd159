"""What an effect is: a physical cause of a difference between a recording and the rigid robot.

Everything that is particular to a cause is in a file of its own; `deltaid.effects.all` lists them.
A study asks each effect for its columns, and the contest (`contest`) decides which explain more
than chance; an effect that no other check judges words what was detected of it.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from deltaid.effects.contest import Account, Contribution
from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.estimation.drive_rows import POSITION_ERROR
from deltaid.estimation.problem import Columns, Rows, Span
from deltaid.model.verdict import Proposal, percent
from deltaid.recording.carried import Load
from deltaid.recording.recording import PreparedRecording

# The share that a single drive explains of what all do, where it is about this one.
_MOSTLY = 0.7
# A cause counts if it explains this share of all that is explained; smaller ones may be what the
# first-order columns of another one leave.
SHARE = 0.15


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
        """The likeliest cause in words."""
        return self.likeliest

    def proposals(self, cause: Cause, recording: PreparedRecording) -> tuple[Proposal, ...]:
        """Lines of a file that would correct it."""
        return ()


def torque_of(subject: str) -> str:
    """Of a drive, or of all."""
    return f"{subject}'s torque" if subject else "the torques"
