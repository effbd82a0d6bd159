"""Rows of recordings in which additional friction terms are searched.

Rows near reversals are excluded, as in the fit. A missing friction term looks like a lag, so each
drive of each recording has a free lag in addition to the robot's columns: −τ̇ of the model.
Candidate columns are projected off all of these.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.joint import (
    FrictionJoint,
    Shape,
    of_load,
    of_slope,
    of_term,
    one_way,
    one_way_speed,
)
from deltaid.effects.lag_columns import late
from deltaid.effects.point import TracePoint, points_of
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import POSITION_ERROR, DriveRows, parameters_of, side_by_side
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import Columns, Explanation, Rows, Span
from deltaid.estimation.scatter import surprise
from deltaid.estimation.traces import Trace, trace
from deltaid.model.parameter_record import AdditionKind, JointTerm
from deltaid.recording.log import SECONDS
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import WINDOW
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction, PowerLaw, Stribeck
from deltaid.robot.friction_terms import friction_terms

# Least number of windows that are used of all recordings together.
_WINDOWS = 6
# Highest cut-off of rows [Hz]: laws differ near reversals, at higher frequencies than masses need.
_CUTOFF = 50.0
# Start values: exponents of the power law; Stribeck's speed as a share of the joint's largest.
_EXPONENTS = (0.25, 0.5, 0.75, 1.5, 2.0, 3.0)
_SPEEDS = tuple(np.geomspace(0.01, 1.0, 10).tolist())
# Stribeck's usual exponents: Tustin's form and Gauss's.
FORMS = (1.0, 2.0)
# Prior size of an additional term as a share of Coulomb's, and of load friction as a share of load.
_SIZE, _LOAD = 0.3, 0.05
# Shares of a rotor's inertia that are tried as its link's: torques determine only their sum, but
# load friction the link's part. Negative shares are of the link's that is the rotor's.
_SHARES = (0.0, -1.0, -0.5, 0.25, 0.5, 0.75, 1.0)

_SHAPES: dict[AdditionKind, tuple[Shape, ...]] = {
    "offset": (one_way,),
    "both_ways": (one_way, one_way_speed),
    "load": (of_load,),
}


@dataclass(frozen=True, eq=False)
class JudgedColumns:
    """What columns explain of rows, compared with chance."""

    directions: Columns  # an orthonormal basis of them
    gain: float  # share by which the squared error falls
    times: float  # amplitude that they explain as a multiple of that by chance
    surprise: float  # [decades]
    error: float  # remaining rms error as a share of the drives' largest torques
    is_large: bool  # whether they explain more than errors of differentiated positions


@dataclass(frozen=True, eq=False)
class FrictionRows:
    """Rows of some recordings, drive by drive, in units of each drive's noise."""

    dynamics: Dynamics
    points: tuple[TracePoint, ...]  # the recordings at parameters of least squares
    largest: Float[np.ndarray, " dof"]  # torque of each drive
    # active columns of the regressor, all recordings after each other
    Y: Float[np.ndarray, "dof samples columns"]
    # columns of additions, and of a lag for each drive of each recording
    extra: Float[np.ndarray, "rows extra"]
    drive_rows: DriveRows
    span: Span  # of parameters and `extra`
    tau: Rows
    p: Parameters  # by least squares, near the prior where torques do not determine them
    # `FrictionJoint.moved` of those drives where it is not zero
    moved: Mapping[str, float] = field(default_factory=dict[str, float])

    @cached_property
    def residual(self) -> Rows:
        return self.span.without(self.tau)

    @cached_property
    def rigid(self) -> Span:
        """Span of lags, additions and all parameters but those of friction."""
        active, friction = active_columns(self.dynamics), self.dynamics.layout.friction
        Y = np.where((friction.start <= active) & (active < friction.stop), 0.0, self.Y)
        return Span.of_columns(self.drive_rows.stack(Y)).with_columns(self.extra)

    @cached_property
    def friction(self) -> Float[np.ndarray, "dof samples"]:
        p = np.zeros_like(self.p)
        p[self.dynamics.layout.friction] = self.p[self.dynamics.layout.friction]
        return self.Y @ p[active_columns(self.dynamics)]

    def column_of(self, name: str) -> Rows:
        k = np.searchsorted(active_columns(self.dynamics), self.dynamics.layout.names.index(name))
        return self.drive_rows.stack(self.Y[:, :, k])

    def share(self, residual: Rows) -> float:
        """Root mean square of rows as a share of the drives' largest torques."""
        of_drives = self.drive_rows.of_drives(residual) / self.largest[:, None]
        return float(np.sqrt(np.mean(of_drives**2)))

    def judged(self, U: Columns, residual: Rows, constants: int) -> JudgedColumns:
        """What orthonormal columns explain of rows; `constants` were chosen with them."""
        own = Explanation.by_columns(U, residual, self.drive_rows.groups, self.span.rank)
        return JudgedColumns(
            directions=U,
            gain=own.gain / max(float(residual @ residual), 1e-300),
            times=float(np.sqrt(own.gain / own.level)),
            surprise=surprise(own.gain / own.level, own.rank + constants),
            error=self.share(own.left),
            is_large=self.share(residual - own.left) > POSITION_ERROR,
        )

    @cached_property
    def joints(self) -> dict[str, FrictionJoint]:
        joints = self.points[0].joints
        return {j.name: replace(j, moved=self.moved.get(j.name, 0.0)) for j in joints}

    @threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
    def columns(self, shapes: Sequence[tuple[FrictionJoint, Shape]]) -> Columns:
        if not shapes:
            return np.zeros((len(self.tau), 0))
        parts = [point.of_joints(shapes) for point in self.points]
        return self.drive_rows.stack(np.concatenate(parts, axis=1))


@threadpool_limits.wrap(limits=1, user_api="blas")
def friction_rows(
    dynamics: Dynamics, recordings: Sequence[PreparedRecording], additions: Sequence[Addition] = ()
) -> FrictionRows:
    """The rows of some recordings with additions, of which none is a lag.

    Raises:
        RecordingError: a log is too short or too slow to be differentiated.
    """
    prior, share, traces = prior_parameters(dynamics.robot), 1.0 / len(recordings), list[Trace]()
    for recording in recordings:
        long = SECONDS * recording.log.rate / WINDOW
        windows = max(2, round(_WINDOWS * share), round(long * share))
        cutoff = cutoff_of(recording)
        traces.append(trace(dynamics, recording, prior, cutoff=cutoff, windows=windows))
    every = np.concatenate([trace.regressor(additions) for trace in traces], axis=1)
    Y, added = np.split(every, [len(active_columns(dynamics))], axis=2)
    torques = np.concatenate([trace.torques() for trace in traces], axis=1)
    largest = np.max([recording.log.torque_max for recording in recordings], axis=0)
    rows = DriveRows(largest, Y.shape[1]).by_misfit(Y, torques)
    span, tau = Span.of_columns(rows.stack(Y)), rows.stack(torques)
    p = prior + parameters_of(dynamics, span, tau - rows.stack(Y @ prior[active_columns(dynamics)]))
    lags = np.concatenate(side_by_side([late(record, p) for record in traces]), axis=1)
    extra = rows.stack(np.concatenate([added, lags], axis=2))
    points = tuple(points_of([replace(record, load=p) for record in traces], p))
    return FrictionRows(dynamics, points, largest, Y, extra, rows, span.with_columns(extra), tau, p)


def cutoff_of(recording: PreparedRecording) -> float | None:
    """Cut-off of rows for friction [Hz]; None for the recording's own."""
    held = recording.motion_cutoff
    return None if held is None else max(recording.cutoff or 0.0, min(held, _CUTOFF))


@dataclass(frozen=True, eq=False)
class Variant:
    """One form of an additional term of a law, or of a change of a described term's constants."""

    joint: FrictionJoint
    kind: AdditionKind
    more: dict[str, Any]  # values of `Friction` that the law gets
    shapes: tuple[Shape, ...]  # of its columns
    constants: int  # number of constants that are chosen with it
    positive: bool  # whether its coefficient must be positive

    @property
    def term(self) -> JointTerm:
        return self.joint.name, self.kind


def options(rows: FrictionRows) -> Iterator[list[Variant]]:
    """All additions to the laws of the robot, each with its variants."""
    robot, names = rows.dynamics.robot, rows.dynamics.layout.names
    for joint in rows.joints.values():
        law, rotor = robot.friction[joint.name], f"rotor.{joint.name}"
        for kind, changes in _changes(joint, law).items():
            joints = [joint]
            if kind == "load" and rotor in names:
                inertia = float(rows.p[names.index(rotor)])
                joints = [replace(joint, moved=share * inertia) for share in _SHARES]
            constants = min(len(joints) * len(changes) - 1, 2 if kind == "stribeck" else 1)
            positive = kind in ("load", "power", "stribeck") and changes != [{}]
            laws = [(more, law.changed(**more)) for more in changes]
            yield [
                Variant(joint, kind, more, shapes_of(robot, joint.name, changed, kind),
                        constants, positive)
                for joint in joints for more, changed in laws
            ]  # fmt: skip


def _changes(joint: FrictionJoint, law: Friction) -> dict[AdditionKind, list[dict[str, Any]]]:
    """Values of `Friction` for each kind of additional term; an empty one for other constants of a
    described term."""
    c, changes = law.coulomb, dict[AdditionKind, list[dict[str, Any]]]()
    if joint.drive is not None and law.both_ways:
        if law.offset is None:
            changes["offset"] = [{"offset": 0.1 * c}]
        changes["both_ways"] = [{"viscous_back": law.viscous, "coulomb_back": c, "offset": None}]
    if joint.drive is not None and law.load is None:
        changes["load"] = [{"load": _LOAD}]
    changes["power"] = [{}] if law.power else [
        {"power": PowerLaw(coefficient=_SIZE * c / joint.fastest**e, exponent=e)}
        for e in _EXPONENTS
    ]  # fmt: skip
    if law.stribeck or not law.hess_soom:
        changes["stribeck"] = [{}] if law.stribeck else [
            {"stribeck": Stribeck(
                coefficient=_SIZE * c, speed=share * joint.fastest, exponent=form)}
            for share in _SPEEDS for form in FORMS
        ]  # fmt: skip
    return changes


def shapes_of(
    robot: RobotDescription, joint: str, law: Friction, kind: AdditionKind
) -> tuple[Shape, ...]:
    """Shapes of an additional term, or of a described term's slopes by its constants."""
    if kind in _SHAPES:
        return _SHAPES[kind]
    terms = friction_terms({joint: (law, robot.units(joint))})
    term = next(term for term in terms if term.kind == kind)
    if getattr(robot.friction[joint], kind) is None:
        return (of_term(term),)
    return tuple(of_slope(term, name) for name in term.constants)
