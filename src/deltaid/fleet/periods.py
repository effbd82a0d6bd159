"""Fits of a fleet: each robot in each period, from the factors of its recordings."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.factors.file import read
from deltaid.factors.identify import identify_gathered
from deltaid.fleet.gathering import Outcome
from deltaid.fleet.manifest import Period, period_of
from deltaid.model.record import Settings
from deltaid.parallel import threads
from deltaid.robot.load import described

FITS = "fits"
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
}


@dataclass(frozen=True)
class PeriodFit:
    """One robot in one period: what is to be fitted.

    Attributes:
        robot, type, period: whose and when.
        files: factor files seen from the fleet's folder, in order.
    """

    robot: str
    type: str
    period: str
    files: tuple[str, ...]


@dataclass(frozen=True)
class Fitted:
    """What became of it: a table on disk, or a reason."""

    fit: PeriodFit
    table: str = ""
    reason: str = ""
    is_new: bool = False


def periods_of(outcomes: Sequence[Outcome], period: Period) -> list[PeriodFit]:
    """All fits that recordings ask for, in the order of robots and time."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for one in sorted(outcomes, key=lambda one: one.recorded):
        if one.file:
            recorded = one.recorded
            key = recorded.robot, recorded.type, period_of(recorded.time, period)
            groups.setdefault(key, []).append(one.file)
    return [PeriodFit(*key, tuple(files)) for key, files in groups.items()]


def fit_period(fit: PeriodFit, folder: Path, settings: Settings) -> Fitted:
    """Fit a robot to a period, unless its result is there.

    What cannot be fitted has its reason, and is no error.
    """
    known = "\0".join((fit.type, settings.model_dump_json(), *sorted(fit.files)))
    digest = hashlib.sha256(known.encode()).hexdigest()[:10]
    own = f"{FITS}/{fit.robot}/{fit.period}-{digest}.parquet"
    path = folder / own
    if path.is_file():
        return Fitted(fit, own)
    try:
        with threads(1):
            files = [read(folder / name) for name in fit.files]
            model = identify_gathered(described(fit.type), files, settings).model
    except DeltaidError as error:
        return Fitted(fit, reason=str(error))
    poor = sorted(
        {
            one.key
            for file in files
            for one in file.record.verdicts
            if one.grade in ("wrong", "doubtful")
        }
    )
    rows = [
        (fit.robot, fit.type, fit.period, len(files), one.name, one.value, one.std, one.low,
         one.high, one.unit, one.prior, one.determined_by, model.fit.noise_level,
         max(model.fit.nrmse), ", ".join(poor))
        for one in model.parameters
    ]  # fmt: skip
    table = pl.DataFrame(rows, schema=SCHEMA, orient="row")
    from io import BytesIO

    from deltaid.files import write_bytes

    buffer = BytesIO()
    table.write_parquet(buffer, compression="zstd")
    write_bytes(path, buffer.getvalue())
    return Fitted(fit, own, is_new=True)
