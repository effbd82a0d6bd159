"""Recordings in memory as rows in which further friction terms are looked for.

Rows are masked as the fit's are, reversals of joints included. What a friction law lacks and a lag
of the torques look alike, so next to the robot's own columns there is one free lag for each drive
of each recording: −τ̇ of the model. Whatever else is looked for, columns are without what all these
explain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.contest import surprise
from deltaid.effects.joint import Joint, Shape, joint_columns, joints_of
from deltaid.effects.lag_columns import LagColumns, alone
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import DriveRows
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import level_along
from deltaid.estimation.span import Columns, Rows, Span
from deltaid.estimation.trace_rows import parameters_of
from deltaid.estimation.traces import Trace, trace
from deltaid.recording.recording import Recording
from deltaid.recording.windows import WINDOW

# Windows of all recordings together at least, and seconds of each, that are looked at.
_WINDOWS, _SECONDS = 6, 20.0
# Rows keep what positions hold up to this frequency [Hz]: laws differ where joints turn round, and
# in quick motions that is above what masses need.
_CUTOFF = 50.0
# What is left of a drive's torque at least, as a share of its largest, to be compared with.
_FLOOR = 1e-5


@dataclass(frozen=True, eq=False)
class Judged:
    """What columns explain.

    Attributes:
        gain: by what share the squared error falls.
        times: what they explain as a multiple of what chance explains, in amplitude.
        surprise: how unlikely that is by chance, in decades.
        after: the rows that are left.
    """

    gain: float
    times: float
    surprise: float
    after: Rows


@dataclass(frozen=True, eq=False)
class FrictionRows:
    """Rows of some recordings, one drive under the other, in units of each drive's noise.

    Attributes:
        dynamics: of the robot as described.
        traces: the recordings.
        largest: torque of each drive.
        Y: active columns of the regressor, all recordings after each other.
        beside: columns of additions, and of a lag for each drive of each recording.
        drive_rows: how samples of drives stand under each other, over the noise of each.
        span: what parameters and lags explain.
        tau: torques.
        p: parameters by least squares; where torques leave these open, near the prior.
        moved: of each drive, as `Joint.moved`.
    """

    dynamics: Dynamics
    traces: tuple[Trace, ...]
    largest: Float[np.ndarray, " dof"]
    Y: Float[np.ndarray, "dof samples columns"]
    beside: Columns
    drive_rows: DriveRows
    span: Span
    tau: Rows
    p: Parameters
    moved: Float[np.ndarray, " dof"]

    @cached_property
    def left(self) -> Rows:
        """What parameters and lags leave of the torques."""
        return self.span.without(self.tau)

    @cached_property
    def rigid(self) -> Span:
        """What lags, additions and all parameters but those of friction explain."""
        layout, Y = self.dynamics.layout, self.Y.copy()
        friction = np.arange(len(layout.names))[layout.friction]
        Y[:, :, np.isin(active_columns(self.dynamics), friction)] = 0.0
        return Span.of(self.drive_rows.stack(Y)).with_columns(self.beside)

    def own(self, name: str) -> Rows:
        """The column of one of the robot's parameters."""
        at = np.searchsorted(active_columns(self.dynamics), self.dynamics.layout.names.index(name))
        return self.drive_rows.stack(self.Y[:, :, at])

    def rotor(self, joint: Joint) -> float:
        """Inertia of a drive's rotor by p; zero without."""
        names, name = self.dynamics.layout.names, f"rotor.{joint.name}"
        return float(self.p[names.index(name)]) if name in names else 0.0

    def share(self, left: Rows) -> float:
        """Root mean square of rows as a share of the drives' largest torques."""
        of_drives = self.drive_rows.of_drives(left) / self.largest[:, None]
        return float(np.sqrt(np.mean(of_drives**2)))

    @cached_property
    def friction(self) -> Float[np.ndarray, "dof samples"]:
        """Torques of the robot's friction [N m or N]."""
        layout, active = self.dynamics.layout, active_columns(self.dynamics)
        own = np.isin(active, np.arange(len(layout.names))[layout.friction])
        return self.Y[:, :, own] @ self.p[active[own]]

    def bare(self, columns: Columns) -> Columns:
        """Without what parameters, additions and lags explain."""
        return self.span.without(columns)

    def judged(self, U: Columns, left: Rows, constants: int) -> "Judged":
        """What orthonormal columns explain of rows, against chance.

        Chance is the scatter of their scores between stretches of time, or white noise where that
        is larger.

        Args:
            constants: that were chosen with them.
        """
        after = left - U @ (U.T @ left)
        gain = float(np.sum((U.T @ left) ** 2))
        freedom = max(len(left) - self.span.rank - U.shape[1], 1)
        level = level_along(U, after, self.drive_rows.groups, freedom)
        return Judged(
            gain=gain / max(float(left @ left), 1e-300),
            times=float(np.sqrt(gain / level)),
            surprise=surprise(gain / level, U.shape[1] + constants),
            after=after,
        )

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """Joints whose friction may have further terms."""
        motion = [one.entries(one.motion()) for one in self.traces]
        found = []
        for one in joints_of(self.dynamics):
            fastest = max(float(one.speed(entries).max()) for entries in motion)
            if fastest > 0:
                moved = 0.0 if one.drive is None else float(self.moved[one.drive])
                found.append(replace(one, fastest=fastest, moved=moved))
        return tuple(found)

    @threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
    def columns(self, wanted: Sequence[tuple[Joint, Shape]]) -> Columns:
        """One column for each shape of a joint, whatever else explains of it."""
        parts = [joint_columns(replace(one, load=self.p), self.p, wanted) for one in self.traces]
        return self.drive_rows.stack(np.concatenate(parts, axis=1))


@threadpool_limits.wrap(limits=1, user_api="blas")
def friction_rows(
    dynamics: Dynamics, recordings: Sequence[Recording], additions: Sequence[Addition] = ()
) -> FrictionRows:
    """The rows of some recordings.

    Args:
        additions: columns that the fit has beside those of the robot, without lags.

    Raises:
        RecordingError: a log is too short or too slow to be differentiated.
    """
    prior, share = prior_parameters(dynamics.robot), 1.0 / len(recordings)
    traces = []
    for one in recordings:
        windows = max(2, round(_WINDOWS * share), round(_SECONDS * one.log.rate / WINDOW * share))
        traces.append(
            trace(
                dynamics,
                one,
                prior,
                cutoff=cutoff_of(one),
                windows=windows,
            )
        )
    Y = np.concatenate([one.regressor() for one in traces], axis=1)
    still = np.zeros(dynamics.dof)
    tau = np.concatenate([one.torques() for one in traces], axis=1)
    largest = np.max([one.log.torque_max for one in recordings], axis=0)
    rows = DriveRows(largest, Y.shape[1])
    left = Span.of(rows.stack(Y)).without(rows.stack(tau)).reshape(dynamics.dof, -1)
    rows = replace(rows, scale=np.maximum(np.sqrt(np.mean(left**2, axis=1)), _FLOOR) * largest)
    span, right = Span.of(rows.stack(Y)), rows.stack(tau)
    off = right - rows.stack(Y @ prior[active_columns(dynamics)])
    p = prior + parameters_of(dynamics, span, off)
    beside = _beside(rows, traces, p, additions)
    span = span.with_columns(beside)
    return FrictionRows(dynamics, tuple(traces), largest, Y, beside, rows, span, right, p, still)


def _beside(
    rows: DriveRows, traces: Sequence[Trace], p: Parameters, additions: Sequence[Addition]
) -> Columns:
    """Columns of additions, and a lag for each drive in each recording."""
    dynamics, found = traces[0].dynamics, []
    own = len(active_columns(dynamics))
    for k, one in enumerate(traces):
        lags = LagColumns(dynamics, (), p, one.recording, alone(dynamics.dof))
        columns = one.regressor((*additions, lags))[:, :, own:]
        width = columns.shape[2] - dynamics.dof
        padded = np.zeros((*columns.shape[:2], width + len(traces) * dynamics.dof))
        padded[:, :, :width] = columns[:, :, :width]
        first = width + k * dynamics.dof
        padded[:, :, first : first + dynamics.dof] = columns[:, :, width:]
        found.append(padded)
    return rows.stack(np.concatenate(found, axis=1))


def cutoff_of(recording: Recording) -> float | None:
    """Of the rows; None for the recording's own."""
    held = recording.motion_cutoff
    return None if held is None else max(recording.cutoff or 0.0, min(held, _CUTOFF))
