"""Fits of a fleet: each robot in each period, and in all, from the factors of its recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import polars as pl

from deltaid.errors import DeltaidError, RecordingError
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fleet import period_of
from deltaid.fleets.gather_one import ALONE, Outcome, poor
from deltaid.fleets.identify_gathered import identify_gathered
from deltaid.fleets.keys import FIT_SETTINGS, digest
from deltaid.fleets.place import Place
from deltaid.fleets.store import StoreError
from deltaid.model.options import Period
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.parallel import threads
from deltaid.robot.description import RobotDescription

# Of fits whose tables have not been written yet.
JOURNAL = "unfinished"
# All recordings of a robot.
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


@dataclass(frozen=True)
class FitJob:
    """One robot in one period: what is to be fitted.

    Attributes:
        robot, type: whose.
        periods: when, 'all' for all recordings; several where these have the same recordings.
        files: factor files seen from the fleet's folder, in the order of time.
        key: checksum of all that the fit follows from.
        description: of the robot.
        settings: of the fit.
    """

    robot: str
    type: str
    periods: tuple[str, ...]
    files: tuple[str, ...]
    key: str
    description: RobotDescription = field(compare=False)
    settings: Settings = field(compare=False)


@dataclass(frozen=True)
class Fitted:
    """What became of it: rows of tables, or a reason.

    Attributes:
        job: which.
        tables: by name, such as 'parameters', if they were made in this call.
        reason: why there are none.
        lasting: whether another call would end the same.
        damaged: factor files that cannot be read, and have to be gathered again.
    """

    job: FitJob
    tables: dict[str, pl.DataFrame] = field(default_factory=dict, compare=False)
    reason: str = ""
    lasting: bool = True
    damaged: tuple[str, ...] = ()


def fit_jobs(
    outcomes: Sequence[Outcome],
    period: Period,
    descriptions: dict[str, RobotDescription],
    settings: Settings,
) -> list[FitJob]:
    """All fits that recordings ask for: by robot, its periods in order and then all of them."""
    robots: dict[tuple[str, str], dict[str, list[Outcome]]] = {}
    for one in sorted(outcomes, key=lambda one: one.recorded):
        if one.file:
            own = robots.setdefault((one.recorded.robot, one.recorded.type), {})
            own.setdefault(period_of(one.recorded.time, period), []).append(one)
    fit = settings.model_dump(mode="json", include=FIT_SETTINGS)
    common = {
        kind: digest([version("deltaid"), one.model_dump(mode="json"), fit])
        for kind, one in descriptions.items()
    }
    return [
        FitJob(
            robot, kind, names,
            tuple(one.file for one in own),
            digest([common[kind], robot, names, sorted((one.sha256, one.file) for one in own)]),
            descriptions[kind], settings,
        )
        for (robot, kind), periods in robots.items()
        for names, own in _with_all(periods)
    ]  # fmt: skip


def _with_all(periods: dict[str, list[Outcome]]) -> list[tuple[tuple[str, ...], list[Outcome]]]:
    """Periods, and all of them together; the only one is all."""
    if len(periods) == 1:
        ((name, own),) = periods.items()
        return [(tuple(dict.fromkeys((name, ALL))), own)]
    every = [one for own in periods.values() for one in own]
    return [*(((name,), own) for name, own in periods.items()), ((ALL,), every)]


def fit_period(job: FitJob, place: Place) -> Fitted:
    """Fit a robot to a period, unless that has been done in a call that was ended before its end.

    What cannot be fitted has its reason, and is no error.
    """
    with ALONE, threads(1):
        try:
            done = place.finished(_journal(job, PARAMETERS))
            if done is not None:
                return Fitted(job, {PARAMETERS: done})
            files, damaged = _read(job, place)
            if damaged:
                reason = f"{damaged[0]} is damaged\n  → call again: it is gathered anew"
                return Fitted(job, reason=reason, lasting=False, damaged=damaged)
            model = identify_gathered(job.description, files, job.settings).model
            table = parameter_rows(job, model, files)
            if ALL in job.periods:
                _save(model, model_file(job.robot), place)
            place.save(_journal(job, PARAMETERS), table)
        except DeltaidError as error:
            return Fitted(job, reason=str(error), lasting=not isinstance(error, StoreError))
    return Fitted(job, {PARAMETERS: table})


def parameter_rows(
    job: FitJob, model: IdentifiedModel, files: Sequence[FactorFile]
) -> pl.DataFrame:
    """A fit as rows of the table of parameters."""
    verdicts, worst = poor(list(files)), max(model.fit.nrmse)
    rows = [
        (job.robot, job.type, period, len(files), one.name, one.value, one.std, one.low,
         one.high, one.unit, one.prior, one.determined_by, model.fit.noise_level, worst, verdicts,
         job.key)
        for period in job.periods
        for one in model.parameters
    ]  # fmt: skip
    return pl.DataFrame(rows, schema=SCHEMA, orient="row")


def model_file(robot: str) -> str:
    """Where the model of a robot is, by all of its recordings."""
    return f"{MODELS}/{robot}.yaml"


def _save(model: IdentifiedModel, name: str, place: Place) -> None:
    with TemporaryDirectory(prefix="deltaid-") as folder:
        path = Path(folder) / "model.yaml"
        model.save(path)
        place.store.write(place.at(name), path.read_bytes())


def _read(job: FitJob, place: Place) -> tuple[list[FactorFile], tuple[str, ...]]:
    """Factor files, and the names of those that cannot be read."""
    files, damaged = list[FactorFile](), list[str]()
    for name in job.files:
        try:
            files.append(place.factors(name))
        except RecordingError:
            damaged.append(name)
    return files, tuple(damaged)


def _journal(job: FitJob, table: str) -> str:
    return f"{JOURNAL}/{job.key}-{table}.parquet"
