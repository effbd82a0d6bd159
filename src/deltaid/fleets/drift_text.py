"""A table of a robot's drift, and sentences on what it rests on."""

from datetime import datetime

from deltaid.fleets.drift_findings import Between, Finding
from deltaid.fleets.robot_drift import RobotDrift
from deltaid.view.numbers import number
from deltaid.view.table import Table

_COLUMNS = ("drive", "state", "friction", "since", "% a month", "limit reached", "% a degree")


def drift_shown(found: RobotDrift) -> Table:
    """What is said of each drive."""
    first, last = found.recordings[0].time, found.recordings[-1].time
    rows = tuple(
        (
            drive,
            one.state,
            f"{number(one.level)} {unit}" if one.level == one.level else "unknown",
            "" if one.change.value is None else _date(found.date(one.change.value)),
            _change(one),
            _limit(found, one),
            "" if one.temperature.value is None else f"{100 * one.temperature.value:+.2f}",
        )
        for drive, one, unit in zip(found.drives, found.findings, found.units, strict=True)
    )
    return Table(
        _COLUMNS,
        rows,
        "",
        title=f"{found.robot}: {len(found.recordings)} recordings, {first:%Y-%m-%d} to "
        f"{last:%Y-%m-%d}",
    )


def sentences(found: RobotDrift) -> list[str]:
    """What each finding rests on, tools that were changed, what bounds false alarms."""
    lines = [
        f"{drive}: {text}"
        for drive, one in zip(found.drives, found.findings, strict=True)
        if one.state != "steady" and (text := _told(found, one))
    ]
    for tool in found.tools:
        way = "heavier" if tool.mass > 0 else "lighter"
        lines.append(
            f"what the robot holds became {way} by {abs(tool.mass):.3g} ± {2 * tool.std:.1g} kg on "
            f"{_date(found.date(tool.day))}, which nothing had told; friction was not taken for it"
        )
    if found.common is not None:
        lines.append(found.common)
    return [*lines, f"false alarms: {found.bound}"]


def _told(found: RobotDrift, one: Finding) -> str:
    """What stands in the table with its intervals, and why."""
    parts = list[str]()
    if one.change.value is not None:
        parts.append(f"since {_between(found, one.change)}")
    if one.horizon.value is not None and one.horizon.low is not None and one.limit is not None:
        when = _between(found, one.horizon)
        parts.append(f"friction of {number(one.limit)} is reached on {when}")
    return "; ".join([*parts, *([one.reason] if one.reason else [])])


def _between(found: RobotDrift, days: Between) -> str:
    middle, low, high = found.dates(days)
    return f"{_date(middle)} (95 %: {_date(low)} to {_date(high)})"


def _change(one: Finding) -> str:
    if one.state == "stepped" and one.step.value is not None:
        return f"{100 * one.step.value:+.2g} % at once"
    return _percent(one.rate)


def _limit(found: RobotDrift, one: Finding) -> str:
    if one.horizon.value is None:
        return ""
    return "passed" if one.horizon.low is None else _date(found.date(one.horizon.value))


def _date(day: datetime | None) -> str:
    return "unknown" if day is None else f"{day:%Y-%m-%d}"


def _percent(one: Between) -> str:
    if one.value is None or one.low is None or one.high is None:
        return "unknown"
    return f"{100 * one.value:+.2f} ({100 * one.low:+.2f} … {100 * one.high:+.2f})"
