"""What a robot's recordings say together beside parameters: drift, and what it tells of its type.

Each robot is one job; what it comes to is kept, so that robots without news cost nothing.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version

import polars as pl

from deltaid.fleets.drift_inputs import DriftRecording, DriftSettings
from deltaid.fleets.drift_tables import DRIFT, FRICTION, drift_table, friction_table
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fit_step import ALL, model_file
from deltaid.fleets.fleet import Recorded
from deltaid.fleets.gather_one import GatherResult
from deltaid.fleets.keys import digest
from deltaid.fleets.member import member, write_member
from deltaid.fleets.place import Place
from deltaid.fleets.robot_drift import robot_drift
from deltaid.fleets.step import FleetJob, FleetStep, JobResult, StepPart, Tables, read_factors
from deltaid.fleets.store import StoreError
from deltaid.model.model import load
from deltaid.model.record import IdentifiedModel

MEMBERS = "members"
# Tables of drift: the bound of false alarms as a number, and in words.
TABLES = {
    "friction": {**FRICTION, "key": pl.String},
    "drift": {**DRIFT, "false_alarms": pl.Float64, "bound": pl.String, "key": pl.String},
}


@dataclass(frozen=True)
class StudyJob(FleetJob):
    """A robot with all of its recordings.

    Attributes:
        recorded: what the manifest says of each.
        drift: settings of the search for drift.
    """

    recorded: tuple[Recorded, ...]
    drift: DriftSettings


def study_jobs(
    fits: Sequence[JobResult], outcomes: Iterable[GatherResult], drift: DriftSettings
) -> list[StudyJob]:
    """One for each robot that has been fitted by all of its recordings."""
    by_file = {outcome.file: outcome.recorded for outcome in outcomes if outcome.file}
    asked = {key: str(value) for key, value in asdict(drift).items()}
    jobs = list[StudyJob]()
    for fit in (fit.job for fit in fits if ALL in fit.job.names and not fit.reasons):
        recorded = tuple(by_file[name] for name in fit.files)
        known = [(str(x.time), x.load, x.temperature, x.path) for x in recorded]
        key = digest([version("deltaid"), fit.key, known, asked])
        robot = (fit.robot, fit.type, (fit.type,), fit.files, key, fit.description, fit.settings)
        jobs.append(StudyJob(*robot, recorded, drift))
    return jobs


def member_file(job: FleetJob) -> str:
    """Where it is kept what a robot tells of its type."""
    return f"{MEMBERS}/{job.robot}-{job.key[:12]}.npz"


def _read(job: StudyJob, place: Place) -> tuple[list[FactorFile], IdentifiedModel]:
    """Factor files, and the model by all of them."""
    files, name = read_factors(job, place), model_file(job.robot)
    try:
        with place.store.local(place.path_to(name)) as path:
            model = load(path).identified
    except FileNotFoundError:
        raise StoreError("is not there", where=place.path_to(name), cure="call again") from None
    assert model is not None
    return files, model


def _drift(job: StudyJob, given: tuple[list[FactorFile], IdentifiedModel], place: Place) -> Tables:
    """Friction of each recording and what is said of each drive."""
    del place
    files, model = given
    recordings = [
        DriftRecording(file, known.time, known.temperature, known.load, known.path)
        for file, known in zip(files, job.recorded, strict=True)
    ]
    drift = robot_drift(recordings, model, job.drift, name=job.robot)
    table = drift_table([drift]).with_columns(
        bound=pl.col("false_alarms"), false_alarms=pl.lit(job.drift.false_alarms)
    )
    tables = {"friction": friction_table([drift]), "drift": table}
    return {
        name: table.with_columns(key=pl.lit(job.key)).select(*TABLES[name])
        for name, table in tables.items()
    }


def _member(job: StudyJob, given: tuple[list[FactorFile], IdentifiedModel], place: Place) -> Tables:
    """What the robot tells of its type, as a file."""
    robot = member(job.robot, given[0], job.description, job.settings)
    place.save_file(member_file(job), lambda path: write_member(robot, path))
    return {}


STUDIES = FleetStep(
    ("studied", "robots"),
    _read,
    {"drift": StepPart(_drift, TABLES), "type": StepPart(_member, file=member_file)},
)
