"""Verdicts as tables: built once, for the terminal and for pages."""

from collections.abc import Sequence

from deltaid.model.verdict import Grade, Verdict
from deltaid.view.table import Table

COLUMNS = ("verdict", "check", "about", "seen", "likeliest cause", "next step")

# The most severe first.
_ORDER = tuple(reversed(Grade))


def verdict_table(verdicts: Sequence[Verdict]) -> Table:
    """Verdicts with what was seen, why and what to do; the most severe first."""
    rows = sorted(verdicts, key=lambda one: _ORDER.index(one.grade))
    grades = [one.grade for one in rows]
    return Table(
        COLUMNS,
        tuple((one.grade, one.key, one.subject, one.seen, one.cause, one.cure) for one in rows),
        muted=frozenset(i for i, grade in enumerate(grades) if grade is Grade.GOOD),
        marked=frozenset(i for i, grade in enumerate(grades) if grade is not Grade.GOOD),
    )


def page_table(verdicts: Sequence[Verdict]) -> Table:
    """The same for a page, whose width the columns of a terminal's table would not fit."""
    table = verdict_table(verdicts)
    rows = [
        (grade, key, seen if about in seen else f"{about}: {seen}", _step(cause, cure))
        for grade, key, about, seen, cause, cure in table.rows
    ]
    columns = ("verdict", "check", "seen", "likeliest cause → next step")
    if all(grade == Grade.GOOD for grade, *_ in rows):  # which have neither
        rows, columns = [row[:3] for row in rows], columns[:3]
    return Table(columns, tuple(rows), muted=table.muted, marked=table.marked)


def _step(cause: str, cure: str) -> str:
    """Nothing of what is good, which has neither."""
    return f"{cause} → {cure}" if cause or cure else ""


def short_table(verdicts: Sequence[Verdict]) -> Table:
    """What is not good, and in one row all that is: for the head of a page."""
    table = page_table([one for one in verdicts if one.grade is not Grade.GOOD])
    rows = list(table.rows)
    good = [one.key for one in verdicts if one.grade is Grade.GOOD]
    if good:
        keys = ", ".join(dict.fromkeys(good))
        last = (Grade.GOOD, f"all {'others' if rows else 'checks'} ({len(good)})", keys, "")
        rows.append(last[: len(table.columns)])
    said = "What the checks say of description, recordings and fit."
    return Table(table.columns, tuple(rows), said, marked=table.marked)


def tally(verdicts: Sequence[Verdict]) -> str:
    """How many verdicts of each grade there are: '1 wrong, 12 good'."""
    grades = [verdict.grade for verdict in verdicts]
    return ", ".join(f"{grades.count(one)} {one}" for one in _ORDER if one in grades)
