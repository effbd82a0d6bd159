"""A log as a whole: surveyed once for what it holds and what is wrong with it, then read again."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.parallel import ordered
from deltaid.recording.address import listing
from deltaid.recording.columns import (
    ColumnMapping,
    Columns,
    extra_drives,
    resolve_columns,
)
from deltaid.recording.memory import Recording, RecordingLike, as_source
from deltaid.recording.source import Table
from deltaid.recording.survey import Survey
from deltaid.recording.table import Batch, open_table, read_batches


@dataclass(frozen=True)
class Log:
    """A surveyed recording.

    Attributes:
        table, columns: the file or table, and which of its columns are what.
        sha256: checksum, of the file or of the numbers in memory.
        samples: number of rows.
        rate: sampling rate, the mean over the log [Hz].
        torque_max: largest |τ| of each drive [N m]; empty without torques.
        reach: lowest and highest of the platform's coordinates [m].
        suggested_cutoff: low-pass cut-off by the rule of `SpectrumEstimate.cutoff` [Hz].
        warnings: what is doubtful, with rows and columns.
    """

    table: Table
    columns: Columns
    sha256: str
    samples: int
    rate: float
    torque_max: Float[np.ndarray, " drives"]
    reach: Float[np.ndarray, "2 3"]
    suggested_cutoff: float | None
    warnings: tuple[str, ...]

    @property
    def path(self) -> Path:
        """Where the log is; the name of one in memory."""
        return self.table.path

    @property
    def has_derivatives(self) -> bool:
        """Whether velocities and accelerations are recorded."""
        return bool(self.columns.velocity and self.columns.acceleration)

    def batches(self) -> Iterator[Batch]:
        """All rows in SI units: columns as in `Columns.all`, then one weight a drive.

        A weight between 0 and 1 says how far the drive's torque counts in that row; a log without
        torques has none.
        """
        drives = len(self.columns.torque)
        for batch in read_batches(self.table, self.columns):
            weights = np.ones((len(batch.values), drives))
            yield Batch(batch.row, np.hstack([batch.values, weights]))


def open_log(
    source: RecordingLike,
    kinematics: Kinematics,
    mapping: ColumnMapping | None = None,
    *,
    need_torque: bool = True,
) -> Log:
    """Survey a recording: read every row once and check it, before anything is computed from it.

    Args:
        source: a CSV or Parquet file, or a recording in memory.
        kinematics: of the robot that was recorded.
        mapping: names and units of the columns, if not the default ones; arrays with units of
            their own keep these.
        need_torque: if false, the log may be a planned motion, and torque columns are not read.

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
            f"has columns of another drive ({', '.join(extra)}), but the robot has "
            f"{kinematics.dof}; is the log of another robot?"
        )
    with ThreadPoolExecutor(1) as beside:
        digest = beside.submit(table.checksum, [channel.column for channel in columns.all])
        for seen in ordered(survey.look, read_batches(table, columns)):
            survey.add(seen)
        survey.finish()
    return Log(
        table=table,
        columns=columns,
        sha256=digest.result(),
        samples=survey.samples,
        rate=survey.clock.rate,
        torque_max=survey.torque_max,
        reach=np.array([survey.nearest, survey.farthest]),
        suggested_cutoff=survey.spectrum.cutoff(survey.clock.rate),
        warnings=tuple(survey.warnings),
    )


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
        table, mapping = source.table, source.mapping or mapping
    else:
        table = open_table(source, mapping)
    robot = kinematics.robot
    linear = tuple(robot.is_linear(drive) for drive in robot.drives)
    return table, resolve_columns(table, linear, mapping), mapping
