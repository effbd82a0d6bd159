"""`Effect`, a physical cause of a difference between a recording and the rigid robot, and `Cause`,
a detected one.

Each effect is in a file of its own; `deltaid.effects.all` lists them. A `DescribedEffect` words its
verdict on the residual; a check of its own judges any other."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from deltaid.effects.account import Account, Contribution
from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.estimation.drive_rows import POSITION_ERROR
from deltaid.estimation.problem import Columns, Rows, Span
from deltaid.model.verdict import Proposal, percent
from deltaid.recording.carried import Load
from deltaid.recording.recording import PreparedRecording

# Share of what a cause explains from which it is that of a single drive.
_MOSTLY = 0.7
# Share of all that is explained from which a cause counts; less may be what the first-order columns
# of another cause leave.
SHARE = 0.15


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
