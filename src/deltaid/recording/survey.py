"""The first pass over a log: every row is checked before anything is computed from it."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import Doubt, RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.regularity import SINGULAR_CONDITION, Regularity
from deltaid.recording.bounds import Bounds
from deltaid.recording.branch import BranchCheck
from deltaid.recording.columns import Columns
from deltaid.recording.derivatives import DerivativeCheck
from deltaid.recording.masks.loads import LoadSearch
from deltaid.recording.masks.search import MaskSearch
from deltaid.recording.source import Table
from deltaid.recording.spectrum import Power, SpectrumEstimate, power_of
from deltaid.recording.table import Batch, recut
from deltaid.recording.time.clock import Clock, ClockCheck, require_rate
from deltaid.recording.time.words import told_of_stamps

# No rotary arm of a Delta turns half a revolution from the middle of its work; numbers beyond this
# are degrees.
_LARGEST_ARM_ANGLE = np.pi
# A step of this much of a turn between two samples is a jump of the reading, not a motion.
_JUMP = 0.75 * 2 * np.pi
# Rows of an even segment that are looked at together.
_EVEN_ROWS = 1 << 16
# Rows between two places where time leaves off that show a passage from branch to branch.
_SHOWN = 4
_KEEP_AWAY = (
    "check zero and sign of the drives and the robot's lengths; a robot that does this cannot be "
    "held by its drives there, so keep the motion away from it"
)


@dataclass(frozen=True, eq=False)
class Seen:
    """A batch and what of it can be computed apart from the rows before it."""

    batch: Batch
    z: Float[np.ndarray, "rows dof"]
    good: Bool[np.ndarray, " rows"]
    regular: Regularity
    power: Power


@dataclass
class Survey:
    """Running state of the first pass. Add all batches in order, then `finish`."""

    table: Table
    columns: Columns
    kinematics: Kinematics
    last_q: np.ndarray | None = None
    low: np.ndarray = field(default_factory=lambda: np.array(np.inf))
    high: np.ndarray = field(default_factory=lambda: np.array(-np.inf))
    nearest: np.ndarray = field(default_factory=lambda: np.full(3, np.inf))
    farthest: np.ndarray = field(default_factory=lambda: np.full(3, -np.inf))
    outside: int = 0
    strained: int = 0
    first_strained: str = ""
    first_outside: str = ""
    warnings: list[Doubt] = field(default_factory=list)
    spectrum: SpectrumEstimate = field(init=False)
    derivatives: DerivativeCheck = field(init=False)
    branch: BranchCheck = field(init=False)
    bounds: Bounds = field(init=False)
    clock: ClockCheck = field(init=False)
    search: MaskSearch | None = field(init=False)
    loads: LoadSearch = field(init=False)

    def __post_init__(self) -> None:
        self.begin_again()
        self.branch = BranchCheck(self.kinematics)
        self.bounds = Bounds(self.table, self.columns, self.kinematics.robot)
        self.clock = ClockCheck(self.table, self.columns.time.column)
        robot = self.kinematics.robot
        limits = (robot.drive_limits.get(drive) for drive in robot.drives)
        efforts = [(limit and limit.effort) or np.inf for limit in limits]
        dof = self.kinematics.dof
        self.search = MaskSearch(dof, efforts) if self.columns.torque else None
        self.loads = LoadSearch(self.table, self.columns)

    def begin_again(self) -> None:
        """Forget what compares rows over a distance: it holds for evenly spaced samples only."""
        c = self.columns
        self.spectrum = SpectrumEstimate(self.kinematics.dof)
        pairs = [(a.column, b.column) for a, b in zip(c.position, c.velocity, strict=False)]
        pairs += [(a.column, b.column) for a, b in zip(c.velocity, c.acceleration, strict=False)]
        self.derivatives = DerivativeCheck(pairs)

    @property
    def samples(self) -> int:
        """Rows so far."""
        return self.clock.samples

    @property
    def torque_max(self) -> Float[np.ndarray, " drives"]:
        """Largest |τ| of each drive [N m]."""
        return np.maximum(np.abs(self.low), np.abs(self.high))[self.columns.torque_places]

    def look(self, batch: Batch) -> Seen:
        """A batch with its poses, whatever they are worth, and spectra; changes nothing here.

        Raises:
            RecordingError: a number is beyond its bound, so that nothing can be computed from it.
        """
        self.bounds.check(batch.values, batch.row)
        z, good = self.kinematics.forward_unchecked(batch.values[:, 1 : 1 + self.kinematics.dof])
        power = power_of(batch.values[:, 1 : 1 + self.kinematics.dof])
        return Seen(batch, z, good, self.kinematics.regularity(z), power)

    def add(self, seen: Seen) -> None:
        """Check consecutive rows.

        Raises:
            RecordingError: with the first row that cannot be.
        """
        batch, values = seen.batch, seen.batch.values
        apart = self.clock.add(batch)
        if self.search is not None:
            self.search.add(values[:, : self.columns.torque_places.stop], self.clock.period)
        self.loads.add(values, batch.row)
        self.low = np.minimum(self.low, values.min(axis=0))
        self.high = np.maximum(self.high, values.max(axis=0))
        q = values[:, 1 : 1 + self.kinematics.dof]
        self._check_angles(q, batch.row)
        self._check_jumps(q, batch.row, apart)
        self._check_reach(values[:, 0], q, seen, apart)
        if self.clock.steady:
            self.spectrum.add(seen.power)
            self._compare_derivatives(values)

    def add_even(self, segment: Iterable[Float[np.ndarray, "_ channels"]]) -> None:
        """Take in the samples of a segment for what holds for evenly spaced ones only."""
        for values in recut(segment, _EVEN_ROWS):
            self.spectrum.add(power_of(values[:, 1 : 1 + self.kinematics.dof]))
            self._compare_derivatives(values)

    def require_time(self) -> None:
        """Check that there are rows, and that time runs.

        Raises:
            RecordingError: there are too few, or it does not.
        """
        if self.samples < 2:
            raise RecordingError(
                "has fewer than two rows of data",
                where=str(self.table.path),
                cure="give a whole recording",
            )
        self.clock.require_time()

    def finish(self, clock: Clock) -> None:
        """Check what only the whole log shows.

        Raises:
            RecordingError: an impossible rate; a torque or velocity is missing.
        """
        where = str(self.table.path)
        require_rate(
            self.table,
            self.columns.time.column,
            clock.rate,
            differentiated=not (self.columns.velocity and self.columns.acceleration),
        )
        self._check_constant()
        self.warnings += self.derivatives.warnings(where)
        if self.outside:
            self.warnings.append(
                Doubt(
                    f"{self.outside} of {self.samples} samples lie outside the workspace of the "
                    f"description, the first in {self.first_outside}",
                    cause="the robot uses more room than 'workspace' says",
                    cure="widen it; if the robot was not there, check its lengths and zeros",
                )
            )
        if self.strained:
            self.warnings.append(
                Doubt(
                    f"{self.strained} of {self.samples} samples are nearer to a singular pose than "
                    f"the description's largest_condition of "
                    f"{self.kinematics.robot.largest_condition:g}, the first in "
                    f"{self.first_strained}",
                    cause="a motion at the edge of what the limbs reach",
                    cure="keep away from it, for small errors of lengths and zeros are large there",
                )
            )
        self.warnings += self.loads.told()
        self.warnings += told_of_stamps(clock, self.table, self.columns.time.column)
        self.warnings += self.table.doubts

    def _check_angles(self, q: Float[np.ndarray, "rows dof"], row: int) -> None:
        middles = self.kinematics.mechanism.middles
        largest = [np.inf if m is None else _LARGEST_ARM_ANGLE + abs(m) for m in middles]
        large = np.argwhere(np.abs(q) > largest)
        if large.size:
            i, drive = (int(index) for index in large[0])
            name = self.columns.position[drive].column
            raise RecordingError(
                f"column {name} is {q[i, drive]:.4g} rad, more than half a revolution; it looks "
                "like degrees, or like the motor side of a gear",
                where=self._row(row + i),
                cure="declare its unit and gear with --columns MAPPING.yaml "
                f"(position: - {{column: {name}, unit: deg, gear: 1}})",
            )

    def _check_jumps(
        self, q: Float[np.ndarray, "rows dof"], row: int, apart: Int[np.ndarray, " runs"]
    ) -> None:
        steps = np.diff(q, axis=0, prepend=q[:1] if self.last_q is None else self.last_q)
        steps[apart] = 0.0
        self.last_q = q[-1:].copy()
        turning = [not self.kinematics.robot.is_linear(d) for d in self.kinematics.robot.drives]
        jumps = np.argwhere((np.abs(steps) > _JUMP) & turning)
        if jumps.size:
            i, drive = (int(index) for index in jumps[0])
            name = self.columns.position[drive].column
            raise RecordingError(
                f"column {name} jumps by {np.rad2deg(steps[i, drive]):.4g} degrees from one row to "
                "the next, which is neither a motion nor a whole turn",
                where=self._row(row + i),
                cure="was the encoder set anew there? Split the log, or declare the column's unit "
                "and gear with --columns MAPPING.yaml",
            )

    def _check_reach(
        self,
        time: Float[np.ndarray, " rows"],
        q: Float[np.ndarray, "rows dof"],
        seen: Seen,
        apart: Int[np.ndarray, " runs"],
    ) -> None:
        z, regular, row = seen.z, seen.regular, seen.batch.row
        bad = np.flatnonzero(~seen.good)
        if bad.size:
            self._require_way(time, q, z, int(bad[0]), row, apart)
        points = self.kinematics.robot.task.point(z)
        self.nearest = np.minimum(self.nearest, points.min(axis=0))
        self.farthest = np.maximum(self.farthest, points.max(axis=0))
        singular = np.flatnonzero(~(regular.worst < SINGULAR_CONDITION))
        if singular.size:
            raise RecordingError(
                f"the robot is in a singular pose at {self._angles(q[singular[0]])}",
                where=self._row(row + int(singular[0])),
                cure="an arm and its struts are in line there, or the struts in one plane; check "
                "zero and sign of the drives, and the robot's lengths",
            )
        strained = np.flatnonzero(regular.worst > self.kinematics.robot.largest_condition)
        if strained.size and not self.strained:
            self.first_strained = f"row {row + int(strained[0])} at {time[strained[0]]:.6g} s"
        self.strained += strained.size
        self._check_branch(time, q, z, regular, row, apart)
        outside = np.flatnonzero(~self.kinematics.robot.workspace.contains(points))
        if outside.size and not self.outside:
            i = int(outside[0])
            x, y, height = points[i]
            self.first_outside = f"row {row + i} at [{x:.3f}, {y:.3f}, {height:.3f}] m"
        self.outside += outside.size

    def _check_branch(
        self,
        time: Float[np.ndarray, " rows"],
        q: Float[np.ndarray, "rows dof"],
        z: Float[np.ndarray, "rows dof"],
        regular: Regularity,
        row: int,
        apart: Int[np.ndarray, " runs"],
    ) -> None:
        for start, stop in pairwise([0, *apart[apart > 0].tolist(), len(time)]):
            if start in apart:
                self.branch = BranchCheck(self.kinematics)
                if stop - start < _SHOWN and stop < len(time):
                    continue
            run = slice(start, stop)
            left = self.branch.add(time[run], q[run], z[run], regular.part(run))
            if left is not None:
                at, what = left
                place = f", at {self._angles(q[start + at])}" if at >= 0 else ""
                where = self._row(row + start + at)
                raise RecordingError(f"{what}{place}", where=where, cure=_KEEP_AWAY)

    def _require_way(
        self,
        time: Float[np.ndarray, " rows"],
        q: Float[np.ndarray, "rows dof"],
        z: Float[np.ndarray, "rows dof"],
        bad: int,
        row: int,
        apart: Int[np.ndarray, " runs"],
    ) -> None:
        """Refuse the first sample without a pose, or a passage before it that explains it."""
        if bad:
            way = time[:bad], q[:bad], z[:bad]
            regular = self.kinematics.regularity(way[2])
            self._check_branch(*way, regular, row, apart[apart < bad])
        before = self.branch.last_condition
        reason = f"{self.kinematics.why_not(q[bad : bad + 1])} at {self._angles(q[bad])}"
        if before > self.kinematics.robot.largest_condition:
            raise RecordingError(
                f"the robot comes to a singular pose at {time[bad]:.6g} s: the condition number "
                f"is {before:.4g} in the row before, and here {reason}",
                where=self._row(row + bad),
                cure=_KEEP_AWAY,
            )
        raise RecordingError(
            f"{reason}, {time[bad]:.6g} s",
            where=self._row(row + bad),
            cure="check sign, zero, unit and order of the drives (angle 0 = arm horizontal and "
            "outwards, positive = down) and the robot's lengths",
        )

    def _angles(self, q: Float[np.ndarray, " dof"]) -> str:
        names = ", ".join(channel.column for channel in self.columns.position)
        linear = [self.kinematics.robot.is_linear(d) for d in self.kinematics.robot.drives]
        unit = "m" if all(linear) else "rad" if not any(linear) else "m and rad"
        return f"({names}) = ({', '.join(f'{value:.4g}' for value in q)}) {unit}"

    def _compare_derivatives(self, values: Float[np.ndarray, "rows channels"]) -> None:
        c, dof = self.columns, self.kinematics.dof
        known = 1 + dof * (1 + bool(c.velocity) + bool(c.velocity and c.acceleration))
        self.derivatives.add(values[:, 0], values[:, 1 : known - dof], values[:, 1 + dof : known])

    def _check_constant(self) -> None:
        c = self.columns
        resting = dict(
            zip((x.column for x in c.all), (self.low == self.high).tolist(), strict=True)
        )
        for channel in c.torque:
            if resting[channel.column]:
                raise self._nothing_recorded(channel.column, "no torque was recorded")
        for i, channel in enumerate(c.position):
            if resting[channel.column]:
                self.warnings.append(
                    Doubt(
                        f"column {channel.column} is constant, so what only this drive shows stays "
                        "undetermined",
                        cause="it was not moved",
                        cure="record a motion of all drives, such as `deltaid excite` plans; if it "
                        "was moved, map the column that holds its position",
                        key="excitation",
                    )
                )
                continue
            for rates in (c.velocity, c.acceleration):
                if rates and resting[rates[i].column]:
                    raise self._nothing_recorded(
                        rates[i].column, f"but {channel.column} is not, so it was not recorded"
                    )

    def _nothing_recorded(self, column: str, why: str) -> RecordingError:
        return RecordingError(
            f"column {column} is constant; {why}",
            where=str(self.table.path),
            cure="check the logger's signal, or map the right column with --columns",
        )

    def _row(self, row: int) -> str:
        return self.table.row_place(row)
