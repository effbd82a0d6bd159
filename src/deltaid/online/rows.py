"""The rows of a recording as a controller would have had them, cycle by cycle.

Where velocities are recorded they are taken; where not, the cycle differences positions itself.
Torques are as recorded: lags that the model's drives are known to have, the cycle puts right.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.errors import RecordingError
from deltaid.identification.as_identified import delays_of, model_filtered
from deltaid.mechanism.kinematics import Samples
from deltaid.model.model import Model
from deltaid.online.settings import OnlineSettings
from deltaid.online.speeds import Speeds, speeds_of
from deltaid.recording.carried import Load
from deltaid.recording.log import Log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.masks.masks import Mask, Reason, kept
from deltaid.recording.masks.runs import joined_times
from deltaid.recording.memory import RecordingLike
from deltaid.recording.opening import open_log

NOT_TOLD, EMPTY, HOLDS = -1.0, 0.0, 1.0
# Cycles a second that an observer can be run at.
_LEAST_RATE = 100.0
# Why torques are not those that moved the robot.
POWERLESS: tuple[Reason, ...] = ("stale rows", "on brakes", "emergency stop")
# Rows of a block, so that all that cycles give of it has room.
_BLOCK = 20_000


@dataclass(frozen=True, eq=False)
class Rows:
    """Consecutive cycles, one a row.

    Attributes:
        begins: whether the first one follows a hole, or nothing.
        time: of each [s].
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
        log: as surveyed; without velocities where positions are differenced.
        delay: by how much torques of each drive come late [s].
        speeds: what is known of its velocities.
        masks: what is no motion under power of the drives, or is not what happened.
        ends: the number at which each drive's torque channel ends; infinite if it does not.
    """

    log: Log
    delay: tuple[float, ...]
    speeds: Speeds
    masks: tuple[Mask, ...]
    ends: tuple[float, ...]

    @property
    def rate(self) -> float:
        """Cycles a second [Hz]."""
        return self.log.rate

    @property
    def has_velocity(self) -> bool:
        """Whether recorded velocities are taken."""
        return not self.speeds.differenced

    @property
    def is_told(self) -> bool:
        """Whether a gripper's signal says when something is held."""
        return bool(self.log.columns.loads)

    def settings(self, given: OnlineSettings) -> OnlineSettings:
        """Settings with what the recording decides: rate, speeds, and lags where these are open."""
        return replace(
            given.at(self.rate),
            speed="measured" if self.has_velocity else "differenced",
            speed_noise=self.speeds.noise,
            delay=self.delay if given.delay is None else given.delay,
            torque_ends=self.ends,
        )

    def rows(self) -> Iterator[Rows]:
        """All cycles, in blocks; after a hole the first block begins anew."""
        for segment in self.log.segments(None):
            begins = True
            for block in segment:
                for start in range(0, len(block), _BLOCK):
                    yield self._of(block[start : start + _BLOCK], begins)
                    begins = False

    def share(self, *reasons: Reason) -> float:
        """Of the rows that are masked for some reasons."""
        masks = [mask for mask in self.masks if mask.reason in reasons]
        return float(np.max(1.0 - kept(masks, len(self.ends), self.log.samples)))

    def _of(self, values: Float[np.ndarray, "_ _"], begins: bool) -> Rows:
        c, dof = self.log.columns, len(self.log.columns.torque)
        time, told = values[:, 0], values[:, c.extra_places]
        gripper = np.full(len(values), NOT_TOLD)
        if c.loads:
            gripper = np.where(c.held(time, told).any(axis=0), HOLDS, EMPTY)
        tau = values[:, c.torque_places].copy()
        tau[self._powerless(time)] = np.nan
        return Rows(
            begins,
            time,
            values[:, 1 : 1 + dof],
            values[:, 1 + dof : 1 + 2 * dof] if self.has_velocity else None,
            tau,
            gripper,
        )

    def _powerless(self, time: Float[np.ndarray, " samples"]) -> Bool[np.ndarray, " samples"]:
        """Rows whose torques are not those that moved the robot."""
        around = 0.5 / self.rate
        spans = [(m.start - around, m.end + around) for m in self.masks if m.reason in POWERLESS]
        if not spans:
            return np.zeros(len(time), dtype=bool)
        ends = joined_times(np.array(sorted(spans))).ravel()
        return np.searchsorted(ends, time) % 2 == 1


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
    opened = open_log(log, kinematics, mapping, need_rest=False)
    if opened.rate < _LEAST_RATE:
        raise RecordingError(
            f"has {opened.rate:.4g} rows a second; contact and payload are found from cycles of a "
            f"controller, at least {_LEAST_RATE:g} a second",
            where=str(opened.path),
            cure="record at the controller's rate",
        )
    delay = tuple(delays_of(model, opened).tolist())
    recording = model_filtered(model, opened)  # without velocities, if the model did without
    speeds = speeds_of(recording, kinematics)
    own = tuple(mask for mask in opened.masks if mask.reason == "stale rows")
    taken = replace(recording.log, masks=own)
    if speeds.differenced:
        taken = replace(taken, columns=replace(taken.columns, velocity=(), acceleration=()))
    return Replay(taken, delay, speeds, opened.masks, _ends(opened))


def _ends(log: Log) -> tuple[float, ...]:
    """The least number on which each torque channel stays."""
    found = np.full(len(log.columns.torque), np.inf)
    masks = [mask for mask in log.masks if mask.reason == "saturated torque"]
    for batch in log.batches() if masks else ():
        rows = np.arange(batch.row, batch.row + len(batch.values))
        sizes = np.abs(batch.values[:, log.columns.torque_places])
        for mask in masks:
            inside = (rows >= mask.first) & (rows <= mask.last)
            for i in mask.drives:
                found[i] = np.min(sizes[inside, i], initial=found[i])
    return tuple(found.tolist())
