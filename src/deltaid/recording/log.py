"""A log as a whole: surveyed once for what it holds and what is wrong with it, then read again."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt, RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.parallel import ordered
from deltaid.recording.address import listing
from deltaid.recording.columns import Columns, extra_drives, resolve_columns
from deltaid.recording.excerpt import Excerpt
from deltaid.recording.kept import Kept
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.masks.masks import Mask, Weights, require_rest
from deltaid.recording.masks.runs import runs_of
from deltaid.recording.masks.stale import bridged
from deltaid.recording.memory import Recording, RecordingLike, as_source
from deltaid.recording.source import Table
from deltaid.recording.spectrum import SpectrumEstimate, power_of
from deltaid.recording.survey import Survey
from deltaid.recording.table import Batch, open_table, read_batches
from deltaid.recording.time.clock import Clock, require_rate
from deltaid.recording.time.segments import longest_hole, segments
from deltaid.recording.time.study import study
from deltaid.recording.time.unwrap import Unwrapping
from deltaid.recording.time.words import told_of_holes

# Holes that are bridged while the cut-off is not known yet, and the longest stretch of stale rows
# in whose place a motion is put [s].
_BRIDGED, _HELD = 0.005, 0.1
# The rule of `Log.suggested_cutoff`: multiple of the bandwidth, Hz, and periods in a segment.
_ABOVE, _AT_LEAST, _LEAST_PERIODS = 2.0, 12.0, 100.0


@dataclass(frozen=True)
class Log:
    """A surveyed recording.

    Attributes:
        table, columns: the file or table, and which of its columns are what.
        sha256: checksum, of the file or of the numbers in memory.
        samples: number of rows.
        clock: how the rows lie in time: what is missing, doubled, jittered.
        torque_max: largest |τ| of each drive [N m]; empty without torques.
        position_noise: standard deviation of each drive's position, steps of the encoder included
            [rad or m]; 0 where it is not seen.
        reach: lowest and highest of the platform's coordinates [m].
        motion_cutoff: low-pass cut-off of the positions by the rule of `SpectrumEstimate.cutoff`
            [Hz], from the stretches between emergency stops.
        bandwidth: of the motion, by `SpectrumEstimate.bandwidth` [Hz], from the same.
        masks: what is left out of it; without any where all is kept.
        keep_all: whether nothing is to be left out.
        warnings: what is doubtful, with rows and columns.
        kept: its rows as they were read; None if they are too many.
        held: what is read in the place of its rows; None for these.
    """

    table: Table
    columns: Columns
    sha256: str
    samples: int
    clock: Clock
    torque_max: Float[np.ndarray, " drives"]
    position_noise: Float[np.ndarray, " positions"]
    reach: Float[np.ndarray, "2 3"]
    motion_cutoff: float | None
    bandwidth: float | None
    masks: tuple[Mask, ...]
    keep_all: bool
    warnings: tuple[Doubt, ...]
    kept: Kept | None = field(default=None, compare=False)
    held: Excerpt | None = field(default=None, compare=False)

    @property
    def path(self) -> Path:
        """Where the log is; the name of one in memory."""
        return self.table.path

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return self.clock.rate

    @property
    def has_derivatives(self) -> bool:
        """Whether velocities and accelerations are recorded."""
        return bool(self.columns.velocity and self.columns.acceleration)

    @property
    def suggested_cutoff(self) -> float | None:
        """Low-pass cut-off for the rows of a regression [Hz]; None where it is not known.

        Twice the motion's bandwidth, because torques hold products of velocities, and at least
        12 Hz for the steps of friction; above there is hardly anything but noise, play and ringing
        of gears. No higher than what positions hold, and no lower than what costs a usual segment
        a sixteenth of its samples, by the filter's length.
        """
        if self.motion_cutoff is None or self.bandwidth is None:
            return None
        segments = self.laid.segments(self.bridged(self.motion_cutoff))
        usual = np.sum(segments**2.0) / np.sum(segments) / self.rate
        return min(
            self.motion_cutoff, max(_ABOVE * self.bandwidth, _AT_LEAST, _LEAST_PERIODS / usual)
        )

    @cached_property
    def laid(self) -> Clock:
        """The clock with long stretches of stale rows taken for holes."""
        runs = [(mask.first, mask.last) for mask in self._stale if self._is_long(mask)]
        return self.clock.without(np.array(runs, dtype=int).reshape(-1, 2))

    @property
    def _stale(self) -> list[Mask]:
        return [mask for mask in self.masks if mask.reason == "stale rows"]

    def _is_long(self, mask: Mask) -> bool:
        return mask.last - mask.first >= _HELD * self.rate

    def batches(self) -> Iterator[Batch]:
        """All rows in SI units: columns as in `Columns.all`, then one weight a drive.

        A weight between 0 and 1 says how far the drive's torque counts in that row; a log without
        torques has none. In the place of a few stale rows stands a smooth motion.
        """
        weights = Weights(self.masks, len(self.columns.torque))
        stale = [mask for mask in self._stale if not self._is_long(mask)]
        row, motion = 0, self.columns.motion_places
        for batch in bridged(self._read(), stale, motion):
            yield Batch(batch.row, np.hstack([batch.values, weights.of(row, len(batch.values))]))
            row += len(batch.values)

    def _read(self) -> Iterator[Batch]:
        return self.kept.read(self.columns) if self.kept else read_batches(self.table, self.columns)

    def segments(self, cutoff: float | None) -> Iterator[Iterator[Float[np.ndarray, "_ _"]]]:
        """The samples of each segment, evenly spaced, in blocks; columns as in `batches`.

        Args:
            cutoff: what is filtered away later [Hz]; shorter holes are bridged.
        """
        if self.held is not None:
            return self.held.segments(self.columns)
        rows = (batch.values for batch in self.batches())
        weights, held = len(self.columns.torque), len(self.columns.extra)
        return segments(rows, self.laid, self.bridged(cutoff), weights, held)

    def bridged(self, cutoff: float | None) -> int:
        """Rows missing that are bridged at a cut-off [Hz]; one, where nothing is filtered."""
        return longest_hole(self.rate, cutoff) if cutoff else 1

    def cut_at(self, cutoff: float | None, shortest: int) -> "Log":
        """The same, with what becomes of its holes at a cut-off told among its warnings.

        Args:
            shortest: samples that a segment must have to be of use.

        Raises:
            RecordingError: no segment has so many.
        """
        if self.laid.steady:
            return self
        told = told_of_holes(self.laid, self.table, self.bridged(cutoff), shortest)
        told = [text for text in told if text not in self.warnings]
        return replace(self, warnings=(*self.warnings, *told))


def open_log(
    source: RecordingLike,
    kinematics: Kinematics,
    mapping: ColumnMapping | None = None,
    *,
    need_torque: bool = True,
    keep_all: bool = False,
) -> Log:
    """Survey a recording: read every row once and check it, before anything is computed from it.

    Args:
        source: a file of any kind in `FORMATS`, or a recording in memory.
        kinematics: of the robot that was recorded.
        mapping: names and units of the columns, if not the default ones; arrays with units of
            their own keep these.
        need_torque: if false, the log may be a planned motion, and torque columns are not read.
        keep_all: leave nothing out (`masks`).

    Raises:
        RecordingError: a column is missing; a value is missing or not finite; time runs backwards
            or has gaps; a torque is constant; angles look like degrees; velocities are not the
            positions' derivatives; a sample is out of reach.
    """
    table, columns, mapping = resolved_table(source, kinematics, mapping)
    if not need_torque:
        columns = replace(columns, torque=())
    elif not columns.torque:
        raise RecordingError(
            f"has no torque columns; its columns are {listing(table.fields)}",
            where=table.header_place,
            cure=table.cure_without_torque,
        )
    survey = Survey(table, columns, kinematics)
    survey.warnings += table.warnings
    if extra := extra_drives(table, columns, kinematics.dof):
        survey.warnings.append(
            Doubt(
                f"has columns of another drive ({', '.join(extra)}), but the robot has "
                f"{kinematics.dof}",
                cause="the log is of another robot, or of an axis beside it as well",
                cure="give the robot that was recorded; an axis beside it does no harm",
            )
        )
    with ThreadPoolExecutor(1) as beside:
        digest = beside.submit(table.checksum, [one.column for one in columns.recorded])
        unwrapping, kept = Unwrapping(columns), Kept(columns)
        batches = kept.taking(read_batches(table, columns, unwrapping))
        for seen in ordered(survey.look, batches):
            survey.add(seen)
        survey.warnings += unwrapping.told(table)
        clock = _clock(survey)
        survey.finish(clock)
    masks = _masks(survey, clock) if not keep_all else ()
    require_rest(masks, survey.samples, kinematics.robot.drives, str(table.path))
    log = Log(
        table=table,
        columns=columns,
        sha256=digest.result(),
        samples=survey.samples,
        clock=clock,
        torque_max=survey.torque_max,
        position_noise=survey.spectrum.noise,
        reach=np.array([survey.nearest, survey.farthest]),
        motion_cutoff=survey.spectrum.cutoff(clock.rate),
        bandwidth=survey.spectrum.bandwidth(clock.rate),
        masks=masks,
        keep_all=keep_all,
        warnings=tuple(survey.warnings),
        kept=kept if kept.whole else None,
    )
    return _with_cutoff_between_stops(log)


def resolved_table(
    source: RecordingLike, kinematics: Kinematics, mapping: ColumnMapping | None = None
) -> tuple[Table, Columns, ColumnMapping]:
    """A recording's table, which of its columns are what, and the mapping that decided it.

    Raises:
        RecordingError: it cannot be read, or a column is missing.
    """
    mapping, source = mapping or ColumnMapping(), as_source(source)
    if isinstance(source, Recording):
        source.require_drives(kinematics.dof)
        if source.mapping is not None:
            mapping = source.mapping.changed(load=mapping.load)
        table = source.table
    else:
        table = open_table(source, mapping)
    robot = kinematics.robot
    linear = tuple(robot.is_linear(drive) for drive in robot.drives)
    return table, resolve_columns(table, linear, mapping), mapping


def _masks(survey: Survey, clock: Clock) -> tuple[Mask, ...]:
    """All that is left out, in the order of rows."""
    found = (*(survey.search.masks(clock) if survey.search else ()), *survey.loads.masks(clock))
    return tuple(sorted(found, key=lambda mask: (mask.first, mask.drives)))


def _with_cutoff_between_stops(log: Log) -> Log:
    """Brakes stop a robot with a jerk, whose spectrum is no motion's: without it, the cut-off."""
    stops = tuple(mask for mask in log.masks if mask.reason == "emergency stop")
    if not stops:
        return log
    q = slice(1, 1 + len(log.columns.position))
    spectrum = SpectrumEstimate(len(log.columns.position))
    for segment in replace(log, masks=stops).segments(None):
        for rows in segment:
            for first, last in runs_of(rows[:, -1] > 0):
                spectrum.add(power_of(rows[first : last + 1, q]))
    cutoff = spectrum.cutoff(log.rate)
    if cutoff is None:
        return log
    return replace(
        log,
        motion_cutoff=cutoff,
        bandwidth=spectrum.bandwidth(log.rate),
        position_noise=spectrum.noise,
    )


def _clock(survey: Survey) -> Clock:
    """The clock of a surveyed log. Where rows are not steady, what compares neighbours in the
    survey is begun again, now over segments."""
    survey.require_time()
    if survey.clock.steady:
        return survey.clock.clock
    table, columns, dof = survey.table, survey.columns, survey.kinematics.dof

    def rows() -> Iterator[Float[np.ndarray, "_ _"]]:
        return (batch.values for batch in read_batches(table, columns))

    # Before any row is placed by such a step.
    require_rate(table, columns.time.column, survey.clock.usual_rate, differentiated=False)
    clock = study(rows(), dof)
    require_rate(table, columns.time.column, clock.rate, differentiated=False)
    survey.begin_again()
    for segment in segments(rows(), clock, int(_BRIDGED * clock.rate), 0):
        survey.add_even(segment)
    return clock
