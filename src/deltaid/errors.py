"""The package's own errors and warnings: what is wrong, where, why, and how to mend it."""

import difflib
from collections.abc import Iterable

# Spaces that do not break a line: plain, narrow, thin.
_SPACES = "\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}\N{THIN SPACE}"


class DeltaidError(Exception):
    """Base of every error a user can cause.

    Args:
        what: what is wrong, one sentence.
        where: file, row, column or key; empty when there is no such place.
        cure: how to mend it; empty when the message says it already.
    """

    def __init__(self, what: str, *, where: str = "", cure: str = "") -> None:
        self.what, self.where, self.cure = what, where, cure
        super().__init__(what, where, cure)

    def __reduce__(self) -> tuple[object, ...]:
        return _again, (type(self), self.what, self.where, self.cure)

    def __str__(self) -> str:
        place = f"{self.where}: " if self.where else ""
        cure = f"\n  → {self.cure}" if self.cure else ""
        return f"{place}{self.what}{cure}"


def _again(kind: type[DeltaidError], what: str, where: str, cure: str) -> DeltaidError:
    """An error that comes from another process."""
    return kind(what, where=where, cure=cure)


class UnknownNameError(DeltaidError, KeyError):
    """There is nothing of that name; the message has the nearest one."""


class UnknownFunctionError(DeltaidError, AttributeError):
    """`deltaid` has nothing of that name; the message has the nearest one."""


class DescriptionError(DeltaidError):
    """A robot description or a model file cannot be used as it stands."""


class KinematicsError(DeltaidError):
    """A pose is out of reach, or a configuration is singular."""


class RecordingError(DeltaidError):
    """A log, or the mapping of its columns, cannot be used as it stands."""


class IdentificationError(DeltaidError):
    """The identification cannot be posed, or a solver did not reach its end."""


def nearest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """'did you mean P.m? ', or nothing where no known name is like it."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=cutoff)
    if not near:  # perhaps only in other letters
        lower = {one.lower(): one for one in names}
        near = [lower[one] for one in difflib.get_close_matches(name.lower(), lower, n=1)]
    return f"did you mean {near[0]}? " if near else ""


class Doubt(str):
    """A warning: a sentence of what was seen, the likeliest cause and the next step.

    Attributes:
        key: of the verdict of `deltaid check` that looks at the same thing with more care, and
            replaces this where there is one; empty if none does.
    """

    key: str

    def __new__(cls, seen: str, *, cause: str, cure: str, key: str = "") -> "Doubt":
        """One cause in words."""
        made = super().__new__(cls, sentence(seen, cause, cure))
        made.key = key
        return made


def sentence(seen: str, cause: str, cure: str) -> str:
    """What was seen, with cause and next step where there are any."""
    return seen + (f"; likeliest cause: {cause}" if cause else "") + (f"; {cure}" if cure else "")


def visible(text: str) -> str:
    """Text with a question mark for every character that would command a terminal or a printer.

    Names in files may hold escape sequences, or signs that turn the direction of what follows.
    """
    return "".join(c if c.isprintable() or c == "\n" or c in _SPACES else "?" for c in text)
