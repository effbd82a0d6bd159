"""Verdicts on a description, a recording or a fit: one for each cause, with its words."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, get_args

from deltaid.errors import sentence
from deltaid.shown import Shown

# Number of names in a sentence before it only counts the rest, to keep it short.
FEW = 3
# Files that a proposal may change: a robot's description, a recording's mapping.
File = Literal["robot", "mapping"]
FILES: tuple[File, ...] = get_args(File)


class Grade(StrEnum):
    """Grade of a verdict, in order of severity."""

    GOOD = "good"
    CANNOT_TELL = "cannot tell"
    DOUBTFUL = "doubtful"
    WRONG = "wrong"


@dataclass(frozen=True)
class Proposal:
    """Proposed lines that correct a user's file; they are never applied unasked.

    Attributes:
        file: the robot file or the column mapping.
        changes: keys, such as `position[2].sign` or `limbs.strut`, and their correct values.
        is_written: whether they may be written to a file; otherwise they only test whether the
            cause explains the recording, and somebody has to inspect the machine.
    """

    file: File
    changes: tuple[tuple[str, object], ...]
    is_written: bool = True


@dataclass(frozen=True, repr=False)
class Verdict(Shown):
    """Verdict on one cause.

    Attributes:
        key: of the check, as listed in the docs, such as `torque-sign`.
        grade: its severity.
        seen: the finding, with its number and unit.
        subject: the drive, column, body or limit concerned; empty for the whole.
        cause: the likeliest cause; empty if all is good.
        cure: the next step; empty if all is good.
        proposals: lines to paste.
        number: the figure that decided, in `unit`; None if there is none.
    """

    key: str
    grade: Grade
    seen: str
    subject: str = ""
    cause: str = ""
    cure: str = ""
    proposals: tuple[Proposal, ...] = ()
    number: float | None = None
    unit: str = ""

    @property
    def observation(self) -> str:
        """The finding, preceded by its subject unless it names that."""
        return self.seen if self.subject in self.seen else f"{self.subject}: {self.seen}"

    @property
    def finding(self) -> str:
        """The finding and its likeliest cause, as one sentence."""
        return sentence(self.observation, self.cause, "")

    @property
    def sentence(self) -> str:
        """The finding, its cause and the next step."""
        return sentence(self.finding, "", self.cure)


@dataclass(frozen=True)
class Fault:
    """A possible fault, with the default words of its verdicts.

    Attributes:
        key, cause, cure: as of a `Verdict` that is not good.
        unit: of the deciding figure.
    """

    key: str
    unit: str = ""
    cause: str = ""
    cure: str = ""

    def good(self, seen: str, number: float | None = None) -> Verdict:
        """A good verdict, without cause and cure."""
        return self.judged(seen, number=number, grade=Grade.GOOD)

    def judged(
        self,
        seen: str,
        subject: str = "",
        number: float | None = None,
        *,
        grade: Grade = Grade.DOUBTFUL,
        cause: str = "",
        cure: str = "",
        proposals: tuple[Proposal, ...] = (),
    ) -> Verdict:
        """A verdict of this grade; a good one has neither subject, cause nor cure."""
        unit = "" if number is None else self.unit
        if grade is Grade.GOOD:
            return Verdict(self.key, grade, seen, number=number, unit=unit)
        words = cause or self.cause, cure or self.cure
        return Verdict(self.key, grade, seen, subject, *words, proposals, number, unit)


def graded(number: float, doubtful: float, wrong: float = math.inf) -> Grade:
    """Good up to the first limit, wrong above the second, doubtful between them."""
    return Grade.WRONG if number > wrong else Grade.DOUBTFUL if number > doubtful else Grade.GOOD


def worst(verdicts: Iterable[Verdict]) -> Grade:
    """The most severe grade; good if there are no verdicts."""
    order = list(Grade)
    return max((verdict.grade for verdict in verdicts), key=order.index, default=Grade.GOOD)


def percent(share: float) -> str:
    """A share in per cent for sentences: two significant digits, or no decimals from 10 %.

    `view.numbers.percent` keeps trailing zeros, which tables and figures show as significant.
    """
    number = 100 * share
    return f"{number:.0f} %" if abs(number) >= 9.95 else f"{number:.2g} %"


def plus_minus(value: float, half: float, digits: int = 3) -> str:
    """A number and its half width, to one digit: '178 ± 60', '0.015 ± 0.002'."""
    return f"{value:.{digits}g} ± {float(f'{half:.1g}'):g}"


def listed(names: Sequence[str], conjunction: str = "and") -> str:
    """A list in words: 'drive1', 'drive1 and drive3', 'drive1, drive2 and drive3'."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {conjunction} {names[-1]}"
