"""Checks of a survey: bounds of numbers, velocities against positions, time stamps.

Wrong units and broken rows give numbers that no recording of a robot has. Bounds are a hundred
times the limits of the description; without limits, they are beyond any machine of this class.

Comparing velocities with the derivatives of positions reveals wrong units, signs and order. Over
stretches of a few hundredths of a second, encoder steps and noise matter little: with the change Δq
of position and the integral ∫v dt of velocity, k = Σ ∫v dt Δq / Σ Δq² is 1 if both columns are
declared correctly.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.columns import Columns, TimeChannel
from deltaid.recording.filter import LOWEST_RATE
from deltaid.recording.mapped_columns import Quantity
from deltaid.recording.source import LogTable
from deltaid.recording.time.clock import HIGHEST_RATE, NO_TIME, Clock
from deltaid.recording.time.counts import unit_factors
from deltaid.recording.time.grid import FASTEST, FEWEST, usual_step
from deltaid.recording.time.signals import GAP
from deltaid.recording.units import MOST_WRONG, SI_UNITS
from deltaid.robot.description import RobotDescription
from deltaid.robot.part import LARGEST, LONGEST, TOP_SPEED

# Factor by which a recording may exceed a described limit.
FACTOR = 100.0
# Largest magnitudes of turning and of sliding drives [SI units].
_HIGHEST: dict[Quantity, tuple[float, float]] = {
    "position": (1e5, LONGEST),
    "velocity": (1e3, TOP_SPEED),
    "acceleration": (1e6, 1e6),
    "torque": (1e6, 1e7),
}
# Length of the stretches over which rates are compared with changes [s]: short against a motion.
STRETCH = 0.02
# Squared correlation above which columns must agree in scale, and below which they are unlikely to
# belong to the same drive.
_TOGETHER, _APART = 0.9, 0.3
# Range of ratios of scales that count as equal.
_SCALE = (0.8, 1.25)
# Largest motion that noise and steps of coarse encoders imitate [rad or m].
ENCODER_NOISE = 1e-3
# Factors between SI units and units that are easily confused with them.
_LIKELY = {"degrees": 180 / np.pi, "rpm": 30 / np.pi}
# Wrong readings: most rows, least ratio of their jump there and back to the largest other change
# nearby and to the column's smallest change, and rows on either side that are nearby.
_LOST, _OFF, _AROUND = 3, 12.0, 16
# Share of all steps that a jump exceeds.
_FAST = 0.99
# Relative deviation from the usual step above which a step is uneven.
UNEVEN = 0.05


class DerivativeCheck:
    """Running check of pairs of columns whose second is the rate of the first."""

    def __init__(self, names: list[tuple[str, str]]) -> None:
        self._names = names
        self._sums = np.zeros((3, len(names)))  # Δq², (∫v dt)², their product
        self._stretches = 0

    def add(
        self,
        time: Float[np.ndarray, " rows"],
        x: Float[np.ndarray, "rows pairs"],
        rate: Float[np.ndarray, "rows pairs"],
    ) -> None:
        if not self._names or len(time) < 2:
            return
        step = np.diff(time)
        share = min(STRETCH / float(time[-1] - time[0]), 2.0)  # above 1 nothing can be compared
        every = max(1, round(share * len(step)))
        area = 0.5 * (rate[1:] + rate[:-1]) * step[:, None]
        integral = np.vstack([np.zeros(area.shape[1]), np.cumsum(area, axis=0)])
        change, expected = (np.diff(v[::every], axis=0) for v in (x, integral))
        products = (change**2, expected**2, change * expected)
        self._sums += [product.sum(axis=0) for product in products]
        self._stretches += len(change)

    def warnings(self, where: str) -> Iterator[Doubt]:
        """Doubts about rates that hardly correlate with the changes of their columns.

        Raises:
            RecordingError: a rate correlates with its column, but has another scale or sign.
        """
        for (name, rate_name), (xx, vv, xv) in zip(self._names, self._sums.T, strict=True):
            if xx <= ENCODER_NOISE**2 * self._stretches or vv == 0:
                continue
            together, scale = xv**2 / (xx * vv), xv / xx
            if together < _APART:
                yield Doubt(
                    f"column {rate_name} hardly goes with the changes of {name} (correlation "
                    f"{np.sqrt(together):.2g})",
                    cause="it is of another drive, or another signal",
                    cure="map the column of this drive with --columns, or exclude it there by "
                    "`velocity: []` or `acceleration: []`: rates then follow from positions",
                    key="velocity",
                )
            elif together > _TOGETHER and not _is_one(scale):
                units = [unit for unit, size in _LIKELY.items() if _is_one(abs(scale) / size)]
                raise RecordingError(
                    f"column {rate_name} is {scale:.4g} times the rate at which {name} changes"
                    + next((f", as if it were in {unit}" for unit in units), ""),
                    where=where,
                    cure="declare unit, sign and gear of both columns, and the unit of time, with "
                    "--columns MAPPING.yaml",
                )


def _is_one(scale: float) -> bool:
    return bool(_SCALE[0] < scale < _SCALE[1])


class Bounds:
    """Largest magnitudes of time and of the drives' channels, in the order of `Columns.all`."""

    def __init__(self, table: LogTable, columns: Columns, robot: RobotDescription) -> None:
        self._table, self._columns = table, columns
        largest, units = [LARGEST], ["s"]
        for quantity, highest in _HIGHEST.items():
            for drive, _ in zip(robot.drives, getattr(columns, quantity), strict=False):
                slides, described = robot.is_linear(drive), robot.limits_of(drive)
                # Positions have no stated bound, because they may be wrapped.
                stated = {
                    "velocity": described.top_speed,
                    "acceleration": described.top_acceleration,
                    "torque": described.effort,
                }.get(quantity)
                most = highest[slides]
                largest.append(min(most, FACTOR * stated) if stated else most)
                units.append(SI_UNITS[quantity][slides].replace("^2", "²"))
        self._largest, self._units = np.array(largest), units

    def check(self, values: Float[np.ndarray, "rows channels"], row: int) -> None:
        """Refuse numbers beyond their bounds.

        Args:
            row: number of the first row.

        Raises:
            RecordingError: names row, column, number and bound.
        """
        values = values[:, : len(self._largest)]
        for i, k in np.argwhere(np.abs(values) > self._largest)[:1].tolist():
            name, unit = self._columns.all[k].column, self._units[k]
            raise RecordingError(
                f"column {name} is {values[i, k]:.4g} {unit}, but no recording of this robot goes "
                f"beyond {self._largest[k]:.4g} {unit}",
                where=self._table.row_place(row + i),
                cure="repair or remove the row; if all rows are like it, declare the column's unit "
                f"{'and gear' if k else '(ms, us, ns)'} with --columns MAPPING.yaml",
            )


def off_course(steps: Float[np.ndarray, "steps drives"]) -> Iterator[tuple[int, int, int]]:
    """Wrong readings: jumps there and back within a few rows, as (first row, column, rows).

    Args:
        steps: changes of numbers from row to row; 0 where time jumps.
    """
    if not len(steps):
        return
    size = np.abs(steps)
    least = np.min(size, axis=0, where=size > 0, initial=np.inf)
    usual = _OFF * np.maximum(np.median(size, axis=0), least)
    for rows in range(1, min(_LOST, len(steps) - 1) + 1):
        there, back = steps[:-rows], steps[rows:]
        jump = np.where(there * back < 0, np.minimum(size[:-rows], size[rows:]), 0.0)
        for i, drive in np.argwhere(jump > usual).tolist():
            after = size[i + rows + 1 : i + rows + 1 + _AROUND, drive]
            most = max(
                size[max(0, i - _AROUND) : i, drive].max(initial=0.0), after.max(initial=0.0)
            )
            if jump[i, drive] > _OFF * max(most, least[drive]):
                yield i, drive, rows


def joints(steps: Float[np.ndarray, "steps drives"]) -> Iterator[tuple[int, int]]:
    """Jumps from which numbers do not return, as (row, column): recordings were joined there, or
    rows are missing.

    Steps after a repeated row do not count: they catch up on the motion.

    Args:
        steps: changes of numbers from row to row; 0 where time jumps.
    """
    size = np.abs(steps)
    if len(size) < 3:
        return
    least = np.min(size, axis=0, where=size > 0, initial=np.inf)
    usual = np.maximum(np.quantile(size, _FAST, axis=0), _OFF * least)
    sudden = np.minimum(size[1:-1] - _OFF * size[:-2], size[1:-1] - _OFF * size[2:]) > 0
    sudden &= (size[1:-1] > usual) & size[:-2].any(axis=1, keepdims=True)
    for i, drive in np.argwhere(sudden).tolist():
        row = i + 1
        around = size[max(0, row - _AROUND) : row + 1 + _AROUND, drive]
        if size[row, drive] > _OFF * np.sort(around)[-2]:
            yield row, drive


class ClockCheck:
    """Running check of time stamps: whether they are a time, and steady.

    Attributes:
        table, column: the log and its time column.
        samples: number of rows so far.
        step: median time between two rows [s].
        period: usual time between two rows [s]; positive also if most rows share stamps.
        first_time, last_time: first and last stamp so far [s].
        uneven, backward, forward: numbers of uneven, negative and positive steps.
    """

    def __init__(self, table: LogTable, column: str) -> None:
        self.table, self.column = table, column
        self.samples = self.uneven = self.backward = self.forward = 0
        self.step, self.period, self._apart = 0.0, 0.0, np.inf
        self.first_time = self.last_time = np.nan

    @property
    def steady(self) -> bool:
        """Whether all steps are equal, so that no row is missing."""
        return not self.uneven

    @property
    def clock(self) -> Clock:
        """Clock of a steady recording, with the mean rate."""
        period = (self.last_time - self.first_time) / (self.samples - 1)
        return Clock(period, self.samples, self.first_time, self.last_time)

    def add(self, time: Float[np.ndarray, " rows"]) -> Int[np.ndarray, " runs"]:
        """Add stamps of consecutive rows; returns the rows of this call at which time jumps."""
        steps = np.diff(time, prepend=self.last_time)
        known = steps[~np.isnan(steps)]
        if not self.step and known.size:
            self.step = float(np.median(known))
            usual = self.step if self.step > 0 else usual_step(time)[0]
            self.period = max(usual, FASTEST) if usual else 0.0
            self._apart = GAP * max(self.step, float(np.quantile(known, 0.95)))
        if not self.samples:
            self.first_time = float(time[0])
        self.last_time = float(time[-1])
        self.backward += int(np.count_nonzero(known < 0))
        self.forward += int(np.count_nonzero(known > 0))
        self.uneven += int(np.count_nonzero(np.abs(known - self.step) > UNEVEN * self.step))
        self.uneven += int(self.step <= 0 < known.size)
        self.samples += len(time)
        return np.flatnonzero(np.abs(steps) > self._apart)

    def require_time(self) -> None:
        """Refuse a column that is no time.

        Raises:
            RecordingError: the column hardly changes or runs backwards, or rows are too few.
        """
        where, samples = str(self.table.path), self.samples
        if samples < 2:
            cure = "give a whole recording"
            raise RecordingError("has fewer than two rows of data", where=where, cure=cure)
        if not self.forward and self.backward:
            what = "runs backwards"
        elif not self.forward:
            what = f"is {self.first_time:.10g} s in all rows: it does not run"
        elif self.forward < FEWEST and 2 * self.forward < samples - 1:
            what = (
                f"changes in only {self.forward} of {samples} rows, too few to determine the "
                "sampling rate"
            )
        elif self.backward > MOST_WRONG * samples:
            what = f"goes back in {self.backward} of {samples} rows; it is no time"
        else:
            return
        raise RecordingError(
            f"column {self.column} {what}",
            where=where,
            cure=NO_TIME,
        )


def require_rate(table: LogTable, time: TimeChannel, rate: float, *, differentiated: bool) -> None:
    """Refuse an impossible rate, or one at which positions cannot be differentiated.

    Raises:
        RecordingError: names the limit.
    """
    slow = differentiated and rate < LOWEST_RATE
    if slow or rate > HIGHEST_RATE:
        limit = f"at least {LOWEST_RATE:g}" if slow else f"at most {HIGHEST_RATE:g}"
        column = time.column
        makes = [
            f"unit: {unit} makes {rate * factor:.4g} Hz"
            for unit, factor in unit_factors(time).items()
            if LOWEST_RATE <= rate * factor <= HIGHEST_RATE
        ]
        raise RecordingError(
            f"column {column} makes a sampling rate of {rate:.4g} Hz; {limit} Hz can be",
            where=str(table.path),
            cure="declare the unit of time with --columns MAPPING.yaml (time: {column: "
            f"{column}, unit: …}}{''.join(f'; {made}' for made in makes)}); if {column} counts "
            "rows or cycles, give the sampling rate in its place (time: {rate: 1000})",
        )
