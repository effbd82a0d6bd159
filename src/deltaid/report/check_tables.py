"""Verdicts as tables: built once, for the terminal and for pages."""

from collections.abc import Sequence

from deltaid.check.verdict import Grade, Verdict
from deltaid.report.table import Table

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
        (grade, key, seen if about in seen else f"{about}: {seen}", f"{cause} → {cure}".strip())
        for grade, key, about, seen, cause, cure in table.rows
    ]
    columns = ("verdict", "check", "seen", "likeliest cause → next step")
    if all(grade == Grade.GOOD for grade, *_ in rows):  # which have neither
        rows, columns = [row[:3] for row in rows], columns[:3]
    return Table(columns, tuple(rows), muted=table.muted, marked=table.marked)


def short_table(verdicts: Sequence[Verdict]) -> Table:
    """What is not good, with what was seen, and in one row all that is: for the head of a page."""
    table = verdict_table([one for one in verdicts if one.grade is not Grade.GOOD])
    rows = [
        (grade, key, seen if about in seen else f"{about}: {seen}")
        for grade, key, about, seen, *_ in table.rows
    ]
    good = [one.key for one in verdicts if one.grade is Grade.GOOD]
    if good:
        keys = ", ".join(dict.fromkeys(good))
        rows.append((Grade.GOOD, f"all {'others' if rows else 'checks'} ({len(good)})", keys))
    return Table(
        ("verdict", "check", "seen"),
        tuple(rows),
        "What the checks say of description, recordings and fit.",
        marked=table.marked,
    )


def tally(verdicts: Sequence[Verdict]) -> str:
    """How many verdicts of each grade there are: '1 wrong, 12 good'."""
    grades = [verdict.grade for verdict in verdicts]
    return ", ".join(f"{grades.count(one)} {one}" for one in _ORDER if one in grades)
