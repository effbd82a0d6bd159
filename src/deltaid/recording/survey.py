"""First pass over a log: checks every row before anything is computed from it."""

from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import Doubt, LostReadingError, RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.columns import Channel, Columns, Rows
from deltaid.recording.masks.search import LoadSearch, MaskSearch
from deltaid.recording.reach import ReachCheck, Stretch
from deltaid.recording.row_sample import NO_ROWS, sampled
from deltaid.recording.source import BATCH_ROWS, LogTable
from deltaid.recording.spectrum import SpectrumEstimate, spectrum_of
from deltaid.recording.survey_checks import (
    Bounds,
    ClockCheck,
    DerivativeCheck,
    joints,
    off_course,
    require_rate,
)
from deltaid.recording.table import recut
from deltaid.recording.time.clock import Clock
from deltaid.recording.time.doubts import doubts_about_stamps

# Largest angle of an arm from the middle of its range [rad]; larger numbers are degrees.
_LARGEST_ARM_ANGLE = np.pi
# Results of a batch that do not depend on earlier rows: number of the first row, rows, their poses,
# which of these exist, spectra of positions.
Surveyed = tuple[int, Rows, Stretch, Bool[np.ndarray, " rows"], SpectrumEstimate]
# Largest step of a motion between two samples [rad]; a larger one is a jump of the reading.
_JUMP = 0.75 * 2 * np.pi


class Survey:
    """Running state of the first pass. Add all batches in order, then `finish`."""

    def __init__(self, table: LogTable, columns: Columns, kinematics: Kinematics) -> None:
        self.table, self.columns, self.kinematics = table, columns, kinematics
        self.last_q = np.zeros((0, kinematics.dof))
        self.units = [units.coordinate for units in kinematics.robot.drive_units.values()]
        self.low, self.high = np.array(np.inf), np.array(-np.inf)
        # For each sensor's channel, number of rows without a number, and the first such row.
        self.empty = np.zeros((2, len(columns.all[columns.sensor_places])), dtype=int)
        self.warnings, self.jumps = list[Doubt](), list[tuple[int, int, float]]()
        self.begin_again()
        self.reach = ReachCheck(table, columns, kinematics)
        self.bounds = Bounds(table, columns, kinematics.robot)
        self.clock = ClockCheck(table, columns.time.column)
        limits = map(kinematics.robot.limits_of, kinematics.robot.drives)
        efforts = [limit.effort or np.inf for limit in limits]
        self.search = MaskSearch(kinematics.dof, efforts) if columns.torque else None
        self.loads = LoadSearch(table, columns)
        self.sample = NO_ROWS

    def begin_again(self) -> None:
        """Reset the checks that need evenly spaced samples."""
        c = self.columns
        self.spectrum = spectrum_of(np.zeros((0, self.kinematics.dof)))
        pairs = ((c.position, c.velocity), (c.velocity, c.acceleration))
        columns = [(x.column, v.column) for pair in pairs for x, v in zip(*pair, strict=False)]
        self.derivatives = DerivativeCheck(columns)

    def look(self, batch: tuple[int, Rows]) -> Surveyed:
        """Compute poses, valid or not, and spectra of a batch.

        Raises:
            RecordingError: a number is beyond its bound.
        """
        row, values = batch
        self.bounds.check(values, row)
        q = values[:, 1 : 1 + self.kinematics.dof]
        z, good = self.kinematics.forward_unchecked(q)
        stretch = Stretch(values[:, 0], q, z, self.kinematics.regularity(z))
        return row, values, stretch, good, spectrum_of(q)

    def add(self, batch: Surveyed) -> None:
        """Check consecutive rows with the results of `look`.

        Raises:
            RecordingError: names the first impossible row.
        """
        row, values, stretch, good, spectrum = batch
        apart = self.clock.add(values[:, 0])
        if self.search is not None:
            self.search.add(values[:, : self.columns.torque_places.stop], self.clock.period)
        self.loads.add(values, row)
        torques = values[:, self.columns.torque_places]
        self.sample = sampled(self.sample, np.hstack([stretch.q, torques]))
        empty = np.isnan(values[:, self.columns.sensor_places])
        first = np.where(self.empty[0], self.empty[1], row + empty.argmax(axis=0))
        self.empty = np.array([self.empty[0] + np.count_nonzero(empty, axis=0), first])
        self.low = np.fmin(self.low, np.fmin.reduce(values))  # ignores NaN of sensors
        self.high = np.fmax(self.high, np.fmax.reduce(values))
        self._check_positions(stretch.q, row, apart)
        self.reach.add(stretch, good, row, apart)
        if self.clock.steady:
            self._compare(values, spectrum)

    def add_even(self, segment: Iterable[Float[np.ndarray, "_ channels"]]) -> None:
        """Add the samples of a segment to checks of evenly spaced samples."""
        for values in recut(segment, BATCH_ROWS):
            self._compare(values, spectrum_of(values[:, 1 : 1 + self.kinematics.dof]))

    def finish(self, clock: Clock) -> None:
        """Check the log as a whole.

        Raises:
            RecordingError: the rate is impossible, or a torque or velocity was not recorded.
        """
        c, samples = self.columns, self.clock.samples
        differentiated = not (c.velocity and c.acceleration)
        require_rate(self.table, c.time, clock.rate, differentiated=differentiated)
        self._check_constant()
        self._refuse_placeholders()
        of_sensors = [*self._check_sensors()]
        self.warnings += [
            *self.derivatives.warnings(str(self.table.path)),
            *self.reach.doubts(samples),
            *self.loads.doubts(),
            *self._doubts_about_jumps(),
            *of_sensors,
            *doubts_about_stamps(clock, self.table, c.time.column),
            *self.table.doubts,
        ]

    def _check_positions(
        self, q: Float[np.ndarray, "rows dof"], row: int, apart: Int[np.ndarray, " runs"]
    ) -> None:
        self._refuse_angles(q, row)
        steps = np.diff(q, axis=0, prepend=self.last_q if len(self.last_q) else q[:1])
        steps[apart], self.last_q = 0.0, q[-1:].copy()
        self._refuse_lost_reading(steps, q, row)
        if self.search is None and self.clock.steady:  # the speeds of a plan are smooth
            faster = np.diff(steps, axis=0, prepend=steps[:1])
            for i, drive, rows in off_course(faster):
                size = steps[i : i + rows, drive].sum() - rows * steps[i - 1, drive]
                self.jumps.append((row + i, drive, float(size)))
        self._refuse_jump(steps, row)

    def _refuse_angles(self, q: Float[np.ndarray, "rows dof"], row: int) -> None:
        middles = self.kinematics.mechanism.middles
        largest = [np.inf if m is None else _LARGEST_ARM_ANGLE + abs(m) for m in middles]
        for i, drive in np.argwhere(np.abs(q) > largest)[:1].tolist():
            name = self.columns.position[drive].column
            raise RecordingError(
                f"column {name} is {q[i, drive]:.4g} rad, more than half a revolution; it looks "
                "like degrees, or like the motor side of a gear",
                where=self.table.row_place(row + i),
                cure="declare its unit and gear with --columns MAPPING.yaml "
                f"(position: - {{column: {name}, unit: deg, gear: 1}})",
            )

    def _refuse_lost_reading(
        self, steps: Float[np.ndarray, "rows dof"], q: Float[np.ndarray, "rows dof"], row: int
    ) -> None:
        for i, drive, rows in islice(places := sorted(off_course(steps)), 1):
            name, unit, wrong = self.columns.position[drive].column, self.units[drive], q[i, drive]
            before, after = wrong - steps[i, drive], q[i + rows, drive]
            count = sum(place[1] == drive for place in places)
            lasts = "one row" if rows == 1 else f"{rows} rows"
            more = f", and so in {count - 1} more places of {len(q)} rows" if count > 1 else ""
            raise LostReadingError(
                f"column {name} is {wrong:.5g} {unit} for {lasts}, between {before:.5g} and "
                f"{after:.5g} {unit}, which is a wrong reading and no motion{more}",
                where=self.table.row_place(row + i),
                cure="remove such rows, which are then bridged, and inspect encoder and bus",
            )

    def _refuse_jump(self, steps: Float[np.ndarray, "rows dof"], row: int) -> None:
        turning = [not linear for linear in self.kinematics.robot.linear_drives]
        for i, drive in np.argwhere((np.abs(steps) > _JUMP) & turning)[:1].tolist():
            name = self.columns.position[drive].column
            raise RecordingError(
                f"column {name} jumps by {np.rad2deg(steps[i, drive]):.4g} degrees from one row to "
                "the next, which is neither a motion nor a whole turn",
                where=self.table.row_place(row + i),
                cure="was the encoder set anew there? Split the log, or declare the column's unit "
                "and gear with --columns MAPPING.yaml",
            )
        if self.search is None:
            return
        for i, drive in islice(places := [*joints(steps)], 1):
            rows = len({place[0] for place in places})
            more = f", and others at {rows - 1} more rows" if rows > 1 else ""
            name, size = self.columns.position[drive].column, float(steps[i, drive])
            raise RecordingError(
                f"column {name} jumps by {size:.3g} {self.units[drive]} from one row to the next "
                f"and goes on from there, which is no motion{more}; likeliest cause: recordings "
                "were joined, or rows are missing there that the time does not show",
                where=self.table.row_place(row + i),
                cure="split the log there and give its parts as several recordings, or give the "
                "time that the controller recorded",
            )

    def _compare(
        self, values: Float[np.ndarray, "rows channels"], spectrum: SpectrumEstimate
    ) -> None:
        c, dof = self.columns, self.kinematics.dof
        self.spectrum += spectrum
        known = 1 + dof * (1 + bool(c.velocity) + bool(c.velocity and c.acceleration))
        self.derivatives.add(values[:, 0], values[:, 1 : known - dof], values[:, 1 + dof : known])

    def _refuse_placeholders(self) -> None:
        for drive, torque, row in self.search.placeholders() if self.search else ():
            channel = self.columns.torque[drive]
            raise RecordingError(
                f"column {channel.column} is {torque / channel.scale + channel.zero:g} there and "
                "again, far beyond all its other numbers: that stands for a missing one",
                where=self.table.row_place(self.table.first_row + row),
                cure="remove these rows",
            )

    def _check_constant(self) -> None:
        c, resting = self.columns, self.low == self.high
        resting = {
            x.column: is_constant for x, is_constant in zip(c.all, resting.tolist(), strict=True)
        }
        for channel in c.torque:
            if resting[channel.column]:
                raise self._nothing_recorded(channel, "no torque was recorded")
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
                        rates[i], f"but {channel.column} is not, so it was not recorded"
                    )

    def _doubts_about_jumps(self) -> Iterator[Doubt]:
        if self.jumps:
            row, drive, size = max(self.jumps, key=lambda jump: abs(jump[2]))
            several = f", the largest of {len(self.jumps)} jumps" * (len(self.jumps) > 1)
            yield Doubt(
                f"column {self.columns.position[drive].column} jumps by {size:.3g} "
                f"{self.units[drive]} at {self.table.row_name(row)}{several}",
                cause="motions were joined that do not go on from each other",
                cure="join them by a motion, or at rest: no drive follows a jump, and what is "
                "computed about it means nothing",
            )

    def _check_sensors(self) -> Iterator[Doubt]:
        """Doubts about rows without a number; refuses columns without numbers or with one value."""
        samples, places = self.clock.samples, self.columns.sensor_places
        named = [(s.name, c.column) for s in self.columns.sensors for c in s.channels]
        ends = zip(self.low[places], self.high[places], *self.empty.tolist(), strict=True)
        for (sensor, column), (low, high, empty, row) in zip(named, ends, strict=True):
            if not low < high:
                what = f"is {low:.6g} in all rows, so nothing was recorded"
                raise RecordingError(
                    f"column {column} of sensor {sensor} "
                    + (what if empty < samples else "holds no number in any row"),
                    where=str(self.table.path),
                    cure="check the logger's signal, map the right column, or leave the sensor out "
                    f"of this recording by the line `sensors: {{{sensor}: null}}` of a mapping",
                )
            if empty:
                yield Doubt(
                    f"column {column} of sensor {sensor} holds no number in {empty} of {samples} "
                    f"rows, the first {self.table.row_name(row)}",
                    cause="the sensor is read less often than the drives, or lost its connection",
                    cure="such rows do not count for the sensor; all others do",
                )

    def _nothing_recorded(self, channel: Channel, why: str) -> RecordingError:
        return RecordingError(
            f"column {channel.column} is constant; {why}",
            where=str(self.table.path),
            cure="check the logger's signal, or map the right column with --columns"
            + self.columns.exclusion(channel),
        )
