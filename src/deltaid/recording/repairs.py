"""What is put right in the rows of one recording before anything is computed from them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.recording.carried import carrier
from deltaid.recording.columns import Columns, Readings, Rows
from deltaid.recording.delay import LagGrowth, Shift, delayed
from deltaid.recording.gears import Gears
from deltaid.recording.hold import Hold, filled
from deltaid.recording.masks.masks import joined_times
from deltaid.robot.description import RobotDescription

Samples = Float[np.ndarray, "samples dof"]

# Reasons to leave stretches out, and why these say nothing about the robot.
CONTACT, SPIKE, STOP, JOLT = "contact", "torque spike", "stop", "jolt"
BACKLASH = "backlash"
WHY_REPAIRED = {
    CONTACT: "something pushed the robot, which no torque of a model explains",
    SPIKE: "one torque channel jumps for a sample or three",
    STOP: "the robot was stopped by more than its drives",
    JOLT: "torque and motion change faster than the low-pass follows",
    BACKLASH: "play in a gear lets its motor go ahead where the torque changes its sign",
}


@dataclass(frozen=True)
class Push:
    """What acted on the platform for a while, where it was largest.

    Attributes:
        time: when [s].
        place: of the platform point in the world (3) [m].
        force: on it, in the world (3) [N].
        moment: about the axis that the tool turns about [N m]; None for a robot without one.
    """

    time: float
    place: tuple[float, float, float]
    force: tuple[float, float, float]
    moment: float | None = None


@dataclass(frozen=True)
class LeftSpan:
    """A stretch of time that tells nothing about the robot.

    Attributes:
        first, last: its first and last time stamp, as the torques were recorded [s].
        reason: why it is left out, such as 'contact'.
        drives: whose torques do not count; all if empty.
        push: what acted on the platform, if anything did.
        gear: the drive whose gear has play, if that is the reason.
    """

    first: float
    last: float
    reason: str
    drives: tuple[int, ...] = ()
    push: Push | None = None
    gear: int | None = None


@runtime_checkable
class Pull(Protocol):
    """Something beside the robot that takes torques of its drives."""

    def torques(self, z: Samples, qd: Samples) -> Samples:
        """What it takes along a motion."""
        ...


@dataclass(frozen=True, eq=False)
class Burden:
    """Loads as parameters of a robot whose other bodies weigh nothing and that has no friction.

    Attributes:
        dynamics: of the robot.
        columns: of the recording, which say when each load is held.
        p: of each load, in the order of `Columns.loads`.
        pulls: what takes torques all the time.
    """

    dynamics: Dynamics
    columns: Columns
    p: Float[np.ndarray, "loads parameters"]
    pulls: tuple[Pull, ...] = ()

    @classmethod
    def of_loads(
        cls,
        robot: RobotDescription,
        columns: Columns,
        loads: Sequence[Sequence[float]],
        pulls: Sequence[Pull] = (),
    ) -> "Burden":
        """Loads by their ten parameters each; none if their torques stay.

        Raises:
            RecordingError: the robot has no body that carries one of them.
        """
        dynamics = compiled(robot)
        p = np.zeros((len(columns.loads), len(dynamics.layout.names)))
        for row, load, ten in zip(p, columns.loads if loads else (), loads, strict=True):
            row[dynamics.layout.body(carrier(load, robot))] = ten
        return cls(dynamics, columns, p, tuple(pulls))

    def torques(
        self,
        time: Float[np.ndarray, " samples"],
        z: Samples,
        qd: Samples,
        qdd: Samples,
        extra: Float[np.ndarray, "samples extra"],
    ) -> Samples:
        """τ of all loads that are held, sample by sample, and of all that pulls."""
        taken = np.zeros_like(z)
        for pull in self.pulls:
            taken += pull.torques(z, qd)
        for p, held in zip(self.p, self.columns.held(time, extra), strict=True):
            at = np.flatnonzero(held)
            if at.size and p.any():
                taken[at] += self.dynamics.torque(z[at], qd[at], qdd[at], p)
        return taken


@dataclass(frozen=True)
class Repairs:
    """What is known to be wrong with a recording, and is put right in every pass over it.

    Attributes:
        readings: what positions and torques are that drives read otherwise; None if they do not.
        gain: what torques of each drive are to be multiplied by; empty for 1.
        hold: how drives hold their torques between two updates; empty for none.
        delay: torques of each drive are recorded so much late [s]; empty for none.
        constants: of the first-order filter that each drive's torques passed [s]; empty for none.
        growth: how delays grow with time; None for clocks that agree.
        left_out: stretches that do not count, beside what the survey masks.
        gears: that wind up under what they carry; None for stiff ones.
        loads: the ten parameters of what is held, in the order of `Columns.loads`; what it takes
            of the torques is taken out of them, which leaves those of the robot alone. Empty for
            none.
        pulls: what else takes torques all the time, which are taken out of them as well.
    """

    readings: Readings | None = None
    gain: tuple[float, ...] = ()
    hold: tuple[Hold, ...] = ()
    delay: tuple[float, ...] = ()
    constants: tuple[float, ...] = ()
    growth: LagGrowth | None = None
    left_out: tuple[LeftSpan, ...] = ()
    gears: Gears | None = None
    loads: tuple[tuple[float, ...], ...] = ()
    pulls: tuple[Pull, ...] = ()

    def apply(self, segment: Iterator[Rows], columns: Columns, rate: float) -> Iterator[Rows]:
        """The rows of one segment, put right.

        Args:
            segment: evenly spaced rows in blocks, columns as in `Log.batches`.
            columns: what stands where.
            rate: rows per second.
        """
        if not columns.torque:  # a planned motion: all of this is about torques
            return segment
        if self.left_out:  # as recorded, so that a delay takes weights along with torques
            segment = (self._weighed(rows, columns) for rows in segment)
        if any(self.hold):
            segment = filled(segment, columns, self.hold, rate)
        if (readings := self.readings) is not None:
            segment = (readings.corrected(rows, columns) for rows in segment)
        if any(self.delay) or any(self.constants) or self.growth:
            segment = delayed(segment, columns, self.shift(rate), rate)
        if self.gain:
            segment = (self._multiplied(rows, columns) for rows in segment)
        if self.gears is not None:
            segment = self.gears.turned_back(segment, columns, rate)
        return segment

    def _multiplied(self, rows: Rows, columns: Columns) -> Rows:
        rows = rows.copy()
        rows[:, columns.torque_places] *= self.gain
        return rows

    def shift(self, rate: float) -> Shift:
        """Delays, filters and clocks at a sampling rate [Hz]."""
        return Shift.of_delays(self.delay, rate, self.constants, self.growth)

    @property
    def lag(self) -> tuple[float, ...]:
        """By how much torques are late, dead time and time constant [s]; empty for none."""
        if not any(self.constants):
            return self.delay
        pairs = zip(self.delay or (0.0,) * len(self.constants), self.constants, strict=True)
        return tuple(delay + constant for delay, constant in pairs)

    def smear(self, rate: float) -> tuple[int, ...]:
        """Over how many samples to either side each drive's torque is spread; empty for none."""
        smear = self.shift(rate).smear
        if not any(self.hold):
            return smear
        smear = smear or (0,) * len(self.hold)
        return tuple(extra + hold.spread for extra, hold in zip(smear, self.hold, strict=True))

    def _weighed(self, rows: Rows, columns: Columns) -> Rows:
        """Weights of zero in all stretches that are left out; few of many are near a block.

        Sensors show nothing that counts in those that are left out for all drives.
        """
        if not len(rows):
            return rows
        drives = len(columns.torque)
        copied, time = rows, rows[:, 0]
        for drives_of, ends in self._by_drives.items():
            which = np.array(drives_of or range(drives))
            near = slice(
                np.searchsorted(ends[:, 1], time[0], side="left"),
                np.searchsorted(ends[:, 0], time[-1], side="right"),
            )
            if near.start >= near.stop:
                continue
            copied = rows.copy() if copied is rows else copied
            starts = np.searchsorted(time, ends[near, 0], side="left")
            stops = np.searchsorted(time, ends[near, 1], side="right")
            weights = rows.shape[1] - drives + which
            for first, last in zip(starts, stops, strict=True):
                copied[first:last, weights] = 0.0
                if len(which) == drives:
                    copied[first:last, columns.sensor_places] = np.nan
        return copied

    @cached_property
    def _by_drives(self) -> dict[tuple[int, ...], np.ndarray]:
        """Stretches that are left out for some drives: apart from each other, ascending."""
        found: dict[tuple[int, ...], list[tuple[float, float]]] = {}
        for span in self.left_out:
            found.setdefault(span.drives, []).append((span.first, span.last))
        return {drives: joined_times(np.array(spans)) for drives, spans in found.items()}


NO_REPAIRS = Repairs()
