"""Verdicts of checks: tables for terminal and pages, the page of `deltaid check`, cards."""

from collections.abc import Sequence

import polars as pl

from deltaid.checks.verdicts import Verdicts, files_of
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError, plural
from deltaid.model.verdict import Grade, Verdict
from deltaid.view.drawing import drawing
from deltaid.view.numbers import FEW, in_words
from deltaid.view.page import Fact, Lines, Page, Section, Summary, Table, Text, Trust
from deltaid.view.show import Card

# Grades, the most severe first.
_ORDER = tuple(reversed(Grade))
_CAUSE = "likeliest cause → next step"


def by_severity(verdicts: Sequence[Verdict]) -> list[Verdict]:
    return sorted(verdicts, key=lambda verdict: _ORDER.index(verdict.grade))


def page_table(verdicts: Sequence[Verdict]) -> Table:
    """Verdicts with finding, cause and fix; the most severe first."""
    ordered = by_severity(verdicts)
    good = frozenset(i for i, verdict in enumerate(ordered) if verdict.grade is Grade.GOOD)
    marked = frozenset(range(len(ordered))) - good
    table = Table(
        ("verdict", "check", "detected", _CAUSE),
        tuple(
            (v.grade, v.key, v.observation, f"{v.cause} → {v.cure}" if v.cause or v.cure else "")
            for v in ordered
        ),
        muted=good,
        marked=marked,
    )
    return table if marked else table.without(_CAUSE)  # good verdicts have no cause


def screen_table(verdicts: Sequence[Verdict]) -> Table:
    """Verdicts, cause and fix below what was detected; the most severe first."""
    return Table(
        ("verdict", "check", "detected"),
        tuple(
            (
                verdict.grade,
                verdict.key,
                "\n".join(
                    [
                        verdict.observation,
                        *[f"likely: {verdict.cause}"] * bool(verdict.cause),
                        *[f"→ {verdict.cure}"] * bool(verdict.cure),
                    ]
                ),
            )
            for verdict in by_severity(verdicts)
        ),
    )


def short_table(verdicts: Sequence[Verdict]) -> Table:
    """Verdicts that are not good, and all good ones in one row, for the head of a page."""
    poor, good = _parted(verdicts)
    table, keys = page_table(poor), ", ".join(dict.fromkeys(verdict.key for verdict in good))
    others = Grade.GOOD, f"all {'others' if poor else 'checks'} ({len(good)})", keys, ""
    rows = (*table.rows, *([others[: len(table.columns)]] if good else []))
    caption = "What the checks say of description, recordings and fit."
    return Table(table.columns, rows, caption, marked=table.marked)


def _parted(verdicts: Sequence[Verdict]) -> tuple[list[Verdict], list[Verdict]]:
    poor = [verdict for verdict in verdicts if verdict.grade is not Grade.GOOD]
    return poor, [verdict for verdict in verdicts if verdict.grade is Grade.GOOD]


def tally(verdicts: Sequence[Verdict]) -> str:
    """Number of verdicts of each grade: '1 wrong, 12 good'."""
    grades = [verdict.grade for verdict in verdicts]
    return ", ".join(f"{grades.count(grade)} {grade}" for grade in _ORDER if grade in grades)


def verdicts_page(value: Verdicts) -> Page:
    """The page of all verdicts on a robot and its recordings."""
    (poor, good), grades = _parted(value), [verdict.grade for verdict in value]
    first = page_table(poor) if poor else Text("All that was checked is good.")
    sections = (
        Section("To be corrected" if poor else "Verdict", (first,), unfolded=True),
        Section(
            "Lines to paste", (*map(Lines, _proposed(value)),), "the fix, as text", unfolded=True
        ),
        Section(
            "Good", (page_table(good),) if good else (), "what was checked and is as it should be"
        ),
        Section("Reading", tuple(map(Text, value.warnings)), "what was assumed", unfolded=True),
    )
    return Page(
        title=_title(value),
        subtitle=f"Checked: the description{''.join(f', {_name(log)}' for log in value.sources)}",
        verdict=_summary(value.grade, grades.count(value.grade)),
        drawing=drawing(value.robot, compiled(value.robot).kinematics) if value.robot else None,
        facts=tuple(Fact(grade, str(grades.count(grade))) for grade in _ORDER),
        sections=sections,
    )


def _summary(grade: Grade, count: int) -> Summary:
    things = f"{in_words(count)} {plural('thing', count)}"
    trust, said = {
        Grade.WRONG: (Trust.POOR, f"Wrong: {things} to be corrected before an identification."),
        Grade.DOUBTFUL: (
            Trust.FAIR,
            f"Doubtful: {things} to be inspected before an identification.",
        ),
        Grade.CANNOT_TELL: (Trust.GOOD, f"No fault detected: {things} could not be checked."),
        Grade.GOOD: (Trust.GOOD, "Good: nothing is in the way of an identification."),
    }[grade]
    return Summary(trust, said)


def verdicts_card(value: Verdicts | Verdict) -> Card:
    """Verdicts that are not good, and the number of good ones."""
    if isinstance(value, Verdict):
        return Card(f"{value.key}: {value.grade}", (value.sentence,), value.grade)
    poor, good = value.poor, _parted(value)[1]
    lines = [f"{verdict.grade}, {verdict.key}: {verdict.finding}" for verdict in poor[:FEW]]
    lines += [f"… and {len(poor) - FEW} more"] * (len(poor) > FEW)
    proposed = "\n".join(_proposed(value))
    more = {"lines that are proposed": proposed, "good": page_table(good) if good else ""}
    cure = {"mapping": ".cured_columns()", "robot": ".cured_robot()"}
    return Card(
        f"Checked: {', '.join([_title(value), *map(_name, value.sources)])}",
        (f"{value.grade}: {tally(value)}" if value else "nothing was checked",),
        value.grade if value else "",
        prompt_lines=tuple(lines),
        table=page_table(poor) if poor else None,
        more=tuple((title, part) for title, part in more.items() if part),
        methods=(*(cure[file] for file in files_of(value)), ".to_frame()", '.report("x.html")'),
    )


def verdicts_frame(value: Verdicts) -> pl.DataFrame:
    rows = [
        (str(v.grade), v.key, v.subject, v.seen, v.cause, v.cure, v.number, v.unit) for v in value
    ]
    texts = ("grade", "key", "subject", "seen", "cause", "cure")
    schema = dict.fromkeys(texts, pl.String) | {"number": pl.Float64, "unit": pl.String}
    return pl.DataFrame(rows, schema=schema, orient="row")


def _title(value: Verdicts) -> str:
    return value.robot.label if value.robot else str(value.given or "the description")


def _name(source: object) -> str:
    return str(source).replace("\\", "/").rpartition("/")[2]


def _proposed(value: Verdicts) -> list[str]:
    """Proposed lines for each file; none if a file cannot be read any more."""
    try:
        return [lines for lines, _ in value.cured_files().values()]
    except DeltaidError:
        return []
