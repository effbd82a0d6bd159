"""Fits of a fleet: each robot in each period, and in all, from the factors of its recordings."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version

import polars as pl

from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fleet import period_of
from deltaid.fleets.gather_one import GatherResult, poor
from deltaid.fleets.identify_gathered import identify_gathered
from deltaid.fleets.keys import FIT_SETTINGS, digest
from deltaid.fleets.place import Place
from deltaid.fleets.step import FleetJob, FleetStep, StepPart, Tables, read_factors
from deltaid.model.options import Period
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription

# The period of all recordings of a robot.
ALL = "all"
PARAMETERS, MODELS = "parameters", "models"
SCHEMA = {
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
    "key": pl.String,
}


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
        for names, own in _with_all(periods):
            files = tuple(outcome.file for outcome in own)
            sources = sorted((outcome.sha256, outcome.file) for outcome in own)
            key = digest([common[kind], robot, names, sources])
            jobs.append(FleetJob(robot, kind, names, files, key, descriptions[kind], settings))
    return jobs


def _with_all(
    periods: dict[str, list[GatherResult]],
) -> list[tuple[tuple[str, ...], list[GatherResult]]]:
    """Periods, and all of them together; the only one is all."""
    if len(periods) == 1:
        ((name, own),) = periods.items()
        return [(tuple(dict.fromkeys((name, ALL))), own)]
    every = [outcome for own in periods.values() for outcome in own]
    return [*(((name,), own) for name, own in periods.items()), ((ALL,), every)]


def model_file(robot: str) -> str:
    """Where the model of a robot is, by all of its recordings."""
    return f"{MODELS}/{robot}.yaml"


def _fit(job: FleetJob, files: list[FactorFile], place: Place) -> Tables:
    """The rows of the table of parameters, and the model where it is of all recordings."""
    model = identify_gathered(job.description, files, job.settings).model
    if ALL in job.names:
        place.save_file(model_file(job.robot), model.save)
    verdicts, worst = poor(files), max(model.fit.nrmse)
    rows = [
        (job.robot, job.type, period, len(files), parameter.name, parameter.value, parameter.std,
         parameter.low, parameter.high, parameter.unit, parameter.prior, parameter.determined_by,
         model.fit.noise_level, worst, verdicts, job.key)
        for period in job.names
        for parameter in model.parameters
    ]  # fmt: skip
    return {PARAMETERS: pl.DataFrame(rows, schema=SCHEMA, orient="row")}


def _model_of_all(job: FleetJob) -> str:
    return model_file(job.robot) if ALL in job.names else ""


FITS = FleetStep(
    ("fitted", "periods"),
    read_factors,
    {"fit": StepPart(_fit, {PARAMETERS: SCHEMA}, _model_of_all)},
)
