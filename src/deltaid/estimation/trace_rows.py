"""Filtered rows of recordings in memory over the free parameters of a fit, and their prior."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.additions import Addition, extended
from deltaid.estimation.drive_rows import ColumnsOfDrives, DriveRows, OfDrives
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import Columns, LinearProblem, Rows, Span
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.estimation.regularizer import Metric
from deltaid.estimation.traces import Trace


@dataclass(frozen=True, eq=False)
class RecordingRows:
    """Rows of one recording: torques less their known part, over the free parameters x and
    additional ones; instruments as of `DriveRows.problem`."""

    A: ColumnsOfDrives
    tau: OfDrives
    instruments: tuple[ColumnsOfDrives, ...] = ()

    @property
    def problem(self) -> LinearProblem:
        """Least squares of these rows alone, over the noise of each drive."""
        return DriveRows.by_noise(self.A, self.tau).problem(self.A, self.tau, self.instruments)


@dataclass(frozen=True, eq=False)
class TraceRows:
    """What rows of traces are over: the free parameters x of a fit with additions, p = A x + p_0,
    and what is known of them, by a prior of relative standard deviation `spread`."""

    dynamics: Dynamics
    additions: tuple[Addition, ...]
    active: Int[np.ndarray, " columns"]
    reduction: Reduction
    spread: float

    @classmethod
    def of(cls, dynamics: Dynamics, additions: Sequence[Addition], spread: float) -> "TraceRows":
        added = [(addition.parameters, addition.free) for addition in additions]
        active = active_columns(extended(dynamics, additions))
        reduction = build_reduction(dynamics.robot, active, added)
        return cls(dynamics, tuple(additions), active, reduction, spread)

    @property
    def size(self) -> int:
        return self.reduction.size

    def of_trace(self, trace: Trace, beside: Sequence[Addition] = ()) -> RecordingRows:
        """Rows of a trace, with additional columns."""
        Y, active = trace.regressor((*self.additions, *beside)), self.active
        fit, added = Y[:, :, : len(active)], Y[:, :, len(active) :]
        tau = trace.torques() - fit @ self.reduction.p_0[active]
        return RecordingRows(np.concatenate([fit @ self.reduction.A[active], added], axis=2), tau)

    def prior(self, width: int) -> tuple[Columns, Rows]:
        """What is known of parameters, as rows D x = d over so many columns."""
        known = Metric().regularizer(self.reduction).quadratic
        D = np.pad(known.R / self.spread, ((0, 0), (0, width - self.size)))
        return D, known.b / self.spread

    def problem(
        self,
        recordings: Sequence[RecordingRows],
        mean: Float[np.ndarray, " beside"] | None = None,
        deviation: Float[np.ndarray, " beside"] | None = None,
    ) -> LinearProblem:
        """Least squares over recordings with the same columns together, with the prior of the
        parameters, and mean and deviation of additional columns where known."""
        width = recordings[0].A.shape[2]
        D, d = self.prior(width)
        if mean is not None and deviation is not None:
            known = np.eye(width)[self.size :] / deviation[:, None]
            D, d = np.vstack([D, known]), np.concatenate([d, mean / deviation])
        return LinearProblem.together([rows.problem for rows in recordings]).with_known(D, d)

    def parameters(self, x: Float[np.ndarray, " columns"]) -> Parameters:
        """p of the robot and of additions, for x with additional columns."""
        return self.reduction.A @ x[: self.size] + self.reduction.p_0


def parameters_of(dynamics: Dynamics, span: Span, b: Rows) -> Parameters:
    """p of least squares, for the span of the active columns; zero where nothing is shown."""
    p = np.zeros(len(dynamics.layout.names))
    p[active_columns(dynamics)] = span.coefficients(b)
    return p
