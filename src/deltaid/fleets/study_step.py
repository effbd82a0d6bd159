"""What a robot's recordings say together beside parameters: drift, and what it tells of its type.

Each robot is one task; what it comes to is kept, so that robots without news cost nothing.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.drift_recorded import Recorded as Dated
from deltaid.fleets.drift_settings import DriftSettings
from deltaid.fleets.drift_tables import DRIFT, FRICTION, drift_table, friction_table
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fit_step import ALL, JOURNAL, Fitted, model_file
from deltaid.fleets.fleet import Recorded
from deltaid.fleets.gather_one import ALONE, Outcome
from deltaid.fleets.keys import digest
from deltaid.fleets.member import member
from deltaid.fleets.members import packed
from deltaid.fleets.place import Place
from deltaid.fleets.robot_drift import robot_drift
from deltaid.fleets.store import StoreError
from deltaid.model.model import load
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.parallel import threads
from deltaid.robot.description import RobotDescription

MEMBERS = "members"
# Tables of drift: the bound of false alarms as a number, and in words.
TABLES = {
    "friction": {**FRICTION, "key": pl.String},
    "drift": {**DRIFT, "false_alarms": pl.Float64, "bound": pl.String, "key": pl.String},
}


@dataclass(frozen=True)
class StudyJob:
    """A robot with all of its recordings.

    Attributes:
        robot, type: whose.
        files: factor files, in the order of time.
        recorded: what the manifest says of each.
        key: checksum of all that it follows from.
        description: of the robot.
        settings: of the fit.
        drift: of what is said of drift.
    """

    robot: str
    type: str
    files: tuple[str, ...] = field(compare=False)
    recorded: tuple[Recorded, ...] = field(compare=False)
    key: str
    description: RobotDescription = field(compare=False)
    settings: Settings = field(compare=False)
    drift: DriftSettings = field(compare=False)

    @property
    def member_file(self) -> str:
        """Where it is kept what the robot tells of its type."""
        return f"{MEMBERS}/{self.robot}-{self.key[:12]}.npz"


@dataclass(frozen=True)
class Studied:
    """What became of it.

    Attributes:
        job: which.
        tables: of drift, by name, if they were made in this call.
        reasons: why something is missing, by what: 'drift', 'type'.
        lasting: whether another call would end the same.
    """

    job: StudyJob
    tables: dict[str, pl.DataFrame] = field(default_factory=dict, compare=False)
    reasons: dict[str, str] = field(default_factory=dict, compare=False)
    lasting: bool = True


def study_jobs(
    fits: Sequence[Fitted], outcomes: Iterable[Outcome], drift: DriftSettings
) -> list[StudyJob]:
    """One for each robot that has been fitted by all of its recordings."""
    by_file = {one.file: one.recorded for one in outcomes if one.file}
    jobs = list[StudyJob]()
    for one in fits:
        if ALL not in one.job.periods or one.reason:
            continue
        job = one.job
        recorded = tuple(by_file[name] for name in job.files)
        known = [(str(x.time), x.load, x.temperature, x.path) for x in recorded]
        asked = {key: str(value) for key, value in asdict(drift).items()}
        key = digest([version("deltaid"), job.key, known, asked])
        jobs.append(
            StudyJob(
                job.robot, job.type, job.files, recorded, key, job.description, job.settings, drift
            )
        )
    return jobs


def study_robot(job: StudyJob, place: Place) -> Studied:
    """Drift of a robot, and what it tells of its type, unless a call before has come to that."""
    tables, reasons, lasting = dict[str, pl.DataFrame](), dict[str, str](), True
    with ALONE, threads(1):
        try:
            done = {name: place.finished(_journal(job, name)) for name in TABLES}
            if all(one is not None for one in done.values()) and place.size(job.member_file):
                return Studied(job, {name: x for name, x in done.items() if x is not None})
            files = [place.factors(name) for name in job.files]
            model = _model(job, place)
        except DeltaidError as error:
            return Studied(job, {}, dict.fromkeys(("drift", "type"), str(error)), lasting=False)
        try:
            tables = drift_tables(job, files, model)
            for name, table in tables.items():
                place.save(_journal(job, name), table)
        except DeltaidError as error:
            reasons["drift"], lasting = str(error), not isinstance(error, StoreError)
        try:
            found = member(job.robot, files, job.description, job.settings)
            place.store.write(place.at(job.member_file), packed(found))
        except DeltaidError as error:
            reasons["type"], lasting = str(error), lasting and not isinstance(error, StoreError)
    return Studied(job, tables, reasons, lasting)


def drift_tables(
    job: StudyJob, files: Sequence[FactorFile], model: IdentifiedModel
) -> dict[str, pl.DataFrame]:
    """Friction of each recording and what is said of each drive, as tables."""
    dated = [
        Dated(file, one.time, one.temperature, one.load, one.path)
        for file, one in zip(files, job.recorded, strict=True)
    ]
    found = robot_drift(dated, model, job.drift, name=job.robot)
    told = drift_table([found]).with_columns(
        bound=pl.col("false_alarms"), false_alarms=pl.lit(job.drift.false_alarms)
    )
    tables = {"friction": friction_table([found]), "drift": told}
    return {
        name: table.with_columns(key=pl.lit(job.key)).select(*TABLES[name])
        for name, table in tables.items()
    }


def _model(job: StudyJob, place: Place) -> IdentifiedModel:
    name = model_file(job.robot)
    data = place.store.read(place.at(name))
    if data is None:
        raise StoreError("is not there", where=place.at(name), cure="call again")
    with TemporaryDirectory(prefix="deltaid-") as folder:
        path = Path(folder) / "model.yaml"
        path.write_bytes(data)
        found = load(path).identified
    assert found is not None
    return found


def _journal(job: StudyJob, table: str) -> str:
    return f"{JOURNAL}/{job.key}-{table}.parquet"
