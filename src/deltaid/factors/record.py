"""What a factor file says of its recording beside the factors."""

from typing import Annotated

from pydantic import Field

from deltaid.model.record import IdentifiedModel
from deltaid.recording.carried import Load
from deltaid.robot.description import RobotDescription
from deltaid.robot.part import Part

# Version of the file. It counts up with anything that older programs would misread.
FORMAT = 1

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


class KnownLag(Part):
    """What is known of a drive's lag beside what has been put right, from rows that no fit sees."""

    drive: str
    delay: float = Field(description="put right already, s")
    beside: float = Field(default=0.0, description="known beside that, s")
    deviation: float | None = Field(default=None, description="its standard deviation, s")


class GatheredLoad(Part):
    """A load that is held, and its parameters that have been taken out of the torques."""

    load: Load
    taken: tuple[float, ...]


class SeenVerdict(Part):
    """A verdict of the checks."""

    key: str
    grade: str
    subject: str = ""
    seen: str
    cause: str = ""
    cure: str = ""
    number: float | None = None
    unit: str = ""


class Temperature(Part):
    """A recorded temperature, °C."""

    mean: float
    low: float
    high: float


class FactorRecord(Part):
    """What a recording's factors rest on.

    Attributes:
        robot: as it was described when the recording was gathered.
        model: what the recording says by itself.
        names: of the gathered columns.
        felt: places of those that each drive feels.
        quantities: that may be off, with what they do to the rows.
        noise: level of each drive's filtered torque that its own fit leaves [N m or N].
        fastest: largest speed of each drive [rad/s or m/s].
        first, last: stamps of the first and last row [s].
        warnings: of its survey, beside verdicts.
    """

    format: Annotated[int, Field(ge=1, le=FORMAT)] = FORMAT
    deltaid: str
    robot: RobotDescription
    model: IdentifiedModel
    names: tuple[str, ...]
    felt: tuple[tuple[int, ...], ...]
    quantities: tuple[str, ...] = ()
    noise: tuple[float, ...]
    fastest: tuple[float, ...]
    first: float
    last: float
    reach: Box
    lags: tuple[KnownLag, ...] = ()
    loads: tuple[GatheredLoad, ...] = ()
    temperature: Temperature | None = None
    verdicts: tuple[SeenVerdict, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def log(self) -> str:
        """Name of the recording."""
        return self.model.sources[0].log

    @property
    def sha256(self) -> str:
        """Its checksum."""
        return self.model.sources[0].sha256
