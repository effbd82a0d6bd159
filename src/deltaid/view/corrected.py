"""What an identification put right, as one sentence."""

import re
from collections.abc import Sequence

from deltaid.model.corrections import NAMES, Correction, Kind
from deltaid.robot.body import body_in_words

# Longer rows of drives are told by their ends.
_LONG = 2

_WORDS = (
    "no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven",
    "twelve",
)  # fmt: skip


def corrected(corrections: Sequence[Correction]) -> str:
    """How many sorts of things were put right, and of what: 'Two corrections were made: …'."""
    if not corrections:
        return "Nothing had to be put right."
    subjects: dict[Kind, dict[str, None]] = {}
    for correction in corrections:
        subjects.setdefault(correction.kind, {})[correction.subject] = None
    things = ", ".join(
        _thing(kind, tuple(subject for subject in of if subject not in ("", kind)))
        for kind, of in subjects.items()
    )
    if len(subjects) == 1:
        return f"One correction was made: {things}."
    return f"{in_words(len(subjects)).capitalize()} corrections were made: {things}."


def in_words(count: int) -> str:
    """A count in words up to twelve."""
    return _WORDS[count] if 0 <= count < len(_WORDS) else str(count)


def _thing(kind: Kind, subjects: tuple[str, ...]) -> str:
    return NAMES[kind] + (f" ({', '.join(_short(subjects))})" if subjects else "")


def _short(subjects: tuple[str, ...]) -> list[str]:
    """Bodies by what they are; three or more drives in a row by the first and the last."""
    runs: list[list[str]] = []
    for subject in subjects:
        if runs and _next(runs[-1][-1]) == subject:
            runs[-1].append(subject)
        else:
            runs.append([subject])
    said = []
    for run in runs:
        words = [body_in_words(name) for name in run]
        said += [f"{words[0]} to {words[-1]}"] if len(run) > _LONG and words == run else words
    return said


def _next(name: str) -> str:
    """drive3 after drive2; nothing after a name without a number."""
    numbered = re.fullmatch(r"(.*?)(\d+)", name)
    return f"{numbered[1]}{int(numbered[2]) + 1}" if numbered else ""
