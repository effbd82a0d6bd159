"""Validation of proposed corrections: a proposal is kept only if it lowers held-out torque errors.

All proposals of the verdicts on a recording are tried together, then without each one; those that
improve nothing are dropped. Their verdicts stay, and say that no change of the files explains them.

The criterion is the torque error in held-out stretches of time: of 40 stretches the odd ones are
fitted and the even ones predicted, and vice versa. In addition to the robot's parameters, a fit may
have first-order columns of what an identification corrects by itself: lags of all drives, friction
as a free curve over speed, by direction, by load and while it warms up, torque constants, gears
that wind up. It gets those causes that lower the error beyond chance. If these explain as much with
no more causes, the files are not changed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve
from scipy.special import stdtrit
from threadpoolctl import threadpool_limits

from deltaid.checks.evidence import Evidence, evidence
from deltaid.checks.verdicts import Verdicts, files_of
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.compliance import LITTLE
from deltaid.effects.effect import SHARE
from deltaid.effects.lag_columns import late
from deltaid.effects.windings import Windings, free_friction, friction_causes, motors_of
from deltaid.errors import DeltaidError, RecordingError
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import STRETCHES, DriveRows, of_own_drives, stretch_starts
from deltaid.estimation.problem import Columns, Rows, lengths
from deltaid.estimation.scatter import CHANCE
from deltaid.estimation.traces import Trace
from deltaid.identification.gains import SPREAD
from deltaid.identification.study import rigid_fit, studied_trace
from deltaid.levels import HARDLY, WIDER
from deltaid.model.verdict import Grade, Verdict

_NO_CHANGE = (
    "no change of the files explains this: with the lines that would correct it, errors of torques "
    "that were held out do not fall"
)

# Mean square of each drive's error in each stretch, as a share of the mean square of its torques.
Squares = Float[np.ndarray, "dof stretches"]
# Whether the first of two errors supports its proposals.
_Judge = Callable[["HeldOut", "HeldOut"], bool]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of a recording's held-out torques.

    Attributes:
        of_causes: errors with some corrections fitted as well.
        causes: corrections that lower the errors beyond chance.
    """

    of_causes: Callable[[tuple[int, ...]], Squares]
    causes: tuple[int, ...]

    @cached_property
    def squares(self) -> Squares:
        """Errors with these causes fitted."""
        return self.of_causes(self.causes)

    def same(self, other: "HeldOut") -> bool:
        """Whether both explain the torques equally well but for rounding."""
        plain, of_other = (each.of_causes(()).mean(axis=1) for each in (self, other))
        return bool(np.all(np.abs(plain / of_other - 1.0) < HARDLY))

    def as_good(self, other: "HeldOut") -> bool:
        """Whether its errors are not larger than another's beyond chance."""
        return not _smaller(other.squares, self.squares)

    def better(self, other: "HeldOut") -> bool:
        """Whether it explains more than another one, or as much with fewer causes.

        More than chance, and more than the residual of first-order columns of corrections.
        """
        if len(self.causes) < len(other.causes) and self.as_good(other):
            return _smaller(self.squares, other.of_causes(self.causes))
        errors = self.squares, other.squares, other.of_causes(())
        mean, others, plain = (squares.mean(axis=1) for squares in errors)
        smaller = np.minimum(mean, others)
        explained, together = np.sum((others - mean) / smaller), np.sum((plain - mean) / smaller)
        return bool(explained > SHARE * together) and _smaller(self.squares, other.squares)


def _smaller(squares: Squares, others: Squares) -> bool:
    """Whether errors are smaller than others beyond chance: Student's t of the differences over
    stretches, drives weighted by the smaller of their errors."""
    gains = (1.0 / np.minimum(squares.mean(axis=1), others.mean(axis=1))) @ (others - squares)
    clear = float(stdtrit(len(gains) - 1, 1.0 - CHANCE))
    return bool(gains.mean() > clear * gains.std(ddof=1) / np.sqrt(len(gains)))


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def held_out(record: Evidence) -> HeldOut | None:
    """Held-out errors of a recording with its files unchanged; None for too few rows."""
    if isinstance(setup := record.setup, RecordingError):
        return None
    trace = studied_trace(record.dynamics, setup.recordings[0], prior_parameters(record.robot))
    halves = None if trace is None else _halves(trace, setup.additions)
    if halves is None:
        return None
    best, causes, others = halves.squares(()), (), set(range(len(halves.ends)))
    while others:
        weights = 1.0 / best.mean(axis=1)
        trials = {cause: halves.squares((*causes, cause)) for cause in sorted(others)}
        cause = min(trials, key=lambda cause: float(np.sum(weights @ trials[cause])))
        if not _smaller(trials[cause], best):
            break
        best, causes, others = trials[cause], (*causes, cause), others - {cause}
    return HeldOut(halves.squares, causes)


@dataclass(frozen=True, eq=False)
class _Halves:
    """Rows of a recording in two halves of its stretches, each predicted from the other."""

    rows: DriveRows
    columns: Columns  # of unit length: the robot's, then those of each correction
    b: Rows  # torques over their noise
    ends: tuple[int, ...]  # of the robot's columns, and of each correction's but the last

    def squares(self, causes: tuple[int, ...]) -> Squares:
        """Errors of fits of the robot and some causes, each in the half that was held out.

        A prior that does not depend on units keeps coefficients to possible sizes.
        """
        robot, *others = np.split(np.arange(self.columns.shape[1]), self.ends)
        used = np.concatenate([robot, *(others[cause] for cause in causes)])
        # Rows have a noise of one, and a column's coefficient is the length of what it explains. A
        # correction explains as much as a torque constant does; columns of the robot cancel.
        prior = np.where(used < len(robot), WIDER, SPREAD) * np.linalg.norm(self.b)
        A, residual, odd = self.columns[:, used], np.empty_like(self.b), self.rows.groups % 2 == 1
        for half in (odd, ~odd):
            H = A[half].T @ A[half] + np.diag(prior**-2.0)
            x = solve(H, A[half].T @ self.b[half], assume_a="pos")
            residual[~half] = self.b[~half] - A[~half] @ x
        starts = stretch_starts(self.rows.samples)
        errors, torques = (self.rows.of_drives(rows) ** 2 for rows in (residual, self.b))
        sums = np.add.reduceat(errors, starts, axis=1) / torques.mean(axis=1, keepdims=True)
        return sums / np.diff(starts, append=self.rows.samples)


def _halves(trace: Trace, declared: Sequence[Addition]) -> _Halves | None:
    """Rows of a recording with declared loads; None if they are too few."""
    log, dynamics, low_pass = trace.recording.log, trace.dynamics, trace.low_pass
    Y = trace.regressor()
    rows = DriveRows(log.torque_max, Y.shape[1])
    p = rigid_fit(trace, Y, rows).p
    motors = motors_of(dynamics.robot, p, low_pass.cutoff, low_pass.rate)
    winding = Windings.modelled(trace, motors, p)
    trace, tau = winding.trace, winding.trace.torques()
    if tau.shape[1] < STRETCHES:
        return None
    friction, steps = free_friction(trace, p), np.diag(LITTLE / rows.scale)
    parts = [
        trace.regressor(declared),
        late(trace, p),
        *(friction[:, :, part] for part in friction_causes(dynamics.dof)),
        of_own_drives(trace.model(p)[:, :, None]),
        winding.slopes(0 * rows.scale, steps, p),
    ]
    A = np.concatenate(parts, axis=2)
    rows = DriveRows(rows.scale, tau.shape[1]).by_misfit(A, tau)
    columns, ends = rows.stack(A), np.cumsum([part.shape[2] for part in parts[:-1]])
    return _Halves(rows, columns / lengths(columns), rows.stack(tau), tuple(ends.tolist()))


def confirmed(record: Evidence, verdicts: Sequence[Verdict]) -> tuple[Verdict, ...]:
    """Verdicts on a recording, with those proposals that explain it better than the files, or that
    its rows cannot decide."""
    return _with_useful(record, verdicts, lambda new, old: new.same(old) or new.better(old))


def not_refuted(record: Evidence, verdicts: Sequence[Verdict]) -> tuple[Verdict, ...]:
    """Verdicts on a description, with those proposals that do not explain a recording worse."""
    return _with_useful(record, verdicts, HeldOut.as_good)


def _with_useful(
    record: Evidence, verdicts: Sequence[Verdict], judge: _Judge
) -> tuple[Verdict, ...]:
    kept = _useful(record, [verdict for verdict in verdicts if verdict.proposals], judge)

    def with_lines(verdict: Verdict) -> Verdict:
        if verdict.proposals and verdict not in kept:
            grade = min(verdict.grade, Grade.DOUBTFUL, key=list(Grade).index)
            return replace(verdict, grade=grade, cause="", cure=_NO_CHANGE, proposals=())
        written = tuple(proposal for proposal in verdict.proposals if proposal.is_written)
        return verdict if written == verdict.proposals else replace(verdict, proposals=written)

    return tuple(map(with_lines, verdicts))


def _useful(record: Evidence, proposing: Sequence[Verdict], judge: _Judge) -> list[Verdict]:
    """Verdicts whose proposals help together with those of the others kept."""
    if not proposing:
        return []

    def helps(proposed: HeldOut | None, files: HeldOut | None) -> bool:
        """Whether to keep a proposal; if only one side can be fitted, it wins."""
        if proposed is None or files is None:
            return proposed is not None or files is None
        return judge(proposed, files)

    kept, files, best = list(proposing), _error(record, ()), _error(record, proposing)
    while len(kept) > 1:
        # Of two proposals that exclude each other, the first is kept.
        fewer = ((_error(record, [v for v in kept if v is not last]), last) for last in kept[::-1])
        spare = next((trial for trial in fewer if not helps(best, trial[0])), None)
        if spare is None:
            break
        best, dropped = spare
        kept.remove(dropped)
    return kept if helps(best, files) else []


def _error(record: Evidence, verdicts: Sequence[Verdict]) -> HeldOut | None:
    """Held-out errors with all proposals of verdicts; None if the changed files cannot be used."""
    try:
        if not verdicts:
            return held_out(record)
        proposed = Verdicts(verdicts, record.robot, [record.source], [record.mapping])
        mapping = proposed.cured_columns() if "mapping" in files_of(verdicts) else record.mapping
        return held_out(evidence(proposed.cured_robot(), record.source, mapping, record.settings))
    except DeltaidError:
        return None
