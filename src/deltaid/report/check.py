"""The page of `deltaid check`: verdicts with cause and cure, and the lines that mend it."""

from collections.abc import Mapping, Sequence

from deltaid.check.verdict import Grade, Verdict
from deltaid.report.check_tables import page_table
from deltaid.report.page import Block, Fact, Lines, Page, Section, Text


def check_page(
    title: str,
    verdicts: Sequence[Verdict],
    logs: Sequence[str],
    lines: Mapping[str, str],
) -> Page:
    """All verdicts on a robot and its recordings.

    Args:
        title: of the robot.
        logs: names of the recordings.
        lines: what to paste, by the file where it belongs, in words.
    """
    poor = [one for one in verdicts if one.grade is not Grade.GOOD]
    good = [one for one in verdicts if one.grade is Grade.GOOD]
    blocks: list[Block] = [page_table(poor)] if poor else [Text("All that was looked at is good.")]
    sections = [Section("To be mended" if poor else "Verdict", tuple(blocks))]
    if lines:
        pasted = tuple(Lines(text, f"Goes into {file}.") for file, text in lines.items())
        sections.append(Section("Lines to paste", pasted))
    if good:
        sections.append(Section("Good", (page_table(good),)))
    grades = [one.grade for one in verdicts]
    return Page(
        title=title,
        subtitle=f"Checked: the description{''.join(f', {log}' for log in logs)}",
        facts=tuple(Fact(grade, str(grades.count(grade))) for grade in reversed(Grade)),
        sections=tuple(sections),
    )
