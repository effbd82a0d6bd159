"""Drift of one robot: friction of its drives over time, with a finding for each.

The undeclared mass of each recording is a series like friction. Where it steps, a tool was changed,
and friction may step with it without being reported as drift.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.estimation.scatter import ROBUST
from deltaid.fleets.drift_evidence import FEWEST, Changes
from deltaid.fleets.drift_findings import Between, DriftFinding, DriftSettings, finding
from deltaid.fleets.drift_friction import FrictionSeries, friction_series
from deltaid.fleets.drift_series import FLAT, Regressors, evidence_of, explained, in_percent
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.factor_record import RecordingBrief
from deltaid.fleets.fleet import DATE, date_within
from deltaid.levels import SURE
from deltaid.model.record import IdentifiedModel

# Stamps above this count seconds from 1970, smaller ones from the start of a recording.
_SINCE_1970 = 1e9


@dataclass(frozen=True, eq=False)
class DriftRecording:
    """One recording's factors, or its brief after merging, and its time.

    Attributes:
        temperature: of gears or oil [°C]; None for the file's.
        load: held mass [kg]; None for the file's.
        name: of the recording; empty for the file's.
    """

    file: FactorFile | RecordingBrief
    time: datetime
    temperature: float | None = None
    load: float | None = None
    name: str = ""

    @property
    def brief(self) -> RecordingBrief:
        return self.file.brief if isinstance(self.file, FactorFile) else self.file

    @property
    def degrees(self) -> float:
        """Temperature [°C]; NaN if unknown."""
        known = self.brief.degrees if self.temperature is None else self.temperature
        return float("nan") if known is None else float(known)

    @property
    def held(self) -> float:
        """Largest held mass [kg]; for a load without a declared mass, the identified one."""
        return self.brief.held if self.load is None else self.load

    @property
    def label(self) -> str:
        return self.name or self.brief.log


def recorded(files: Sequence[FactorFile]) -> list[DriftRecording]:
    """Factor files sorted by time: from their stamps, or from dates in their names.

    Raises:
        RecordingError: the time of one is unknown.
    """
    recordings = (DriftRecording(file, _time(file)) for file in files)
    return sorted(recordings, key=lambda recording: recording.time)


def _time(file: FactorFile) -> datetime:
    record = file.record
    if record.first > _SINCE_1970:
        return datetime.fromtimestamp(record.first, UTC).replace(tzinfo=None)
    if (time := date_within(record.log)) is not None:
        return time
    raise RecordingError(
        f"the date in {record.log} is none"
        if DATE.search(record.log)
        else f"nothing says when {record.log} was made: its stamps do not count from 1970, and its "
        "name has no date",
        where=file.path or record.log,
        cure="name recordings by their date, such as line1-2026-01-31.csv, and gather them again",
    )


# Largest number of tool changes that are searched.
_MOST = 8


@dataclass(frozen=True)
class ToolChange:
    """Day of a tool change, and the change of the held mass with its deviation [kg]."""

    day: float
    mass: float
    std: float


@dataclass(frozen=True, eq=False)
class RobotDrift:
    """Friction of a robot's drives over time.

    Attributes:
        units: of each drive's friction.
        recordings: sorted by time.
        findings: of each drive.
        tools: undeclared changes of the load.
    """

    robot: str
    drives: tuple[str, ...]
    units: tuple[str, ...]
    recordings: tuple[DriftRecording, ...]
    friction: FrictionSeries
    findings: tuple[DriftFinding, ...]
    tools: tuple[ToolChange, ...]
    settings: DriftSettings

    def date(self, day: float | None) -> datetime | None:
        """Date of a day since the first recording."""
        return None if day is None else self.recordings[0].time + timedelta(days=day)

    def dates(self, days: Between) -> tuple[datetime | None, datetime | None, datetime | None]:
        """Dates of a day and its interval."""
        return self.date(days.value), self.date(days.low), self.date(days.high)

    @property
    def common(self) -> str | None:
        """A remark if friction of all drives changes in the same way, which has few causes."""
        states = {finding.state for finding in self.findings}
        if len(self.drives) < 2 or len(states) != 1 or not states & {"rising", "falling"}:
            return None
        return (
            "all drives change in the same way: check for another lubricant, a temperature that "
            "is not that of the gears, or torques that are scaled in another way, before bearings"
        )

    @property
    def bound(self) -> str:
        rate, drives = self.settings.false_alarms, len(self.drives)
        return (
            f"at most {rate:g} a robot-year over {drives} drives, however often one looks "
            f"(Shiryaev–Roberts by Doob's inequality, each drive {rate / drives:.2g} a year)"
        )


def robot_drift(
    recordings: Sequence[DriftRecording],
    model: IdentifiedModel,
    settings: DriftSettings | None = None,
) -> RobotDrift:
    """Friction of a robot's drives over time, corrected for temperature and load.

    Args:
        recordings: of one robot, each once, in any order.
        model: of this robot, from all or some of them; its rigid bodies are fixed.
        settings: limit, accepted rate of false alarms, and start.

    Raises:
        RecordingError: recordings are missing, or do not match each other or the model.
    """
    settings = settings or DriftSettings()
    kept = kept_since(recordings, settings)
    files = [log.file for log in kept if isinstance(log.file, FactorFile)]
    return drift_of(kept, friction_series(files, model), model, settings)


def kept_since(
    recordings: Sequence[DriftRecording], settings: DriftSettings
) -> list[DriftRecording]:
    """Recordings in which drift is searched, sorted by time.

    Raises:
        RecordingError: no recording is left.
    """
    since = settings.since
    kept = [log for log in recordings if since is None or log.time >= since]
    kept.sort(key=lambda log: (log.time, log.brief.sha256))
    if not kept:
        raise RecordingError(
            "there is none" if since is None else f"there is none since {since:%Y-%m-%d}",
            where="recordings",
            cure="give factor files of this robot",
        )
    return kept


def drift_of(
    recordings: Sequence[DriftRecording],
    friction: FrictionSeries,
    model: IdentifiedModel,
    settings: DriftSettings,
    name: str = "",
) -> RobotDrift:
    """Drift from friction of recordings.

    Args:
        recordings: sorted by time.
        friction: of these recordings.
    """
    first, drives = recordings[0].time, model.robot.drives
    days = np.array([(recording.time - first) / timedelta(days=1) for recording in recordings])
    tools = tool_changes(days, *friction.held, len(drives) / settings.false_alarms)
    degrees, load = np.array([(recording.degrees, recording.held) for recording in recordings]).T
    regressors = Regressors.for_recordings(days, degrees, load, [tool.day for tool in tools])
    series = explained(days, *in_percent(friction.mean, friction.std), [regressors])
    return RobotDrift(
        robot=name or model.robot.name,
        drives=drives,
        units=tuple(model.robot.units(drive).force for drive in drives),
        recordings=tuple(recordings),
        friction=friction,
        findings=tuple(finding(series, i, settings, len(drives)) for i in range(len(drives))),
        tools=tools,
        settings=settings,
    )


def tool_changes(
    days: Float[np.ndarray, " n"],
    mass: Float[np.ndarray, " n"],
    std: Float[np.ndarray, " n"],
    years: float,
) -> tuple[ToolChange, ...]:
    """Steps of the held mass, sorted by time.

    Args:
        years: mean time between false alarms.
    """
    known = np.isfinite(mass) & np.isfinite(std) & (std > 0)
    days, mass, std = days[known], mass[known], std[known]
    if len(days) < FEWEST:
        return ()
    daily = ROBUST * float(np.median(np.abs(np.diff(mass)))) / np.sqrt(2.0)
    unit = max(daily, float(np.median(std)))
    steps = list[float]()
    while len(steps) < _MOST:
        day = _step(days, mass / unit, std / unit, steps, years)
        if day is None:
            break
        steps.append(day)
    changes, ends = list[ToolChange](), [-np.inf, *sorted(set(steps)), np.inf]
    for first, day, last in zip(ends, ends[1:], ends[2:], strict=False):
        before, after = (days >= first) & (days < day), (days >= day) & (days < last)
        size = float(np.median(mass[after]) - np.median(mass[before]))
        spread = 1.25 * unit * float(np.sqrt(1.0 / before.sum() + 1.0 / after.sum()))
        if abs(size) > max(SURE * spread, 0.5 * unit):
            changes.append(ToolChange(day, size, spread))
    return tuple(changes)


def _step(
    days: Float[np.ndarray, " n"],
    y: Float[np.ndarray, " n"],
    std: Float[np.ndarray, " n"],
    steps: list[float],
    years: float,
) -> float | None:
    X = np.stack([np.ones(len(days)), *((days >= day).astype(float) for day in steps)], axis=1)
    z, variance, changes = (y - np.median(y))[None], 0.5 + 0.5 * std[None] ** 2, Changes.steps(days)
    scale = np.full(1 + len(steps), FLAT)
    evidence = evidence_of(days, z, variance, X[None], changes, scale, scale, 1)
    if evidence.R[0] < years:
        return None
    return float(changes.onsets[np.argmax(evidence.of_changes.sum(axis=(0, 1))[0])])
