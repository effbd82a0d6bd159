"""The rows of a recording as a controller would have had them, cycle by cycle.

Where velocities are recorded they are taken; where not, the cycle differences positions itself.
Torques are as recorded but for lags that the model's drives are known to have.
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
# Rows of a block, so that all that cycles give of it has room.
_BLOCK = 20_000


@dataclass(frozen=True, eq=False)
class Rows:
    """Consecutive cycles, one a row.

    Attributes:
        begins: whether the first one follows a hole, or nothing.
        time: when each is known [s].
        q: of the joints.
        qd: the same; None where it is not recorded.
        tau: as the drives report it.
        gripper: what it says: −1 nothing, 0 empty, 1 holds.
    """

    begins: bool
    time: Float[np.ndarray, " samples"]
    q: Samples
    qd: Samples | None
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
        return tuple((self.log.position_noise * self.rate * np.sqrt(2.0)).tolist())

    @property
    def is_told(self) -> bool:
        """Whether a gripper's signal says when something is held."""
        return bool(self.log.columns.loads)

    def rows(self) -> Iterator[Rows]:
        """All cycles, in blocks; after a hole the first block begins anew."""
        for segment in self.log.segments(None):
            begins = True
            for block in self.repairs.of(segment, self.log.columns, self.rate):
                for start in range(0, len(block), _BLOCK):
                    yield self._of(block[start : start + _BLOCK], begins)
                    begins = False

    def _of(self, values: Float[np.ndarray, "_ _"], begins: bool) -> Rows:
        c, dof = self.log.columns, len(self.log.columns.torque)
        told = values[:, c.extra_places]
        gripper = np.full(len(values), NOT_TOLD)
        if c.loads:
            gripper = np.where(c.held(values[:, 0], told).any(axis=0), HOLDS, EMPTY)
        return Rows(
            begins,
            values[:, 0],
            values[:, 1 : 1 + dof],
            values[:, 1 + dof : 1 + 2 * dof] if self.has_velocity else None,
            values[:, c.torque_places],
            gripper,
        )


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
