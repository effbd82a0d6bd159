"""Verdicts on descriptions and recordings."""

from typing import TYPE_CHECKING

import polars as pl

from deltaid.checks.verdicts import Verdicts, files_of
from deltaid.errors import DeltaidError
from deltaid.model.verdict import Grade, Verdict
from deltaid.view.card import Card
from deltaid.view.check_tables import page_table, tally

if TYPE_CHECKING:
    from deltaid.view.page import Page

# Verdicts that text tells.
_TOLD = 4


def card(value: Verdicts | Verdict) -> Card:
    """What is not good, in words, and how many are good."""
    if isinstance(value, Verdict):
        return Card(f"{value.key}: {value.grade}", (value.sentence,), value.grade)
    poor, good = value.poor, [one for one in value if one.grade is Grade.GOOD]
    told = [f"{one.grade}, {one.key}: {one.finding}" for one in poor[:_TOLD]]
    told += [f"… and {len(poor) - _TOLD} more"] * (len(poor) > _TOLD)
    first = f"{value.grade}: {tally(value)}" if value else "nothing was looked at"
    proposed = (("lines that are proposed", value.cures),) if _can_be_cured(value) else ()
    cure = {"mapping": ".cured_columns()", "robot": ".cured_robot()"}
    return Card(
        f"Checked: {_title(value)}",
        (first,),
        value.grade if value else "",
        told=tuple(told),
        table=page_table(poor) if poor else None,
        more=(*proposed, *((("good", page_table(good)),) if good else ())),
        methods=(*(cure[file] for file in files_of(value)), ".to_frame()", '.report("x.html")'),
    )


def frame(value: Verdicts) -> pl.DataFrame:
    """Verdicts, a row each."""
    rows = [
        (str(v.grade), v.key, v.subject, v.seen, v.cause, v.cure, v.number, v.unit) for v in value
    ]
    names = ("grade", "key", "subject", "seen", "cause", "cure", "number", "unit")
    schema = {name: pl.Float64 if name == "number" else pl.String for name in names}
    return pl.DataFrame(rows, schema=schema, orient="row")


def page(value: Verdicts) -> "Page":
    """The page of `deltaid check`."""
    from deltaid.dynamics.dynamics import compiled
    from deltaid.view.check import check_page
    from deltaid.view.drawing import drawing

    robot = value.robot
    lines = {"the files that it names": value.cures} if _can_be_cured(value) else {}
    title = (robot.title or robot.name) if robot else "robot"
    drawn = drawing(robot, compiled(robot).kinematics) if robot else None
    return check_page(title, value, [_name(one) for one in value.sources], lines, drawn)


def _title(value: Verdicts) -> str:
    robot = (value.robot.title or value.robot.name) if value.robot else "the description"
    return ", ".join([robot, *(_name(one) for one in value.sources)])


def _name(source: object) -> str:
    return str(source).replace("\\", "/").rpartition("/")[2]


def _can_be_cured(value: Verdicts) -> bool:
    """Whether lines are proposed that can be written out: of several mappings they cannot."""
    if not files_of(value):
        return False
    try:
        return bool(value.cures)
    except DeltaidError:
        return False
