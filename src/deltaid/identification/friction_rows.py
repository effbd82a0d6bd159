"""Recordings in memory as rows in which further friction terms are searched.

Rows are masked as the fit's are, reversals of joints included. What a friction law lacks and a lag
of the torques look alike, so next to the robot's own columns there is one free lag for each drive
of each recording: −τ̇ of the model. All columns that are searched are without what these explain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.joint import FrictionJoint, Shape
from deltaid.effects.lag_columns import LagColumns
from deltaid.effects.lag_groups import alone
from deltaid.effects.point import Point, points_of
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import POSITION_ERROR, DriveRows
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import level_along
from deltaid.estimation.scatter import surprise
from deltaid.estimation.span import Columns, Rows, Span
from deltaid.estimation.trace_rows import parameters_of
from deltaid.estimation.traces import Trace, trace
from deltaid.recording.recording import Recording
from deltaid.recording.windows import WINDOW

# Windows of all recordings together at least, and seconds of each, that are used.
_WINDOWS, _SECONDS = 6, 20.0
# Rows keep what positions hold up to this frequency [Hz]: laws differ where joints turn round, and
# in quick motions that is above what masses need.
_CUTOFF = 50.0


@dataclass(frozen=True, eq=False)
class Judged:
    """What columns explain of rows, against chance."""

    directions: Columns  # the columns, orthonormal
    gain: float  # by what share the squared error falls
    times: float  # what they explain as a multiple of what chance explains, in amplitude
    surprise: float  # how unlikely that is by chance, in decades
    error: float  # what they leave, as a share of the drives' largest torques
    is_large: bool  # whether they explain more than the error of differentiated positions


@dataclass(frozen=True, eq=False)
class FrictionRows:
    """Rows of some recordings, one drive under the other, in units of each drive's noise."""

    dynamics: Dynamics
    points: tuple[Point, ...]  # the recordings at parameters of least squares
    largest: Float[np.ndarray, " dof"]  # torque of each drive
    # active columns of the regressor, all recordings after each other
    Y: Float[np.ndarray, "dof samples columns"]
    # columns of additions, and of a lag for each drive of each recording
    extra: Float[np.ndarray, "rows extra"]
    drive_rows: DriveRows
    span: Span  # what parameters and `extra` explain
    tau: Rows
    p: Parameters  # by least squares; where torques leave these open, near the prior
    moved: Float[np.ndarray, " dof"]  # of each drive, as `FrictionJoint.moved`

    @cached_property
    def residual(self) -> Rows:
        """Torques without what parameters and lags explain."""
        return self.span.without(self.tau)

    @cached_property
    def rigid(self) -> Span:
        """What lags, additions and all parameters but those of friction explain."""
        active, friction = active_columns(self.dynamics), self.dynamics.layout.friction
        is_friction = (friction.start <= active) & (active < friction.stop)
        Y = np.where(is_friction, 0.0, self.Y)
        return Span.of(self.drive_rows.stack(Y)).with_columns(self.extra)

    @cached_property
    def friction(self) -> Float[np.ndarray, "dof samples"]:
        """Torques of the robot's friction [N m or N]."""
        p = np.zeros_like(self.p)
        p[self.dynamics.layout.friction] = self.p[self.dynamics.layout.friction]
        return self.Y @ p[active_columns(self.dynamics)]

    def own(self, name: str) -> Rows:
        """The column of one of the robot's parameters."""
        k = np.searchsorted(active_columns(self.dynamics), self.dynamics.layout.names.index(name))
        return self.drive_rows.stack(self.Y[:, :, k])

    def share(self, residual: Rows) -> float:
        """Root mean square of rows as a share of the drives' largest torques."""
        of_drives = self.drive_rows.of_drives(residual) / self.largest[:, None]
        return float(np.sqrt(np.mean(of_drives**2)))

    def judged(self, U: Columns, residual: Rows, constants: int) -> Judged:
        """What orthonormal columns explain of rows, `constants` of them chosen beside.

        Chance is the scatter of their scores between stretches of time, or white noise where that
        is larger.
        """
        scores = U.T @ residual
        after, gain = residual - U @ scores, float(scores @ scores)
        freedom = max(len(residual) - self.span.rank - U.shape[1], 1)
        level = level_along(U, after, self.drive_rows.groups, freedom)
        return Judged(
            directions=U,
            gain=gain / max(float(residual @ residual), 1e-300),
            times=float(np.sqrt(gain / level)),
            surprise=surprise(gain / level, U.shape[1] + constants),
            error=self.share(after),
            is_large=self.share(residual - after) > POSITION_ERROR,
        )

    @cached_property
    def joints(self) -> dict[str, FrictionJoint]:
        """Joints whose friction may have further terms."""
        moved = dict(zip(self.dynamics.robot.drives, self.moved.tolist(), strict=True))
        joints = self.points[0].joints
        return {j.name: replace(j, moved=moved.get(j.name, 0.0)) for j in joints}

    @threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
    def columns(self, shapes: Sequence[tuple[FrictionJoint, Shape]]) -> Columns:
        """One column for each shape of a joint."""
        if not shapes:
            return np.zeros((len(self.tau), 0))
        parts = [point.of_joints(shapes) for point in self.points]
        return self.drive_rows.stack(np.concatenate(parts, axis=1))


@threadpool_limits.wrap(limits=1, user_api="blas")
def friction_rows(
    dynamics: Dynamics, recordings: Sequence[Recording], additions: Sequence[Addition] = ()
) -> FrictionRows:
    """The rows of some recordings, for a fit with additions of which none is a lag.

    Raises:
        RecordingError: a log is too short or too slow to be differentiated.
    """
    prior, share = prior_parameters(dynamics.robot), 1.0 / len(recordings)
    traces = list[Trace]()
    for recording in recordings:
        long = _SECONDS * recording.log.rate / WINDOW
        windows = max(2, round(_WINDOWS * share), round(long * share))
        cutoff = cutoff_of(recording)
        traces.append(trace(dynamics, recording, prior, cutoff=cutoff, windows=windows))
    Y = np.concatenate([trace.regressor() for trace in traces], axis=1)
    torques = np.concatenate([trace.torques() for trace in traces], axis=1)
    largest = np.max([recording.log.torque_max for recording in recordings], axis=0)
    rows = DriveRows(largest, Y.shape[1]).by_misfit(Y, torques)
    span, tau = Span.of(rows.stack(Y)), rows.stack(torques)
    off = tau - rows.stack(Y @ prior[active_columns(dynamics)])
    p = prior + parameters_of(dynamics, span, off)
    lags = [LagColumns(dynamics, (), p, record.recording, alone(dynamics.dof)) for record in traces]
    parts = [record.regressor((*additions, *lags))[:, :, Y.shape[2] :] for record in traces]
    extra = rows.stack(np.concatenate(parts, axis=1))
    span, still = span.with_columns(extra), np.zeros(dynamics.dof)
    points = tuple(points_of([replace(record, load=p) for record in traces], p))
    return FrictionRows(dynamics, points, largest, Y, extra, rows, span, tau, p, still)


def cutoff_of(recording: Recording) -> float | None:
    """Of the rows [Hz]; None for the recording's own."""
    held = recording.motion_cutoff
    return None if held is None else max(recording.cutoff or 0.0, min(held, _CUTOFF))
