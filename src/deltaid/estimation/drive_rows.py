"""Filtered samples as rows of a linear problem, drive by drive (`DriveRows`), and rows of traces
over the free parameters of a fit with their prior (`TraceRows`)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import null_space

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.additions import Addition, extended
from deltaid.estimation.information import OfDrives, active_columns
from deltaid.estimation.objective import regularizer
from deltaid.estimation.problem import Columns, LinearProblem, Rows, Span, lengths
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.estimation.traces import Trace
from deltaid.levels import FAINT, NEGLIGIBLE

# Number of stretches of a recording whose scatter gives intervals: many, but each much longer than
# the filter's memory.
STRETCHES = 40
# Least misfit of any recording, as a share of its largest torque.
MISFIT_FLOOR = 1e-5
# Torque that errors of differentiated positions may make, as a share of a drive's largest torque.
POSITION_ERROR = 3e-4

ColumnsOfDrives = Float[np.ndarray, "dof samples _"]
# The same of one of several recordings, which differ in length.
ColumnsOfRecording = Float[np.ndarray, "dof _ _"]


@dataclass(frozen=True, eq=False)
class DriveRows:
    """Stacks samples drive by drive, divided by each drive's scale, such as noise [N m or N]."""

    scale: Float[np.ndarray, " dof"]
    samples: int

    @classmethod
    def by_noise(cls, A: ColumnsOfDrives, b: OfDrives) -> "DriveRows":
        """Rows over the RMS residual of each drive's torques by its own columns."""
        noise = []
        for columns, right in zip(A, b, strict=True):
            active = columns[:, np.any(columns != 0, axis=0)]
            active = active / lengths(active)
            residual = right - active @ np.linalg.lstsq(active, right, rcond=NEGLIGIBLE)[0]
            floor = FAINT * max(float(np.abs(right).max()), np.finfo(float).tiny)
            noise.append(max(float(np.sqrt(np.mean(residual**2))), floor))
        return cls(np.array(noise), b.shape[1])

    def by_misfit(self, A: ColumnsOfDrives, b: OfDrives) -> "DriveRows":
        """Rows over the RMS residual of each drive's b by the columns of all drives together."""
        residual = self.of_drives(Span.of_columns(self.stack(A)).without(self.stack(b)))
        scale = np.maximum(np.sqrt(np.mean(residual**2, axis=1)), MISFIT_FLOOR * self.scale)
        return DriveRows(scale, self.samples)

    def stack(self, x: Float[np.ndarray, "dof samples *k"]) -> np.ndarray:
        return (x.T / self.scale).T.reshape(-1, *x.shape[2:])

    def per_drive(self, x: OfDrives) -> Columns:
        """One column a drive, zero in the rows of other drives."""
        return self.stack(of_own_drives(x[:, :, None]))

    def of_drives(self, rows: Float[np.ndarray, " rows"]) -> OfDrives:
        return rows.reshape(len(self.scale), -1) * self.scale[:, None]

    @cached_property
    def groups(self) -> Int[np.ndarray, " rows"]:
        """The stretch of time of each row; rows of all drives at one time are in one stretch."""
        return np.tile(stretch_numbers(self.samples), len(self.scale))

    def problem(
        self, A: ColumnsOfDrives, b: OfDrives, instruments: Sequence[ColumnsOfDrives] = ()
    ) -> LinearProblem:
        """Least squares, grouped by stretches of time; each set of instruments has columns like
        those of A, but without the noise that these share with b."""
        Z = np.hstack([self.stack(columns) for columns in instruments]) if instruments else None
        return LinearProblem(self.stack(A), self.stack(b), self.groups, Z)


def of_own_drives(own: Float[np.ndarray, "dof samples own"]) -> ColumnsOfDrives:
    """Columns of each drive alone, zero in the rows of others."""
    dof, samples, count = own.shape
    out = np.zeros((dof, samples, dof, count))
    out[np.arange(dof), :, np.arange(dof)] = own
    return out.reshape(dof, samples, dof * count)


def side_by_side(own: Sequence[ColumnsOfRecording]) -> list[ColumnsOfRecording]:
    """Columns of each recording, padded with zeros for the coefficients of the others."""
    width = own[0].shape[2]
    ends = [(k * width, (len(own) - 1 - k) * width) for k in range(len(own))]
    return [np.pad(A, ((0, 0), (0, 0), end)) for A, end in zip(own, ends, strict=True)]


def from_mean(drives: int) -> Float[np.ndarray, "drives differences"]:
    """Independent deviations of drives from their mean: orthonormal columns, each with sum 0."""
    return null_space(np.ones((1, drives)))


def stretch_starts(samples: int) -> Int[np.ndarray, " stretches"]:
    """First samples of `STRETCHES` stretches of equal length; of fewer for fewer samples."""
    return np.unique(np.arange(STRETCHES) * samples // STRETCHES)


def stretch_numbers(samples: int) -> Int[np.ndarray, " samples"]:
    return np.searchsorted(stretch_starts(samples), np.arange(samples), side="right") - 1


@dataclass(frozen=True, eq=False)
class RecordingRows:
    """Rows of one recording: torques less their known part, over the free parameters x and
    additional ones; instruments as of `DriveRows.problem`."""

    A: ColumnsOfDrives
    tau: OfDrives
    instruments: tuple[ColumnsOfDrives, ...] = ()

    def with_columns(self, *columns: ColumnsOfDrives) -> "RecordingRows":
        return replace(self, A=np.concatenate([self.A, *columns], axis=2))

    @property
    def problem(self) -> LinearProblem:
        """Least squares of these rows alone, over the noise of each drive."""
        return DriveRows.by_noise(self.A, self.tau).problem(self.A, self.tau, self.instruments)


@dataclass(frozen=True, eq=False)
class TraceRows:
    """Poses rows of traces over the free parameters x of a fit with additions, p = A x + p_0, with
    a prior of relative standard deviation `spread`."""

    dynamics: Dynamics
    additions: tuple[Addition, ...]
    active: Int[np.ndarray, " columns"]
    reduction: Reduction
    spread: float

    @classmethod
    def for_dynamics(
        cls, dynamics: Dynamics, additions: Sequence[Addition], spread: float
    ) -> "TraceRows":
        added = [(addition.parameters, addition.free) for addition in additions]
        active = active_columns(extended(dynamics, additions))
        reduction = build_reduction(dynamics.robot, active, added)
        return cls(dynamics, tuple(additions), active, reduction, spread)

    @property
    def size(self) -> int:
        return self.reduction.size

    def of_trace(self, trace: Trace) -> RecordingRows:
        Y, active = trace.regressor(self.additions), self.active
        tau = trace.torques() - Y @ self.reduction.p_0[active]
        return RecordingRows(Y @ self.reduction.A[active], tau)

    def prior(self, width: int) -> tuple[Columns, Rows]:
        """The prior as rows D x = d over `width` columns."""
        known = regularizer(self.reduction).quadratic
        D = np.pad(known.R / self.spread, ((0, 0), (0, width - self.size)))
        return D, known.b / self.spread

    def problem(
        self,
        recordings: Sequence[RecordingRows],
        mean: Float[np.ndarray, " additional"] | None = None,
        deviation: Float[np.ndarray, " additional"] | None = None,
    ) -> LinearProblem:
        """Least squares over recordings with the same columns, with the prior of the parameters and
        that of the first additional columns, mean ± deviation, if given."""
        width = recordings[0].A.shape[2]
        D, d = self.prior(width)
        if mean is not None and deviation is not None:
            known = np.eye(width)[self.size : self.size + len(deviation)] / deviation[:, None]
            D, d = np.vstack([D, known]), np.concatenate([d, mean / deviation])
        return LinearProblem.together([rows.problem for rows in recordings]).with_known(D, d)

    def parameters(self, x: Float[np.ndarray, " columns"]) -> Parameters:
        """p of the robot and of additions, by x; additional columns are ignored."""
        return self.reduction.A @ x[: self.size] + self.reduction.p_0

    def robot_parameters(self, recordings: Sequence[RecordingRows]) -> Parameters:
        """p of the robot alone, by least squares over recordings as of `problem`."""
        x = self.problem(recordings).x
        return self.parameters(x)[: len(self.dynamics.layout.names)]


def parameters_of(dynamics: Dynamics, span: Span, b: Rows) -> Parameters:
    """p of least squares by the span of the active columns; zero where torques do not depend on
    it."""
    p = np.zeros(len(dynamics.layout.names))
    p[active_columns(dynamics)] = span.coefficients(b)
    return p
