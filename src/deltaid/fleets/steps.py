"""Steps of a fleet after gathering: fits by period, drift, types.

A job is a robot in a period, a robot with all of its recordings, or a type. Results are kept, so
robots without new recordings cost nothing.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version

import numpy as np
import polars as pl

from deltaid.estimation.scatter import NORMAL
from deltaid.fleets.drift_findings import DriftSettings
from deltaid.fleets.drift_friction import series_of
from deltaid.fleets.drift_tables import DRIFT, FRICTION, drift_table, friction_table
from deltaid.fleets.factor_file import FIT_SETTINGS, digest, safe
from deltaid.fleets.fleet import ALL, PERIODS
from deltaid.fleets.gather_all import RECORDINGS_SCHEMA, poor
from deltaid.fleets.gather_plan import GatherResult
from deltaid.fleets.identify_gathered import identify_merged
from deltaid.fleets.member import TypeMember, member, member_bytes, read_member
from deltaid.fleets.place import RECORDINGS, Place, Tables
from deltaid.fleets.population import MEMBERS, TYPES, members_table, next_robot, types_table
from deltaid.fleets.robot_drift import DriftRecording, drift_of, kept_since
from deltaid.fleets.robot_recordings import RobotRecordings, merged_recordings
from deltaid.fleets.step import Chain, FleetJob, FleetStep, JobResult
from deltaid.fleets.type_fit import fitted
from deltaid.grouping import grouped
from deltaid.model.options import Period
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import save_yaml

# Folder of robots' contributions to their types.
MEMBERS_FOLDER = "members"
# Folder of blocks of merged recordings: for each robot, of all recordings and of its periods.
BLOCKS = "merged"
PARAMETERS = {
    **dict.fromkeys(("robot", "type", "period"), pl.String),
    **{"recordings": pl.Int64, "parameter": pl.String},
    **dict.fromkeys(("value", "std", "low", "high"), pl.Float64),
    **{"unit": pl.String, "prior": pl.Float64, "decided_by": pl.String},
    **{"noise": pl.Float64, "worst_error": pl.Float64, "verdicts": pl.String},
}
_KEY = {"key": pl.String}


def _fit(job: FleetJob, recordings: RobotRecordings, place: Place) -> Tables:
    """Rows of the table of parameters; saves the model if it is of all recordings."""
    model = identify_merged(recordings, job.description, job.settings).model
    if job.file:
        place.save_model(job.file, model)
    briefs = recordings.block.briefs
    of_fit = (model.fit.noise_level, max(model.fit.nrmse), poor(briefs))
    identified = [
        (x.name, x.value, x.std, x.low, x.high, x.unit, x.prior, x.determined_by)
        for x in model.parameters
    ]
    rows = [
        (job.robot, job.type, period, len(briefs), *parameter, *of_fit)
        for parameters in (identified, list(gain_rows(model)))
        for period in job.names
        for parameter in parameters
    ]
    return {"parameters": pl.DataFrame(rows, schema=PARAMETERS, orient="row")}


def gain_rows(model: IdentifiedModel) -> Iterator[tuple[object, ...]]:
    """Determined torque constants as parameters: the factor of each."""
    for gain in model.corrections:
        if gain.kind == "gain" and gain.low is not None and gain.high is not None:
            std = (gain.high - gain.low) / (2.0 * NORMAL)
            yield f"gain.{gain.subject}", gain.value, std, gain.low, gain.high, "", 1.0, "data"


def _with_model(job: FleetJob, place: Place) -> tuple[RobotRecordings, IdentifiedModel]:
    """Recordings and model of a robot; a named function, because processes cannot pass lambdas."""
    return merged_recordings(job, place), place.model(_model_file(job.robot))


def _model_file(robot: str) -> str:
    return f"models/{robot}.yaml"


def _drift(job: FleetJob, given: tuple[RobotRecordings, IdentifiedModel], _: Place) -> Tables:
    recordings, model = given
    recorded = {outcome.file: outcome.recorded for outcome in job.recordings}
    briefs = recordings.block.briefs
    number = {brief.sha256: k for k, brief in enumerate(briefs)}
    each = [(brief, recorded[brief.path]) for brief in briefs]
    kept = kept_since(
        [DriftRecording(brief, x.time, x.temperature, x.load, x.path) for brief, x in each],
        job.drift,
    )
    sums = recordings.block.friction.only(np.array([number[log.brief.sha256] for log in kept]))
    drift = drift_of(kept, series_of(sums, recordings.merging, model), model, job.drift, job.robot)
    return {
        "friction": friction_table(drift),
        "drift": drift_table(drift).with_columns(
            bound=pl.col("false_alarms"), false_alarms=pl.lit(job.drift.false_alarms)
        ),
    }


def _member(job: FleetJob, recordings: RobotRecordings, place: Place) -> Tables:
    place.write(job.file, member_bytes(member(job.robot, recordings, job.settings)))
    return {}


def _members(job: FleetJob, place: Place) -> list[TypeMember]:
    return [read_member(place.read(name) or b"", place.path_to(name)) for name in job.files]


def _type(job: FleetJob, members: list[TypeMember], place: Place) -> Tables:
    population = fitted(members, job.description, job.settings)
    robot = next_robot(population, place.name)
    place.save_file(job.file, lambda path: save_yaml(robot, path))
    return {
        "types": types_table(job.type, population),
        "members": members_table(job.type, population),
    }


FITS = FleetStep(
    "fit", "fit", merged_recordings, _fit, {"parameters": PARAMETERS | _KEY}, leads=True
)
DRIFTS = FleetStep(
    "drift",
    "drift",
    _with_model,
    _drift,
    {  # the bound of false alarms as a number, and in words
        "friction": FRICTION | _KEY,
        "drift": {**DRIFT, "false_alarms": pl.Float64, "bound": pl.String, **_KEY},
    },
)
ROBOTS = FleetStep("robot", "type", merged_recordings, _member)
TYPE_FITS = FleetStep(
    "type", "type", _members, _type, {"types": TYPES | _KEY, "members": MEMBERS | _KEY}
)
STEPS = (FITS, DRIFTS, ROBOTS, TYPE_FITS)
TABLES = {
    RECORDINGS: RECORDINGS_SCHEMA,
    **{name: columns for step in STEPS for name, columns in step.tables.items()},
}


def fit_jobs(
    outcomes: Sequence[GatherResult],
    period: Period,
    descriptions: Mapping[str, RobotDescription],
    settings: Settings,
) -> list[FleetJob]:
    """All fits, by robot: its periods in order, then all of them."""
    robots = grouped(
        ((outcome.recorded.robot, outcome.recorded.type), outcome)
        for outcome in sorted(outcomes, key=lambda outcome: outcome.recorded)
        if outcome.file
    )
    fit = settings.model_dump(mode="json", include=FIT_SETTINGS)
    common = {
        kind: digest([version("deltaid"), description.model_dump(mode="json"), fit])
        for kind, description in descriptions.items()
    }
    return [
        FleetJob(
            FITS,
            robot,
            kind,
            names,
            tuple(outcome.file for outcome in used),
            digest([common[kind], robot, names, sorted((x.sha256, x.file) for x in used)]),
            _model_file(robot) if ALL in names else "",
            descriptions[kind],
            settings,
            tuple(used),
            common[kind],
            f"{BLOCKS}/{safe(robot)}/{ALL if ALL in names else 'period'}",
        )
        for (robot, kind), recordings in robots.items()
        for names, used in _periods(recordings, period)
    ]


def _periods(
    every: list[GatherResult], period: Period
) -> list[tuple[tuple[str, ...], list[GatherResult]]]:
    """Periods, then all of them together; a single period is both."""
    periods = grouped(
        (outcome.recorded.time.strftime(PERIODS[period]), outcome) for outcome in every
    )
    if len(periods) == 1:
        return [(tuple(dict.fromkeys((*periods, ALL))), every)]
    return [*(((name,), used) for name, used in periods.items()), ((ALL,), every)]


def robot_chains(fits: Iterable[FleetJob], drift: DriftSettings) -> list[Chain]:
    """Chains of jobs: fits, and after the fit of all recordings of a robot its drift and its
    contribution to its type."""
    settings = {key: str(value) for key, value in asdict(drift).items()}
    chains = list[Chain]()
    for fit in fits:
        chain: Chain = (fit,)
        if ALL in fit.names:
            known = [
                (str(log.time), log.load, log.temperature, log.path)
                for log in (outcome.recorded for outcome in fit.recordings)
            ]
            key = digest([version("deltaid"), fit.key, known, settings])
            study = replace(fit, step=DRIFTS, names=(fit.type,), key=key, file="", drift=drift)
            of_robot = digest([key, ROBOTS.name])
            file = f"{MEMBERS_FOLDER}/{fit.robot}-{of_robot[:12]}.npz"
            chain = (fit, study, replace(study, step=ROBOTS, key=of_robot, file=file))
        chains.append(chain)
    return chains


def type_chains(robots: Iterable[JobResult]) -> list[Chain]:
    """One chain for each type with robots; it writes the description of the type's next robot."""
    types = grouped((robot.job.type, robot.job) for robot in robots if not robot.reason)
    jobs = (
        FleetJob(
            TYPE_FITS,
            robot="",
            type=kind,
            names=(kind,),
            files=tuple(job.file for job in members),
            key=digest([version("deltaid"), kind, sorted(job.key for job in members)]),
            file=f"types/{safe(kind.removesuffix('.yaml'))}.yaml",
            description=members[0].description,
            settings=members[0].settings,
        )
        for kind, members in sorted(types.items())
    )
    return [(job,) for job in jobs]
