"""What checks look at: a robot, and of a recording what is read of it whatever is wrong with it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.errors import IdentificationError, RecordingError
from deltaid.identification.fit import FittedProblem, fit
from deltaid.identification.loads import declared_loads
from deltaid.identification.setup import Setup
from deltaid.identification.study import Study, studied
from deltaid.identification.warmth import Warmth
from deltaid.model.record import Settings
from deltaid.recording.columns import Columns
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.opening import resolved_table
from deltaid.recording.recording import Recording, open_recordings
from deltaid.recording.source import Table
from deltaid.recording.table import read_batches
from deltaid.robot.description import RobotDescription

# Rows that hypotheses are tried on: enough for any motion, few enough to try a hundred.
_MOST = 1 << 18


@dataclass(frozen=True, eq=False)
class Rows:
    """Consecutive rows as the mapping makes them, before any check, in SI units; q̇, q̈ and τ are
    without columns where not recorded."""

    time: Float[np.ndarray, " rows"]
    q: Float[np.ndarray, "rows drives"]
    qd: Float[np.ndarray, "rows _"]
    qdd: Float[np.ndarray, "rows _"]
    tau: Float[np.ndarray, "rows _"]

    @property
    def step(self) -> float:
        """The usual time between two rows, a median [s]."""
        return float(np.median(np.diff(self.time)))


@dataclass(frozen=True, eq=False)
class Evidence:
    """A robot as described and one recording of it, with its mapping as given.

    Attributes:
        settings: of the fit that verdicts on the fit rest on.
        made: that fit, where it has been made already.
    """

    dynamics: Dynamics
    table: Table
    columns: Columns
    source: RecordingLike
    mapping: ColumnMapping | None
    settings: Settings
    made: FittedProblem | None = None

    @property
    def robot(self) -> RobotDescription:
        return self.dynamics.robot

    @cached_property
    def rows(self) -> Rows:
        """The recording's beginning, unchecked; of a log of usual length all of it.

        Raises:
            RecordingError: it cannot be read at all.
        """
        columns, parts, held = self.columns, list[np.ndarray](), 0
        for batch in read_batches(self.table, columns):
            parts.append(batch.values[: _MOST - held])
            held += len(parts[-1])
            if held >= _MOST:
                break
        values = np.concatenate(parts) if parts else np.zeros((0, len(columns.all)))
        counts = np.cumsum([len(columns.position), len(columns.velocity)])
        q, qd, qdd = np.split(values[:, columns.motion_places], counts, axis=1)
        return Rows(values[:, 0], q, qd, qdd, values[:, columns.torque_places])

    @cached_property
    def moved(self) -> Float[np.ndarray, " drives"]:
        """How far each drive goes in these rows [rad or m]."""
        return np.ptp(self.rows.q, axis=0)

    @cached_property
    def _setup(self) -> Setup | RecordingError:
        """The recording, without the torques of what it is declared to hold."""
        try:
            keep, cutoff = self.settings.keep_all, self.settings.cutoff
            where = self.source, self.dynamics.kinematics, self.mapping
            opened = open_recordings(*where, cutoff, keep_all=keep)
            return declared_loads(Setup(self.robot, tuple(opened), self.settings), lambda _: None)
        except RecordingError as error:
            return error

    @cached_property
    def surveyed(self) -> Recording | RecordingError:
        """The recording as an identification takes it, or why none can."""
        setup = self._setup
        return setup if isinstance(setup, RecordingError) else setup.recordings[0]

    @cached_property
    def study(self) -> Study | None:
        """What the residual of this recording looks like; None where it cannot be told."""
        if isinstance(self.surveyed, RecordingError):
            return None
        if self.made is None:
            return studied(self.dynamics, self.surveyed)
        warming = tuple(one for one in self.made.additions if isinstance(one, Warmth))
        return studied(self.dynamics, self.surveyed, self.made.p, warming)

    @cached_property
    def fitted(self) -> FittedProblem | RecordingError | IdentificationError:
        """The fit to this recording, or why there is none."""
        if self.made is not None:
            return self.made
        setup = self._setup
        if isinstance(setup, RecordingError):
            return setup
        try:
            return fit(self.dynamics, setup.recordings, self.settings, additions=setup.additions)
        except IdentificationError as error:
            return error


def evidence(
    robot: RobotDescription,
    source: RecordingLike,
    mapping: ColumnMapping | None = None,
    settings: Settings | None = None,
) -> Evidence:
    """Open a recording for checks, however wrong its numbers are.

    Raises:
        RecordingError: it cannot be opened, or a column is missing.
    """
    dynamics = compiled(robot)
    table, columns, mapping = resolved_table(source, dynamics.kinematics, mapping)
    return Evidence(dynamics, table, columns, source, mapping, settings or Settings())


def with_fit(
    one: Evidence, problem: FittedProblem, recording: Recording, study: Study | None
) -> Evidence:
    """Evidence whose survey, fit and study, if there is one, are those that have been made."""
    known = replace(one, dynamics=problem.dynamics, made=problem)
    vars(known).update({key: vars(one)[key] for key in ("rows", "moved") if key in vars(one)})
    vars(known).update(surveyed=recording)  # where cached properties are kept
    if study is not None:
        vars(known).update(study=study)
    return known
