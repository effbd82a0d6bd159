"""The page of `deltaid check`: verdicts with cause and cure, and the lines that mend it."""

from collections.abc import Mapping, Sequence

from deltaid.model.verdict import Grade as CheckGrade
from deltaid.model.verdict import Verdict
from deltaid.view.check_tables import page_table
from deltaid.view.corrected import in_words
from deltaid.view.drawing import Drawing
from deltaid.view.page import Block, Fact, Lines, Page, Section, Text
from deltaid.view.summary import Grade, Summary


def check_page(
    title: str,
    verdicts: Sequence[Verdict],
    logs: Sequence[str],
    lines: Mapping[str, str],
    drawing: Drawing | None = None,
) -> Page:
    """All verdicts on a robot and its recordings.

    Args:
        title: of the robot.
        logs: names of the recordings.
        lines: what to paste, by the file where it belongs, in words.
        drawing: of the robot, where its description can be read.
    """
    poor = [one for one in verdicts if one.grade is not CheckGrade.GOOD]
    good = [one for one in verdicts if one.grade is CheckGrade.GOOD]
    blocks: list[Block] = [page_table(poor)] if poor else [Text("All that was looked at is good.")]
    sections = [Section("To be mended" if poor else "Verdict", tuple(blocks), unfolded=True)]
    if lines:
        pasted = tuple(Lines(text, f"Goes into {file}.") for file, text in lines.items())
        sections.append(Section("Lines to paste", pasted, "what mends it, as text", unfolded=True))
    if good:
        sections.append(
            Section("Good", (page_table(good),), "what was looked at and is as it should be")
        )
    grades = [one.grade for one in verdicts]
    return Page(
        title=title,
        subtitle=f"Checked: the description{''.join(f', {log}' for log in logs)}",
        verdict=_summary(grades),
        drawing=drawing,
        facts=tuple(Fact(grade, str(grades.count(grade))) for grade in reversed(CheckGrade)),
        sections=tuple(sections),
    )


def _summary(grades: Sequence[CheckGrade]) -> Summary:
    """In one sentence whether one may go on to an identification."""
    worst = max(grades, key=list(CheckGrade).index, default=CheckGrade.GOOD)
    many = grades.count(worst)
    count, several = in_words(many), "s" if many > 1 else ""
    match worst:
        case CheckGrade.WRONG:
            said = f"Wrong: {count} thing{several} to be mended before an identification."
            return Summary(Grade.POOR, said)
        case CheckGrade.DOUBTFUL:
            said = f"Doubtful: {count} thing{several} to be looked at before an identification."
            return Summary(Grade.FAIR, said)
        case CheckGrade.CANNOT_TELL:
            said = f"Good as far as one can tell: {count} thing{several} could not be looked at."
            return Summary(Grade.GOOD, said)
        case CheckGrade.GOOD:
            return Summary(Grade.GOOD, "Good: nothing is in the way of an identification.")
