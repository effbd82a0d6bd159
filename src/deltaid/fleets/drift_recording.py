"""A recording as drift takes it: its factors; when, how warm and with which load it was made."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from deltaid.errors import RecordingError
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fleet import DATE, datetime_of
from deltaid.fleets.recording_brief import RecordingBrief

# Stamps beyond this are seconds since 1970, and not since a recording began.
_SINCE_1970 = 1e9


@dataclass(frozen=True, eq=False)
class DriftRecording:
    """One recording's factors, or its brief where they have been merged, and when it was made; for
    the rest None is what the file says.

    Attributes:
        temperature: of gears or oil [°C].
        load: mass that was held [kg].
        name: of the recording; empty for that in the factor file.
    """

    file: FactorFile | RecordingBrief
    time: datetime
    temperature: float | None = None
    load: float | None = None
    name: str = ""

    @property
    def brief(self) -> RecordingBrief:
        """What is said of it beside its factors."""
        return self.file.brief if isinstance(self.file, FactorFile) else self.file

    @property
    def degrees(self) -> float:
        """Temperature; NaN where it is not known."""
        if self.temperature is not None:
            return float(self.temperature)
        degrees = self.brief.degrees
        return float("nan") if degrees is None else degrees

    @property
    def held(self) -> float:
        """Largest mass held [kg]; the identified one of a load without a declared mass."""
        return self.brief.held if self.load is None else self.load

    @property
    def label(self) -> str:
        """Name of the recording."""
        return self.name or self.brief.log


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
