"""What an effect is: a physical cause of a difference between a recording and the rigid robot.

Everything that is particular to a cause is in a file of its own; `deltaid.effects.all` lists them.
A study asks each effect for its columns, and the contest (`contest`) decides which explain more
than chance; an effect that no other check judges words what was detected of it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import ClassVar

from deltaid.effects.cause import Cause
from deltaid.effects.rigid_fit import Candidate, RigidFit
from deltaid.estimation.span import Rows
from deltaid.model.verdict import Proposal
from deltaid.recording.carried import Load
from deltaid.recording.recording import Recording

# The share that a single drive explains of what all do, where it is about this one.
_MOSTLY = 0.7


class Effect:
    """A cause; another check judges it, unless it is a `DescribedEffect`.

    Attributes:
        kind: its name.
    """

    kind: ClassVar[str]

    def candidates(self, fit: RigidFit) -> Iterable[Candidate]:
        """Columns that it would add to the torques, to first order, known beforehand."""
        del fit
        return ()

    def search(self, fit: RigidFit) -> Callable[[Rows], Iterable[Candidate]]:
        """A search for columns in the residual torques."""
        del fit
        return lambda residual: ()

    def held(self, cause: Cause, recording: Recording) -> Load | None:
        """The load that a cause is, and when it is held; None for no load, or where that is not
        known."""
        del cause, recording
        return None


class DescribedEffect(Effect, ABC):
    """A cause that a verdict on the residual is about.

    Attributes:
        likeliest: its likeliest cause in words, where that is always the same.
        fix: what to do about it, where that is always the same.
    """

    likeliest: ClassVar[str] = ""
    fix: ClassVar[str] = ""

    @property
    def key(self) -> str:
        return self.kind

    def subject(self, cause: Cause) -> str:
        """The drive or joint that it is about; empty for all."""
        named = cause.first.subject
        if named and all(part.candidate.subject in ("", named) for part in cause.found):
            return named
        alone = [
            trial for trial in cause.account.first
            if trial.candidate.kind == cause.kind and trial.candidate.subject
        ]  # fmt: skip
        if alone and alone[0].gain > _MOSTLY * cause.found[0].gain:
            return alone[0].candidate.subject
        return ""

    @abstractmethod
    def seen(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        """A number, its unit, and what was detected in words.

        Args:
            subject: the drive or joint.
            share: what it makes of the drive's torque that has most of it.
        """

    def why(self, cause: Cause) -> str:
        """The likeliest cause in words."""
        del cause
        return self.likeliest

    def cure(self, cause: Cause) -> str:
        """What to do about it."""
        del cause
        return self.fix

    def proposals(self, cause: Cause, recording: Recording) -> tuple[Proposal, ...]:
        """Lines of a file that would correct it."""
        del cause, recording
        return ()


def torque_of(subject: str) -> str:
    """Of a drive, or of all."""
    return f"{subject}'s torque" if subject else "the torques"
