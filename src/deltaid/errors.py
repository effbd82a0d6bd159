"""The package's own errors and warnings: what is wrong, where, why, and the fix."""

import difflib
import linecache
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from numbers import Real
from types import TracebackType
from typing import Any, TypeVar

_Settings = TypeVar("_Settings")

# Spaces that do not break a line: no-break, narrow, thin.
_SPACES = "\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}\N{THIN SPACE}"
# Largest number of names in a message; more would hide its point.
_LISTED = 12
# Largest number of characters quoted from one name or value of a file, to keep messages short.
_QUOTED = 200
_LONG_WORD = re.compile(rf"\S{{{_QUOTED + 1},}}")


class DeltaidError(Exception):
    """Base of every error a user can cause.

    Args:
        what: one sentence on what is wrong.
        where: file, row, column or key; empty if there is no such place.
        cure: the fix; empty if `what` already says it.
    """

    def __init__(self, what: str, *, where: str = "", cure: str = "") -> None:
        # Names and values from files may be of any length.
        what, cure = shortened(what), shortened(cure)
        self.what, self.where, self.cure = what, where, cure
        super().__init__(what, where, cure)

    def __reduce__(self) -> tuple[object, ...]:
        return partial(type(self), where=self.where, cure=self.cure), (self.what,)

    def _render_traceback_(self) -> list[str]:
        """Lines that IPython and Jupyter show: the line that was typed, and the message.

        Frames inside the package do not help to fix an input; `%debug` still shows them.
        """
        kind, typed = type(self).__name__, _typed(self.__traceback__)
        return [*([f"----> {typed}"] if typed else []), f"{kind}: {self}"]

    def __str__(self) -> str:
        place = f"{self.where}: " if self.where else ""
        cure = f"\n  → {self.cure}" if self.cure else ""
        return f"{place}{self.what}{cure}"


def _typed(traceback: TracebackType | None) -> str:
    """The last line outside this package on the way to an error."""
    found = ""
    while traceback is not None:
        frame = traceback.tb_frame
        if str(frame.f_globals.get("__name__", "")).partition(".")[0] == "deltaid":
            break
        line = linecache.getline(frame.f_code.co_filename, traceback.tb_lineno).strip()
        found, traceback = (f"{traceback.tb_lineno} {line}" if line else ""), traceback.tb_next
    return found


class UnknownNameError(DeltaidError, KeyError):
    """No such name exists; the message suggests the nearest one."""


class UnknownFunctionError(DeltaidError, AttributeError):
    """`deltaid` has no such name; the message suggests the nearest one."""


class DescriptionError(DeltaidError):
    """A robot description or a model file is invalid."""


class KinematicsError(DeltaidError):
    """A pose is out of reach, or a configuration is singular."""


class RecordingError(DeltaidError):
    """A log, or the mapping of its columns, is invalid."""


class LostReadingError(RecordingError):
    """A few rows of a log hold a number that no motion produces."""


class IdentificationError(DeltaidError):
    """The identification problem is ill-posed, or a solver did not converge."""


class UnsettledFrictionError(IdentificationError):
    """Load-dependent friction does not settle: it changes from one round of the fit to the next."""


def nearest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """'did you mean P.m? ', or an empty text if no known name is close."""
    near = closest(name, known, cutoff)
    return f"did you mean {near}? " if near else ""


def closest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The known name that is closest to this one, ignoring case if needed; empty if none is."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=cutoff)
    if not near:
        lower = {name.lower(): name for name in names}
        near = [lower[match] for match in difflib.get_close_matches(name.lower(), lower, 1, cutoff)]
    return near[0] if near else ""


def unknown(
    name: object, known: Iterable[str], what: str, where: str, *, also: str = ""
) -> UnknownNameError:
    """An error that suggests the nearest name and lists some known ones.

    Args:
        also: the name that is meant, if it is known.
    """
    names, text = list(known), quoted(str(name))
    hint = f"did you mean {also}? " if also else nearest(text, names)
    alike = [name for name in names if name.startswith(f"{text.partition('.')[0]}.")]
    shown = alike or names
    listed = ", ".join(shown[:_LISTED] or ["none"]) + (", …" if len(shown) > _LISTED else "")
    return UnknownNameError(
        f"has no {what} '{text}'", where=where, cure=f"{hint}there are: {listed}"
    )


def with_options(settings: _Settings, options: Mapping[str, Any], where: str) -> _Settings:
    """The settings with some of their values replaced by name.

    Raises:
        UnknownNameError: a setting does not exist.
    """
    for name in options:
        if name not in vars(settings):
            raise unknown(name, vars(settings), "setting", where)
    return type(settings)(**{**vars(settings), **options})


def typed(option: str, value: object, kinds: type | tuple[type, ...], what: str) -> None:
    """Refuse a value of the wrong type; booleans do not count as numbers.

    Raises:
        DeltaidError: the value has another type.
    """
    if not isinstance(value, kinds) or (isinstance(value, bool) and kinds is not bool):
        raise DeltaidError(f"must be {what}, not {quoted(repr(value))}", where=option)


def positive(
    option: str, value: float | None, limits: tuple[float, float] = (0.0, math.inf)
) -> None:
    """Refuse a value that is not a positive, finite number within limits; None is accepted.

    Raises:
        DeltaidError: the value is not of this kind.
    """
    if value is None:
        return
    typed(option, value, Real, "a number")
    if not 0 < value < math.inf:
        raise DeltaidError(f"must be a positive number, not {value:g}", where=option)
    within(option, value, limits)


def within(option: str, value: float, limits: tuple[float, float]) -> None:
    """Refuse a value that is no number or is outside the limits.

    Raises:
        DeltaidError: the value is not of this kind.
    """
    typed(option, value, Real, "a number")
    low, high = limits
    if not low <= value <= high:
        raise DeltaidError(f"must lie between {low:g} and {high:g}, not {value:g}", where=option)


class Doubt(str):
    """A warning: a sentence with the finding, the likeliest cause and the next step.

    Attributes:
        key: of the verdict of `deltaid check` that examines the same thing more closely, and
            replaces this warning if it exists; empty if there is no such verdict.
    """

    key: str

    def __new__(cls, seen: str, *, cause: str, cure: str, key: str = "") -> "Doubt":
        """A warning with one likeliest cause."""
        made = super().__new__(cls, sentence(seen, cause, cure))
        made.key = key
        return made


def sentence(seen: str, cause: str, cure: str) -> str:
    """The finding, with its cause and the next step, if any."""
    return seen + (f"; likeliest cause: {cause}" if cause else "") + (f"; {cure}" if cure else "")


def quoted(text: str) -> str:
    """Text of a file as messages quote it, shortened if it is long."""
    return text if len(text) <= _QUOTED else f"{text[: _QUOTED - 1]}…"


def shortened(text: str) -> str:
    """A message in which words that are too long are shortened."""
    return _LONG_WORD.sub(lambda word: quoted(word[0]), text)


def few(items: Sequence[str], most: int, between: str = ", ") -> str:
    """The first items of a list, and how many more there are."""
    more = f"{between.lstrip(',')}and {len(items) - most} more"
    return between.join(items[:most]) + more * (len(items) > most)


def plural(thing: str, count: float) -> str:
    """The noun, with an s unless there is one of it."""
    return thing if count == 1 else f"{thing}s"


def counted(count: int, thing: str) -> str:
    """A number with its noun: '1 row', '2 rows'."""
    return f"{count} {plural(thing, count)}"


def visible(text: str, kept: str = "\n" + _SPACES) -> str:
    """Text with a question mark in place of characters that could control a terminal or a printer.

    Names in files may hold escape sequences, or characters that reverse the text direction.

    Args:
        kept: unprintable characters that stay; pass none where the result must be one line.
    """
    return "".join(c if c.isprintable() or c in kept else "?" for c in text)
