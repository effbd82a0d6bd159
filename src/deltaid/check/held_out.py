"""How well files explain a recording: the torque error of stretches of time that no fit has seen.

Rows of 40 stretches of time are fitted by the odd ones and judged by the even ones, and the other
way round, so every stretch is held out once. Beside the robot's parameters a fit may have columns
of what an identification corrects unasked, to first order: a lag of every drive, friction as a free
curve over its speed, by direction, by load and while it warms up, torque constants, gears that wind
up. It has those causes that make the error smaller beyond chance. What they explain as well, if no
more of them are needed, is no reason to change a file.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve
from scipy.special import stdtrit
from threadpoolctl import threadpool_limits

from deltaid.check.evidence import Evidence
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.windings import Windings, free_friction, friction_causes, late, motors_of
from deltaid.errors import RecordingError
from deltaid.estimation.drive_rows import (
    STRETCHES,
    ColumnsOfDrives,
    DriveRows,
    OfDrives,
    of_own_drives,
    stretch_numbers,
)
from deltaid.estimation.information import active_columns
from deltaid.estimation.span import Columns, Rows, Span, lengths
from deltaid.estimation.trace_rows import parameters_of
from deltaid.estimation.traces import Trace
from deltaid.identification.study import studied_trace

# Chance makes an error fall or rise by so much once in so many comparisons.
_CHANCE = 1e-3
# Errors that differ by less than this share are the same: only the prior judges what made them.
_SAME = 1e-3
# Least share of all that explains a recording beside the robot; less may be what columns of first
# order leave of other causes.
_SHARE = 0.15
# What one column explains, as a share of the torques: of the robot, whose columns cancel each
# other, and of what is corrected, such as a torque constant that is off.
_OF_ROBOT, _CORRECTED = 10.0, 0.1
# How far a gear winds up at a drive's largest torque, for differences [rad or m].
_LITTLE = 1e-4


# Mean square of each drive's error in each stretch, as a share of the mean square of its torques;
# NaN for a stretch without rows.
Squares = Float[np.ndarray, "dof stretches"]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of a recording's torques where they were held out.

    Attributes:
        of_causes: the errors beside some of what is corrected unasked.
        causes: those of it that make errors smaller beyond chance.
    """

    of_causes: Callable[[tuple[int, ...]], Squares]
    causes: tuple[int, ...]

    @cached_property
    def squares(self) -> Squares:
        """Errors beside these causes."""
        return self.of_causes(self.causes)

    def same(self, other: "HeldOut") -> bool:
        """Whether both explain the torques equally well but for rounding."""
        plain, of_other = (np.nanmean(each.of_causes(()), axis=1) for each in (self, other))
        return bool(np.all(np.abs(plain / of_other - 1.0) < _SAME))

    def worse(self, other: "HeldOut") -> bool:
        """Whether its errors are larger than those of another one, beyond chance."""
        return _smaller(other.squares, self.squares)

    def better(self, other: "HeldOut") -> bool:
        """Whether it explains more than another one, or as much with fewer causes.

        More than chance, and more than columns of first order leave of what is corrected unasked.
        """
        if len(self.causes) < len(other.causes) and not self.worse(other):
            return _smaller(self.squares, other.of_causes(self.causes))
        own, others, plain = (
            np.nanmean(squares, axis=1)
            for squares in (self.squares, other.squares, other.of_causes(()))
        )
        smaller = np.minimum(own, others)
        explained, together = np.sum((others - own) / smaller), np.sum((plain - own) / smaller)
        return bool(explained > _SHARE * together) and _smaller(self.squares, other.squares)


def _smaller(squares: Squares, others: Squares) -> bool:
    """Whether errors are smaller than others beyond chance: Student's t of the differences between
    stretches, drives weighted by the smaller of their errors."""
    weights = 1.0 / np.minimum(np.nanmean(squares, axis=1), np.nanmean(others, axis=1))
    gains = weights @ (others - squares)
    gains = gains[np.isfinite(gains)]
    if len(gains) < 2:
        return False
    clear = float(stdtrit(len(gains) - 1, 1.0 - _CHANCE))
    return bool(gains.mean() > clear * gains.std(ddof=1) / np.sqrt(len(gains)))


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def held_out(record: Evidence) -> HeldOut | None:
    """The error of a recording as its files describe it; None where it cannot be computed."""
    recording = record.surveyed
    if isinstance(recording, RecordingError):
        return None
    trace = studied_trace(record.dynamics, recording, prior_parameters(record.robot))
    halves = None if trace is None else _halves(trace, record)
    if halves is None:
        return None
    best, chosen, others = halves.squares(()), list[int](), list(range(len(halves.sizes)))
    while others:
        trials = [(halves.squares((*chosen, cause)), cause) for cause in others]
        weights = 1.0 / np.nanmean(best, axis=1)
        least, cause = min(trials, key=lambda trial: float(np.nansum(weights @ trial[0])))
        if not _smaller(least, best):
            break
        best = least
        chosen.append(cause)
        others.remove(cause)
    return HeldOut(halves.squares, tuple(chosen))


@dataclass(frozen=True, eq=False)
class _Halves:
    """Rows of a recording in two halves of its stretches, each to be fitted and judged by the
    other one.

    Attributes:
        tau: torques [N m or N].
        columns: of unit length: those of the robot, then those of causes that are corrected
            unasked.
        b: torques over their noise.
        own: how many columns are the robot's.
        sizes: how many columns each cause has.
    """

    tau: OfDrives
    rows: DriveRows
    columns: Columns
    b: Rows
    own: int
    sizes: tuple[int, ...]

    def squares(self, causes: tuple[int, ...]) -> Squares:
        """Errors of fits of the robot and some causes, in the half that each has not seen.

        Coefficients are kept to what is possible by a prior that a change of units leaves as it is.
        """
        ends = self.own + np.cumsum([0, *self.sizes])
        of_causes = [np.arange(ends[k], ends[k + 1]) for k in causes]
        used = np.concatenate([np.arange(self.own), *of_causes]).astype(int)
        # Rows have a noise of one, and a column's coefficient is the length of what it explains.
        prior = np.where(used < self.own, _OF_ROBOT, _CORRECTED) * np.linalg.norm(self.b)
        A, left = self.columns[:, used], np.empty_like(self.b)
        for fitted in (self._odd, ~self._odd):
            seen = A[fitted]
            H = seen.T @ seen + np.diag(prior**-2.0)
            left[~fitted] = self.b[~fitted] - A[~fitted] @ solve(
                H, seen.T @ self.b[fitted], assume_a="pos"
            )
        size = np.mean(self.tau**2, axis=1, keepdims=True)
        stretch = stretch_numbers(self.tau.shape[1])
        counts = np.bincount(stretch, minlength=STRETCHES)
        shares = self.rows.of_drives(left) ** 2 / size
        sums = np.stack([np.bincount(stretch, share, STRETCHES) for share in shares])
        return sums / np.where(counts > 0, counts, np.nan)

    @cached_property
    def _odd(self) -> Bool[np.ndarray, " rows"]:
        return self.rows.groups % 2 == 1


def _halves(trace: Trace, record: Evidence) -> _Halves | None:
    """Rows of a recording with what it is declared to hold; None where they are too few."""
    recording, dynamics = trace.recording, trace.dynamics
    rows = DriveRows(recording.log.torque_max, trace.torques().shape[1])
    count = len(active_columns(dynamics))
    span = Span.of(rows.stack(trace.regressor()[:, :, :count]))
    p = parameters_of(dynamics, span, rows.stack(trace.torques()))
    low_pass = trace.low_pass
    motors = motors_of(dynamics.robot, p, low_pass.cutoff, low_pass.rate)
    winding = Windings.modelled(trace, motors, p)
    trace = winding.trace
    tau = trace.torques()
    if tau.shape[1] < STRETCHES:
        return None
    friction = free_friction(trace, p)
    corrected = [
        late(trace, p),
        *(friction[:, :, part] for part in friction_causes(dynamics.dof)),
        of_own_drives(trace.model(p)[:, :, None]),
        _windup(winding, p, rows.scale),
    ]
    robot = trace.regressor(record.additions)
    A = np.concatenate([robot, *corrected], axis=2)
    rows = DriveRows(rows.scale, tau.shape[1]).by_misfit(A, tau)
    columns = rows.stack(A)
    sizes = tuple(columns.shape[2] for columns in corrected)
    return _Halves(tau, rows, columns / lengths(columns), rows.stack(tau), robot.shape[2], sizes)


def _windup(
    winding: Windings, p: Float[np.ndarray, " parameters"], largest: Float[np.ndarray, " dof"]
) -> ColumnsOfDrives:
    """Slopes of predicted less measured torques by the compliance of each gear."""
    steps = np.diag(_LITTLE / largest)
    now, *softer = (winding.turned(s) for s in (0 * largest, *steps))
    before, *after = (turned.model(p) - turned.torques() for turned in (now, *softer))
    return np.stack([error - before for error in after], axis=2) / _LITTLE
