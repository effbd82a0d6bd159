"""Drift of one robot: friction of its drives over time, and a finding on each."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from deltaid.errors import RecordingError
from deltaid.fleets.drift_findings import Between, DriftFinding, finding
from deltaid.fleets.drift_friction import FrictionSeries, friction_series
from deltaid.fleets.drift_inputs import DriftRecording, DriftSettings
from deltaid.fleets.drift_series import Regressors, explained, in_percent
from deltaid.fleets.tool_changes import ToolChange, tool_changes
from deltaid.model.record import IdentifiedModel

# Length of a day [s].
_DAY = 86400.0


@dataclass(frozen=True, eq=False)
class RobotDrift:
    """Friction of a robot's drives over time.

    Attributes:
        units: of each drive's friction.
        recordings: in the order of time.
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

    @property
    def start(self) -> datetime:
        """Days are counted from the first recording."""
        return self.recordings[0].time

    def date(self, day: float | None) -> datetime | None:
        """When a day is."""
        return None if day is None else self.start + timedelta(days=day)

    def dates(self, days: Between) -> tuple[datetime | None, datetime | None, datetime | None]:
        """A day with its interval."""
        return self.date(days.value), self.date(days.low), self.date(days.high)

    @property
    def common(self) -> str | None:
        """A remark where friction of all drives changes in one way: few things do that."""
        states = {finding.state for finding in self.findings}
        if len(self.drives) < 2 or len(states) != 1 or not states & {"rising", "falling"}:
            return None
        return (
            "all drives change alike: look for another lubricant, a temperature that is not that "
            "of the gears, or torques that are scaled in another way, before bearings"
        )

    @property
    def bound(self) -> str:
        """What bounds false alarms, in words."""
        rate, drives = self.settings.false_alarms, len(self.drives)
        return (
            f"at most {rate:g} a robot-year over {drives} drives, however often one looks "
            f"(Shiryaev–Roberts by Doob's inequality, each drive {rate / drives:.2g} a year)"
        )


def robot_drift(
    recordings: Sequence[DriftRecording],
    model: IdentifiedModel,
    settings: DriftSettings | None = None,
    *,
    name: str = "",
) -> RobotDrift:
    """Friction of a robot's drives over time, with temperature and load taken out.

    Args:
        recordings: of one robot, each once, in any order.
        model: of this robot, by all of them or by some; its rigid bodies are held.
        settings: limit, false alarms, from when on.
        name: of the robot.

    Raises:
        RecordingError: there are none, or they do not go together or with the model.
    """
    settings = settings or DriftSettings()
    since = settings.since
    kept = [log for log in recordings if since is None or log.time >= since]
    kept.sort(key=lambda log: (log.time, log.file.record.sha256))
    if not kept:
        raise RecordingError(
            "there is none" if since is None else f"there is none since {since:%Y-%m-%d}",
            where="recordings",
            cure="give factor files of this robot",
        )
    return drift_of(kept, friction_series([log.file for log in kept], model), model, settings, name)


def drift_of(
    recordings: Sequence[DriftRecording],
    friction: FrictionSeries,
    model: IdentifiedModel,
    settings: DriftSettings,
    name: str = "",
) -> RobotDrift:
    """Drift from friction of recordings.

    Args:
        recordings: in the order of time.
        friction: of them.
    """
    since = [recording.time - recordings[0].time for recording in recordings]
    days = np.array([time.total_seconds() / _DAY for time in since])
    tools = tool_changes(days, *friction.held)
    degrees, load = np.array([(recording.degrees, recording.held) for recording in recordings]).T
    beside = Regressors.for_recordings(days, degrees, load, [tool.day for tool in tools])
    series = explained(days, *in_percent(friction.mean, friction.std), [beside])
    drives = model.robot.drives
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
