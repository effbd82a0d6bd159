"""Replay of a recording, cycle by cycle, as a controller would have received it.

Recorded velocities are used; without them the cycle differences positions. Torques are as recorded;
the cycle corrects the known lags of the model's drives.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from deltaid.errors import Doubt, RecordingError
from deltaid.identification.sources import delays_of
from deltaid.mechanism.kinematics import Samples
from deltaid.model.model import Model
from deltaid.model.verdict import percent
from deltaid.online.columns import judged_wiring, speeds_of
from deltaid.online.instant import EMPTY, HOLDS, UNKNOWN
from deltaid.online.settings import MOST_STALE, OnlineSettings
from deltaid.recording.carried import Load
from deltaid.recording.log import Log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.masks.masks import Mask, Reason, joined_times, kept_shares, within
from deltaid.recording.memory import RecordingLike
from deltaid.recording.opening import open_log
from deltaid.recording.source import BATCH_ROWS

# Least rate of rows for online estimation [Hz].
_LEAST_RATE = 100.0
# Least time that brakes hold [s]: a robot that rests for a moment may need hardly any torque.
_BRAKED, _BRAKES = 0.5, ("on brakes", "emergency stop")
# Least duration of a recording [s].
_LEAST_TIME = 0.5


@dataclass(frozen=True, eq=False)
class Cycles:
    """Consecutive cycles, one per row.

    Attributes:
        begins: whether the first one follows a gap, or is the first of all.
        time: of each [s].
        q: drive coordinates.
        qd: velocities; None where not recorded.
        tau: torques as the drives report them.
        gripper: its signal: −1 unknown, 0 empty, 1 holds.
        elapsed: 0 for a row that is not new, −1 for others: the clock is even.
    """

    begins: bool
    time: Float[np.ndarray, " samples"]
    q: Samples
    qd: Samples | None
    tau: Samples
    gripper: Float[np.ndarray, " samples"]
    elapsed: Float[np.ndarray, " samples"]


@dataclass(frozen=True, eq=False)
class Replay:
    """A recording that can be replayed.

    Attributes:
        log: as surveyed; without velocities where positions are differenced.
        delay: lag of each drive's torque [s].
        has_velocity: whether recorded velocities are used.
        speed_noise: standard deviation of one cycle's speed, drive by drive.
        masks: rows without powered motion, or with wrong values.
        ends: number at which each drive's torque channel saturates; infinite if it does not.
        doubts: about the recording, the log's warnings first.
    """

    log: Log
    delay: tuple[float, ...]
    has_velocity: bool
    speed_noise: tuple[float, ...]
    masks: tuple[Mask, ...]
    ends: tuple[float, ...]
    doubts: tuple[Doubt, ...]

    @property
    def has_gripper(self) -> bool:
        """Whether the recording has a gripper's signal."""
        return bool(self.log.columns.loads)

    def settings(self, given: OnlineSettings) -> OnlineSettings:
        """Settings with the recording's rate and speeds, and its lags unless they are given."""
        return replace(
            given.at_rate(self.log.rate),
            speed="measured" if self.has_velocity else "differenced",
            speed_noise=self.speed_noise,
            delay=self.delay if given.delay is None else given.delay,
            torque_ends=self.ends,
        )

    def rows(self) -> Iterator[Cycles]:
        """All cycles, in blocks; the first block after a gap begins anew."""
        for segment in self.log.segments(None):
            begins = True
            for block in segment:
                for start in range(0, len(block), BATCH_ROWS):
                    yield self._cycles(block[start : start + BATCH_ROWS], begins)
                    begins = False

    @cached_property
    def powerless(self) -> tuple[Mask, ...]:
        """Rows whose torques did not move the robot: on brakes, with the stop before them."""
        braked = [m for m in self.masks if m.reason == "on brakes" and m.end - m.start > _BRAKED]
        stops = [m for m in self.masks if m.reason == "emergency stop"]
        ahead = {mask.first - 1 for mask in braked}
        stops = [mask for mask in stops if mask.last in ahead]
        return tuple(sorted((*braked, *stops), key=lambda mask: mask.first))

    def share(self, *reasons: Reason) -> float:
        """Share of rows that are masked for some reasons."""
        masks = [mask for mask in self.masks if mask.reason in reasons]
        masks = [mask for mask in masks if mask.reason not in _BRAKES or mask in self.powerless]
        return float(np.max(1.0 - kept_shares(masks, len(self.ends), self.log.samples)))

    def _cycles(self, values: Float[np.ndarray, "_ _"], begins: bool) -> Cycles:
        c, dof = self.log.columns, len(self.log.columns.torque)
        time, extra = values[:, 0], values[:, c.extra_places]
        tau, gripper = values[:, c.torque_places].copy(), np.full(len(values), UNKNOWN)
        if c.loads:
            gripper = np.where(c.held(time, extra).any(axis=0), HOLDS, EMPTY)
        tau[self._inside(self.powerless, time)] = np.nan
        elapsed = np.where(self._inside(_stale(self.masks), time), 0.0, UNKNOWN)
        q, qd = values[:, 1 : 1 + dof], values[:, 1 + dof : 1 + 2 * dof]
        return Cycles(begins, time, q, qd if self.has_velocity else None, tau, gripper, elapsed)

    def _inside(
        self, masks: tuple[Mask, ...], time: Float[np.ndarray, " samples"]
    ) -> Bool[np.ndarray, " samples"]:
        around = 0.5 / self.log.rate
        spans = np.array([(mask.start - around, mask.end + around) for mask in masks])
        return within(joined_times(spans.reshape(-1, 2)), time)


def open_replay(
    model: Model,
    log: RecordingLike,
    mapping: ColumnMapping | None = None,
    gripper: str | None = None,
    delay: tuple[float, ...] | None = None,
) -> Replay:
    """Open a recording for a replay with a model.

    Args:
        log: a file, or a recording in memory.
        mapping: of its columns.
        gripper: a column that is 1 while something is held, in addition to the mapping.
        delay: lag of each drive's torque [s]; None for the model's.

    Raises:
        RecordingError: the recording cannot be used, is too slow or too short, its columns hold
            other signals, or gripper and mapping both declare loads.
    """
    mapping = mapping or ColumnMapping()
    if gripper is not None:
        if mapping.loads:
            what, cure = "the mapping says already when a load is held", "omit one of the two"
            raise RecordingError(what, where=f"--gripper {gripper}", cure=cure)
        mapping = mapping.changed(load=Load(column=gripper)).known_as(mapping.source)
    opened = open_log(log, model.dynamics.kinematics, mapping, need_rest=False)
    if opened.rate < _LEAST_RATE:
        raise RecordingError(
            f"has {opened.rate:.4g} rows a second; contact and payload are found from cycles of a "
            f"controller, at least {_LEAST_RATE:g} a second",
            where=str(opened.path),
            cure="record at the controller's rate",
        )
    seconds, stale = opened.samples / opened.rate, _stale(opened.masks)
    if seconds < _LEAST_TIME:
        raise RecordingError(
            f"has {opened.samples} rows, {seconds:.2g} s, and no load shows within "
            f"{_LEAST_TIME:g} s",
            where=str(opened.path),
            cure="give a whole recording",
        )
    share = float(np.max(1.0 - kept_shares(stale, 1, opened.samples)))
    if share > MOST_STALE:
        raise RecordingError(
            f"{percent(share)} of its rows repeat the one before them while the robot moves",
            where=str(opened.path),
            cure="it was logged faster than its values change: keep one row of each value, or "
            "record at the rate of the drives",
        )
    delay = tuple(delays_of(model, opened).tolist()) if delay is None else delay
    has_velocity, noise, of_speeds = speeds_of(opened, model)
    of_wiring = judged_wiring(model, opened, log, mapping)
    doubts = (*opened.cut_at(None, 1).warnings, *of_wiring, *of_speeds)
    taken = replace(opened, masks=stale).cut_at(None, 1)
    if not has_velocity:
        taken = replace(taken, columns=taken.columns.without_rates)
    return Replay(taken, delay, has_velocity, noise, opened.masks, _ends(opened), doubts)


def _stale(masks: tuple[Mask, ...]) -> tuple[Mask, ...]:
    return tuple(mask for mask in masks if mask.reason == "stale rows")


def _ends(log: Log) -> tuple[float, ...]:
    """Least number at which each torque channel saturates: the largest of some excluded stretch."""
    masks = [mask for mask in log.masks if mask.reason == "saturated torque"]
    largest, row = np.zeros((len(masks), len(log.columns.torque))), 0
    for values in log.batches() if masks else ():
        rows = np.arange(row, row := row + len(values))
        sizes = np.abs(values[:, log.columns.torque_places])
        for mask, top in zip(masks, largest, strict=True):
            inside = (rows >= mask.first) & (rows <= mask.last)
            top[:] = np.maximum(top, sizes[inside].max(axis=0, initial=0.0))
    for mask, top in zip(masks, largest, strict=True):
        top[[i for i in range(len(top)) if i not in mask.drives]] = np.inf
    return tuple(largest.min(axis=0, initial=np.inf).tolist())
