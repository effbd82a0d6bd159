"""The effects of a residual that count, each with all that it explains."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.effects.contest import Account, Explained
from deltaid.effects.rigid_fit import Candidate, RigidFit
from deltaid.estimation.drive_rows import POSITION_ERROR
from deltaid.estimation.span import Span

# A cause counts if it explains this share of all that is explained; smaller ones may be what the
# first-order columns of another one leave.
SHARE = 0.15


@dataclass(frozen=True, eq=False)
class Cause:
    """An effect that was detected, with all that it explains.

    Attributes:
        fit, account: where, and beside what else.
        found: its candidates, in the order they were detected.
        rms: of what it explains in each drive's torque [N m or N].
    """

    kind: str
    fit: RigidFit
    account: Account
    found: tuple[Explained, ...]
    rms: Float[np.ndarray, " dof"]

    @property
    def first(self) -> Candidate:
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
    total = sum(part.gain for part in account.found)
    largest = np.abs(fit.model).max(axis=1)
    causes = []
    for kind in dict.fromkeys(part.candidate.kind for part in account.found):
        parts = tuple(part for part in account.found if part.candidate.kind == kind)
        added = np.sum([part.directions @ (part.directions.T @ fit.tau) for part in parts], axis=0)
        rms = np.sqrt(np.mean(fit.rows.of_drives(added) ** 2, axis=1))
        if sum(part.gain for part in parts) > SHARE * total and np.any(
            rms > POSITION_ERROR * largest
        ):
            causes.append(Cause(kind, fit, account, parts, rms))
    return causes
