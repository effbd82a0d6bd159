"""One recording of a fleet, gathered by whichever process gets it."""

from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path

from deltaid.errors import DeltaidError, RecordingError
from deltaid.fleets.cluster import ALONE
from deltaid.fleets.factor_file import ENDING, FactorFile, write
from deltaid.fleets.fleet import Recorded
from deltaid.fleets.gather import gathered
from deltaid.fleets.keys import digest, safe, ways
from deltaid.fleets.place import Place
from deltaid.fleets.store import StoreError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.record import Settings
from deltaid.parallel import threads
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.opening import open_log
from deltaid.robot.description import RobotDescription

FACTORS = "factors"


@dataclass(frozen=True)
class How:
    """What a recording is gathered with.

    Attributes:
        robot: whose it is.
        mapping: of its columns.
        settings: of filter, masks and corrections.
        force: go on with what the checks call wrong.
    """

    robot: RobotDescription
    mapping: ColumnMapping | None
    settings: Settings
    force: bool = False

    @cached_property
    def digest(self) -> str:
        """A checksum of all this."""
        return digest([ways(self.robot, self.mapping, self.settings), self.force])

    def holding(self, mass: float | None, where: str) -> "How":
        """The same for a recording with a mass that was held all the time, 0 for none.

        Raises:
            RecordingError: its mapping says as well what is held.
        """
        if mass is None:
            return self
        if self.mapping is not None and self.mapping.load is not None:
            raise RecordingError(
                "its mapping and the manifest both say what it holds",
                where=where,
                cure="say it in one of them",
            )
        if not mass:
            return self
        # Loads of one name are the same thing, so those of another mass have another name.
        load = Load(always=True, mass=mass, name=f"load-{round(1e6 * mass)}mg")
        return replace(self, mapping=(self.mapping or ColumnMapping()).changed(load=load))


@dataclass(frozen=True)
class GatherJob:
    """A recording that is to be gathered, how, and the checksum of all that follows from."""

    recorded: Recorded
    how: How
    key: str

    @classmethod
    def for_recording(cls, recorded: Recorded, how: How) -> "GatherJob":
        """By the recording's stamp: nothing is read for it."""
        known = [recorded.path, recorded.stamp, how.digest, version("deltaid")]
        return cls(recorded, how, digest(known))

    @property
    def file(self) -> str:
        """Name of the factor file, seen from the fleet's folder."""
        robot, log = safe(self.recorded.robot), safe(Path(self.recorded.path).stem)
        return f"{FACTORS}/{robot}/{log}-{self.key[:12]}{ENDING}"


@dataclass(frozen=True)
class GatherResult:
    """What became of one recording.

    Attributes:
        recorded: which.
        key: checksum of what its factors follow from; empty where another call may end otherwise.
        file: its factor file, seen from the fleet's folder; empty if it was refused.
        reason: why it is in quarantine; empty if it is not.
        is_new: whether it was looked at now.
        size: of the factor file [bytes].
        sha256: of the recording.
        samples: of the recording.
        verdicts: of its checks that are not good, by name.
    """

    recorded: Recorded
    key: str
    file: str = ""
    reason: str = ""
    is_new: bool = True
    size: int = 0
    sha256: str = ""
    samples: int = 0
    verdicts: str = ""


def gather_recorded(job: GatherJob, place: Place) -> GatherResult:
    """Gather a recording into a fleet's folder, unless it is there.

    A recording that cannot be used is an outcome with its reason, and no error.
    """
    with ALONE:
        try:
            file = there = place.factors(job.file, job.key)
            if file is None:
                file = _gathered(job, place)
            size = place.size(job.file)
        except StoreError as error:
            return GatherResult(job.recorded, "", reason=str(error))
        except DeltaidError as error:
            return GatherResult(job.recorded, job.key, reason=str(error))
    record = file.record
    return GatherResult(
        job.recorded,
        job.key,
        file=job.file,
        is_new=there is None,
        size=size,
        sha256=record.sha256,
        samples=record.model.sources[0].samples,
        verdicts=poor([file]),
    )


def suggested_cutoff(job: GatherJob, place: Place) -> float | None:
    """The cut-off that a recording asks for [Hz], of two digits; None where it cannot be used."""
    with ALONE, threads(1):
        try:
            with place.store.local(job.recorded.path) as path:
                kinematics = Kinematics(job.how.robot)
                log = open_log(
                    path, kinematics, job.how.mapping, keep_all=job.how.settings.keep_all
                )
            cutoff = log.suggested_cutoff
        except (DeltaidError, FileNotFoundError):
            return None
    return None if cutoff is None else float(f"{cutoff:.2g}")


def poor(files: list[FactorFile]) -> str:
    """Names of verdicts that are not good, joined."""
    verdicts = (verdict for file in files for verdict in file.record.verdicts)
    return ", ".join(sorted({verdict.key for verdict in verdicts if verdict.grade in _POOR}))


_POOR = ("wrong", "doubtful")


def _gathered(job: GatherJob, place: Place) -> FactorFile:
    recorded, how = job.recorded, job.how
    try:
        with place.store.local(recorded.path, recorded.stamp) as path, threads(1):
            try:
                file = gathered(
                    how.robot, path, columns=how.mapping, settings=how.settings, force=how.force
                )
            except RecordingError as error:  # of a copy, which the user has not seen
                where = error.where.replace(str(path), recorded.path)
                raise RecordingError(error.what, where=where, cure=error.cure) from None
    except FileNotFoundError:
        raise StoreError(
            "is no longer there", where=recorded.path, cure="check the manifest"
        ) from None
    place.save_file(job.file, lambda path: write(file, path, job.key))
    return file
