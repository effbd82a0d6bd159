"""What a fleet does once recordings are gathered: fits by period, drift, types.

A job is a robot in a period, a robot with all of its recordings, or a type; what it comes to is
kept, so that robots without news cost nothing.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version

import numpy as np
import polars as pl

from deltaid.fleets.block_tree import merged_recordings
from deltaid.fleets.drift_findings import DriftSettings
from deltaid.fleets.drift_friction import series_of
from deltaid.fleets.drift_recording import DriftRecording
from deltaid.fleets.drift_tables import DRIFT, FRICTION, drift_table, friction_table
from deltaid.fleets.factor_file import FIT_SETTINGS, digest, safe
from deltaid.fleets.fleet import Recorded, period_of
from deltaid.fleets.gather_all import poor
from deltaid.fleets.identify_gathered import identify_merged
from deltaid.fleets.known import GatherResult
from deltaid.fleets.member import TypeMember, member_of, read_member, write_member
from deltaid.fleets.mixed_model import NORMAL
from deltaid.fleets.place import Place
from deltaid.fleets.population import MEMBERS, TYPES, members_table, save_next, types_table
from deltaid.fleets.robot_drift import drift_of, kept_since
from deltaid.fleets.robot_recordings import RobotRecordings
from deltaid.fleets.step import Chain, FleetJob, FleetStep, JobResult, Leaf, Tables
from deltaid.fleets.type_fit import PopulationSettings, fitted
from deltaid.model.options import Period
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.robot.description import RobotDescription

# The period of all recordings of a robot.
ALL = "all"
# Folder of what robots tell of their types.
MEMBERS_FOLDER = "members"
# Folder of blocks of merged recordings: of each robot those of all, and those of a long period.
BLOCKS = "merged"
PARAMETERS = {
    "robot": pl.String,
    "type": pl.String,
    "period": pl.String,
    "recordings": pl.Int64,
    "parameter": pl.String,
    "value": pl.Float64,
    "std": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
    "unit": pl.String,
    "prior": pl.Float64,
    "decided_by": pl.String,
    "noise": pl.Float64,
    "worst_error": pl.Float64,
    "verdicts": pl.String,
}
_KEY = {"key": pl.String}


def fit_jobs(
    outcomes: Sequence[GatherResult],
    period: Period,
    descriptions: Mapping[str, RobotDescription],
    settings: Settings,
) -> list[FleetJob]:
    """All fits that recordings ask for: by robot, its periods in order and then all of them."""
    robots: dict[tuple[str, str], dict[str, list[GatherResult]]] = {}
    for outcome in sorted(outcomes, key=lambda outcome: outcome.recorded):
        if outcome.file:
            recorded = outcome.recorded
            periods = robots.setdefault((recorded.robot, recorded.type), {})
            periods.setdefault(period_of(recorded.time, period), []).append(outcome)
    fit = settings.model_dump(mode="json", include=FIT_SETTINGS)
    common = {
        kind: digest([version("deltaid"), description.model_dump(mode="json"), fit])
        for kind, description in descriptions.items()
    }
    jobs = list[FleetJob]()
    for (robot, kind), periods in robots.items():
        for names, used in _with_all(periods):
            leaves = tuple(Leaf(x.file, x.sha256, x.recorded.time) for x in used)
            sources = sorted((leaf.sha256, leaf.file) for leaf in leaves)
            key = digest([common[kind], robot, names, sources])
            jobs.append(
                FleetJob(robot, kind, names, tuple(leaf.file for leaf in leaves), key,
                         descriptions[kind], settings, leaves, common[kind],
                         f"{BLOCKS}/{safe(robot)}/{ALL if ALL in names else 'period'}")
            )  # fmt: skip
    return jobs


def _with_all(
    periods: dict[str, list[GatherResult]],
) -> list[tuple[tuple[str, ...], list[GatherResult]]]:
    """Periods, and all of them together; the only one is all."""
    if len(periods) == 1:
        ((name, used),) = periods.items()
        return [(tuple(dict.fromkeys((name, ALL))), used)]
    every = [outcome for used in periods.values() for outcome in used]
    return [*(((name,), used) for name, used in periods.items()), ((ALL,), every)]


def _model_file(job: FleetJob) -> str:
    """Where the model of a robot is, by all of its recordings."""
    return f"models/{job.robot}.yaml"


def _fit(job: FleetJob, recordings: RobotRecordings, place: Place) -> Tables:
    """The rows of the table of parameters, and the model where it is of all recordings."""
    model = identify_merged(recordings, job.description, job.settings).model
    if ALL in job.names:
        place.save_model(_model_file(job), model)
    briefs = recordings.briefs
    verdicts, worst = poor(briefs), max(model.fit.nrmse)
    of_fit = (model.fit.noise_level, worst, verdicts)
    rows = [
        (job.robot, job.type, period, len(briefs), parameter.name, parameter.value, parameter.std,
         parameter.low, parameter.high, parameter.unit, parameter.prior, parameter.determined_by,
         *of_fit)
        for period in job.names
        for parameter in model.parameters
    ]  # fmt: skip
    rows += [
        (job.robot, job.type, period, len(briefs), *gain, *of_fit)
        for period in job.names
        for gain in gain_rows(model)
    ]
    return {"parameters": pl.DataFrame(rows, schema=PARAMETERS, orient="row")}


def gain_rows(model: IdentifiedModel) -> Iterator[tuple[object, ...]]:
    """Torque constants that recordings determine, as parameters: by how many times each is off."""
    for gain in model.corrections:
        if gain.kind == "gain" and gain.low is not None and gain.high is not None:
            std = (gain.high - gain.low) / (2.0 * NORMAL)
            ends = (gain.value, std, gain.low, gain.high)
            yield (f"gain.{gain.subject}", *ends, "", 1.0, "data")


def _model_of_all(job: FleetJob) -> str:
    return _model_file(job) if ALL in job.names else ""


FITS = FleetStep(
    "fit", merged_recordings, _fit, {"parameters": PARAMETERS | _KEY}, _model_of_all, leads=True
)


@dataclass(frozen=True)
class StudyJob(FleetJob):
    """A robot with all of its recordings.

    Attributes:
        recorded: what the manifest says of each.
        drift: settings of the search for drift.
    """

    recorded: tuple[Recorded, ...] = ()
    drift: DriftSettings = field(default_factory=DriftSettings)


def _study(
    fit: FleetJob, recorded: Mapping[str, Recorded], drift: DriftSettings, asked: Mapping[str, str]
) -> StudyJob:
    """What follows from the fit of all recordings of a robot; `recorded` by factor file."""
    own = tuple(recorded[name] for name in fit.files)
    known = [(str(x.time), x.load, x.temperature, x.path) for x in own]
    key = digest([version("deltaid"), fit.key, known, asked])
    robot = (fit.robot, fit.type, (fit.type,), fit.files, key, fit.description, fit.settings)
    return StudyJob(*robot, fit.leaves, fit.common, fit.blocks, own, drift)


def _with_model(job: StudyJob, place: Place) -> tuple[RobotRecordings, IdentifiedModel]:
    return merged_recordings(job, place), place.model(_model_file(job))


def _drift(job: StudyJob, given: tuple[RobotRecordings, IdentifiedModel], place: Place) -> Tables:
    del place
    recordings, model = given
    known = dict(zip(job.files, job.recorded, strict=True))
    number = {brief.sha256: k for k, brief in enumerate(recordings.briefs)}
    each = [(brief, known[brief.path]) for brief in recordings.briefs]
    kept = kept_since(
        [DriftRecording(brief, x.time, x.temperature, x.load, x.path) for brief, x in each],
        job.drift,
    )
    sums = recordings.block.friction.only(np.array([number[log.brief.sha256] for log in kept]))
    friction = series_of(sums, recordings.merging, model)
    drift = drift_of(kept, friction, model, job.drift, job.robot)
    table = drift_table([drift]).with_columns(
        bound=pl.col("false_alarms"), false_alarms=pl.lit(job.drift.false_alarms)
    )
    return {"friction": friction_table([drift]), "drift": table}


DRIFTS = FleetStep(
    "drift",
    _with_model,
    _drift,
    {  # the bound of false alarms as a number, and in words
        "friction": FRICTION | _KEY,
        "drift": {**DRIFT, "false_alarms": pl.Float64, "bound": pl.String, **_KEY},
    },
)


def member_file(job: FleetJob) -> str:
    """Where it is kept what a robot tells of its type."""
    return f"{MEMBERS_FOLDER}/{job.robot}-{job.key[:12]}.npz"


def _member(job: FleetJob, recordings: RobotRecordings, place: Place) -> Tables:
    """What the robot tells of its type, as a file."""
    robot = member_of(job.robot, recordings, job.settings)
    place.save_file(member_file(job), lambda path: write_member(robot, path))
    return {}


ROBOTS = FleetStep("type", merged_recordings, _member, file=member_file)


def robot_chains(
    fits: Iterable[FleetJob], outcomes: Iterable[GatherResult], drift: DriftSettings
) -> list[Chain]:
    """Fits, and what follows from those of all recordings of a robot."""
    recorded = {outcome.file: outcome.recorded for outcome in outcomes if outcome.file}
    asked = {key: str(value) for key, value in asdict(drift).items()}
    chains = list[Chain]()
    for fit in fits:
        chain: Chain = ((FITS, fit),)
        if ALL in fit.names:
            study = _study(fit, recorded, drift, asked)
            chain += ((DRIFTS, study), (ROBOTS, study))
        chains.append(chain)
    return chains


def type_jobs(robots: Iterable[JobResult]) -> list[FleetJob]:
    """One for each type that has robots."""
    types: dict[str, list[FleetJob]] = {}
    for robot in robots:
        if not robot.reason:
            types.setdefault(robot.job.type, []).append(robot.job)
    jobs = list[FleetJob]()
    for kind, members in sorted(types.items()):
        key = digest([version("deltaid"), kind, sorted(job.key for job in members)])
        files, first = tuple(map(member_file, members)), members[0]
        jobs.append(FleetJob("", kind, (kind,), files, key, first.description, first.settings))
    return jobs


def next_robot_file(job: FleetJob) -> str:
    """Where the description of the next robot of a type is."""
    return f"types/{safe(job.type.removesuffix('.yaml'))}.yaml"


def _members(job: FleetJob, place: Place) -> list[TypeMember]:
    return [read_member(place.read(name) or b"", place.path_to(name)) for name in job.files]


def _type(job: FleetJob, members: list[TypeMember], place: Place) -> Tables:
    """The type's mean and spreads, and its robots within it; the next robot's description."""
    population = fitted(members, job.description, PopulationSettings(fit=job.settings))
    place.save_file(next_robot_file(job), lambda path: save_next(population, place.name, path))
    return {
        "types": types_table(job.type, population),
        "members": members_table(job.type, population),
    }


TYPE_FITS = FleetStep(
    "type",
    _members,
    _type,
    {"types": TYPES | _KEY, "members": MEMBERS | _KEY},
    next_robot_file,
)
STEPS = (FITS, DRIFTS, ROBOTS, TYPE_FITS)
TABLES = {name: columns for step in STEPS for name, columns in step.tables.items()}
