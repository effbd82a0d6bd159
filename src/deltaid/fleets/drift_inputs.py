"""Inputs of drift: recordings with their time, temperature and load, and settings of the search."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

from deltaid.errors import DeltaidError, RecordingError
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fleet import DATE, datetime_of

# Stamps beyond this are seconds since 1970, and not since a recording began.
_SINCE_1970 = 1e9


@dataclass(frozen=True, eq=False)
class DriftRecording:
    """One recording's factors, and when it was made; for the rest None is what the file says.

    Attributes:
        temperature: of gears or oil [°C].
        load: mass that was held [kg].
        name: of the recording; empty for that in the factor file.
    """

    file: FactorFile
    time: datetime
    temperature: float | None = None
    load: float | None = None
    name: str = ""

    @property
    def degrees(self) -> float:
        """Temperature; NaN where it is not known."""
        if self.temperature is not None:
            return float(self.temperature)
        recorded = self.file.record.temperature
        return float("nan") if recorded is None else recorded.mean

    @property
    def held(self) -> float:
        """Largest mass held [kg]; the identified one of a load without a declared mass."""
        if self.load is not None:
            return self.load
        identified = {load.name: load.parameters[0].value for load in self.file.record.model.loads}
        masses = [
            identified.get(load.load.name, load.load.mass or 0.0) for load in self.file.record.loads
        ]
        return max(masses, default=0.0)

    @property
    def label(self) -> str:
        """Name of the recording."""
        return self.name or self.file.record.log


def recorded(
    files: Sequence[FactorFile], times: Sequence[datetime] | None = None
) -> list[DriftRecording]:
    """Factor files in the order of time, by what is given, their stamps, or dates in their names.

    Raises:
        RecordingError: nothing says when one was made.
    """
    stamps = [_time(file) for file in files] if times is None else times
    recordings = [DriftRecording(file, time) for file, time in zip(files, stamps, strict=True)]
    return sorted(recordings, key=lambda recording: recording.time)


def _time(file: FactorFile) -> datetime:
    record = file.record
    if record.first > _SINCE_1970:
        return datetime.fromtimestamp(record.first, UTC).replace(tzinfo=None)
    reason = (
        f"nothing says when {record.log} was made: its stamps do not count from 1970, and its name "
        "has no date"
    )
    if match := DATE.search(record.log):
        try:
            return datetime_of(match)
        except ValueError:
            reason = f"the date in {record.log} is none"
    raise RecordingError(
        reason,
        where=file.path or record.log,
        cure="name recordings by their date, such as line1-2026-01-31.csv, and gather them again; "
        "or give times",
    )


@dataclass(frozen=True)
class DriftSettings:
    """Settings of the search for drift.

    Attributes:
        limit: friction that is too much, as a share of what it was before the change (1.5) or as a
            mean torque [N m or N]; None if not given.
        limit_is: which of both.
        false_alarms: a robot may have so many a year, over all of its drives.
        since: earlier recordings are excluded, such as those before a repair.
    """

    limit: float | None = None
    limit_is: Literal["share", "torque"] = "share"
    false_alarms: float = 0.1
    since: datetime | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that cannot be.

        Raises:
            DeltaidError: a limit that is passed already, or no false alarm at all.
        """
        lowest = 1.0 if self.limit_is == "share" else 0.0
        if self.limit is not None and not self.limit > lowest:
            raise DeltaidError(
                f"must be above {lowest:g}, not {self.limit:g}",
                where="limit",
                cure="give a share of the friction before the change, such as 1.5, or a torque",
            )
        if not 0.0 < self.false_alarms <= 10.0:
            raise DeltaidError(
                f"must be above 0 and at most 10, not {self.false_alarms:g}",
                where="false_alarms",
                cure="give how many false alarms a robot may have in a year, such as 0.1",
            )
