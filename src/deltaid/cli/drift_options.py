"""What commands that look for drift ask of their user."""

import re
from typing import TYPE_CHECKING, Annotated

import typer

from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    from datetime import datetime

    from deltaid.fleets.drift_inputs import DriftSettings

_LIMIT = re.compile(r"(\d+(?:\.\d+)?)\s*(N\s*·?\s*m|N)?")

Limit = Annotated[
    str | None,
    typer.Option(
        help="Friction that is too much: times what it was, such as 1.5, or 12Nm, or 40N.",
        metavar="LIMIT",
    ),
]
FalseAlarms = Annotated[
    float, typer.Option(help="False alarms of drift that a robot may have in a year, at most.")
]
Since = Annotated[
    str | None,
    typer.Option(
        help="Exclude from drift what was recorded before this day, such as that of a repair.",
        metavar="DATE",
    ),
]


def drift_settings(limit: str | None, false_alarms: float, since: str | None) -> "DriftSettings":
    """What is asked of drift.

    Raises:
        DeltaidError: a limit is no number, or cannot be; there is no such day.
    """
    from deltaid.fleets.drift_inputs import DriftSettings

    (number, is_torque), day = _limit(limit), _day(since)
    try:
        return DriftSettings(
            limit=number,
            limit_is="torque" if is_torque else "share",
            false_alarms=false_alarms,
            since=day,
        )
    except DeltaidError as error:
        option = f"--{error.where.replace('_', '-')}"
        raise DeltaidError(error.what, where=option, cure=error.cure) from None


def _limit(text: str | None) -> tuple[float | None, bool]:
    """The limit, and whether it is a torque or a force."""
    if text is None:
        return None, False
    found = _LIMIT.fullmatch(text.strip())
    if found is None:
        raise DeltaidError(
            f"must be a number such as 1.5, or a torque or force, 12Nm or 40N, not {text!r}",
            where="--limit",
        )
    return float(found[1]), found[2] is not None


def _day(text: str | None) -> "datetime | None":
    from datetime import datetime

    if text is None:
        return None
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise _no_day(text) from None
    if found.tzinfo is not None:
        raise _no_day(text)
    return found


def _no_day(text: str) -> DeltaidError:
    return DeltaidError(
        f"must be a date, not {text}", where="--since", cure="write it as 2026-01-31"
    )
