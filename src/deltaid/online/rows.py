"""The rows of a recording as a controller would have had them, cycle by cycle.

Where velocities are recorded they are taken. Where not, that of row k is (q_{k+1} − q_{k−1})/2h and
is known a row later: so a controller runs a row late, and what it finds is told at the time of the
row after. Torques are as recorded but for lags that the model's drives are known to have.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.identification.as_identified import model_filtered
from deltaid.mechanism.kinematics import Samples
from deltaid.model.model import Model
from deltaid.recording.carried import Load
from deltaid.recording.log import Log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.opening import open_log
from deltaid.recording.repairs import Repairs

NOT_TOLD, EMPTY, HOLDS = -1.0, 0.0, 1.0
# Cycles a second that an observer can be run at.
_LEAST_RATE = 100.0


@dataclass(frozen=True, eq=False)
class Rows:
    """Consecutive cycles, one a row.

    Attributes:
        begins: whether the first one follows a hole, or nothing.
        time: when each is known [s].
        q, qd: of the joints.
        tau: as the drives report it.
        gripper: what it says: −1 nothing, 0 empty, 1 holds.
    """

    begins: bool
    time: Float[np.ndarray, " samples"]
    q: Samples
    qd: Samples
    tau: Samples
    gripper: Float[np.ndarray, " samples"]


@dataclass(frozen=True, eq=False)
class Replay:
    """A recording that can be run through.

    Attributes:
        log: as surveyed.
        repairs: of the model's drives.
    """

    log: Log
    repairs: Repairs

    @property
    def rate(self) -> float:
        """Cycles a second [Hz]."""
        return self.log.rate

    @property
    def has_velocity(self) -> bool:
        """Whether velocities are recorded."""
        return bool(self.log.columns.velocity)

    @property
    def speed_noise(self) -> tuple[float, ...] | None:
        """Standard deviation of each drive's speed, where it is made of positions; else None."""
        if self.has_velocity:
            return None
        return tuple((self.log.position_noise * self.rate * np.sqrt(0.5)).tolist())

    @property
    def is_told(self) -> bool:
        """Whether a gripper's signal says when something is held."""
        return bool(self.log.columns.loads)

    def rows(self) -> Iterator[Rows]:
        """All cycles, in blocks; after a hole the first block begins anew."""
        width = len(self.log.columns.all) + len(self.log.columns.torque)
        for segment in self.log.segments(None):
            lead, begins = np.empty((0, width)), True
            for block in self.repairs.of(segment, self.log.columns, self.rate):
                values = np.vstack([lead, block])
                rows = self._of(values, len(lead), begins)
                lead = values[-2:]
                if len(rows.time):
                    yield rows
                    begins = False

    def _of(self, values: Float[np.ndarray, "_ _"], lead: int, begins: bool) -> Rows:
        """Cycles of some rows; the first of them, `lead`, were there before."""
        c, dof = self.log.columns, len(self.log.columns.torque)
        q, tau = values[:, 1 : 1 + dof], values[:, c.torque_places]
        if self.has_velocity:
            part = slice(lead, None)
            qd, at = values[part, 1 + dof : 1 + 2 * dof], values[part, 0]
        else:
            part = slice(1, -1)
            qd = 0.5 * self.rate * (q[2:] - q[:-2])
            at = values[2:, 0]
        told = values[:, c.extra_places]
        gripper = np.full(len(values), NOT_TOLD)
        if c.loads:
            gripper = np.where(c.held(values[:, 0], told).any(axis=0), HOLDS, EMPTY)
        return Rows(begins, at, q[part], qd, tau[part], gripper[part])


def open_replay(
    model: Model,
    log: RecordingLike,
    mapping: ColumnMapping | None = None,
    gripper: str | None = None,
) -> Replay:
    """A recording as a model's drives would run it.

    Args:
        log: a file, or a recording in memory.
        mapping: of its columns.
        gripper: a column that is 1 while something is held, beside what the mapping says.

    Raises:
        RecordingError: the recording cannot be used, is too slow, or gripper and mapping both say
            when something is held.
    """
    mapping = mapping or ColumnMapping()
    if gripper is not None:
        if mapping.loads:
            raise RecordingError(
                "the mapping says already when a load is held",
                where=f"--gripper {gripper}",
                cure="leave out one of the two",
            )
        mapping = mapping.changed(load=Load(column=gripper)).of(mapping.source)
    kinematics = model.dynamics.kinematics
    opened = open_log(log, kinematics, mapping, keep_all=True)
    if opened.rate < _LEAST_RATE:
        raise RecordingError(
            f"has {opened.rate:.4g} rows a second; contact and payload are found from cycles of a "
            f"controller, at least {_LEAST_RATE:g} a second",
            where=str(opened.path),
            cure="record at the controller's rate",
        )
    found = model_filtered(model, opened)
    kept = replace(found.repairs, gain=(), left_out=(), gears=None, loads=())
    return Replay(opened, kept)
