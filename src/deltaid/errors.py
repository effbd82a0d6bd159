"""The package's own errors and warnings: what is wrong, where, why, and how to mend it."""

import difflib
import linecache
import math
import re
from collections.abc import Iterable, Mapping
from functools import partial
from numbers import Real
from types import TracebackType
from typing import Any, TypeVar

_Settings = TypeVar("_Settings")

# Spaces that do not break a line: plain, narrow, thin.
_SPACES = "\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}\N{THIN SPACE}"
# Most names that a message lists.
_LISTED = 12
# Most characters that a message quotes of one name or value of a file.
_QUOTED = 200
_LONG_WORD = re.compile(rf"\S{{{_QUOTED + 1},}}")


class DeltaidError(Exception):
    """Base of every error a user can cause.

    Args:
        what: what is wrong, one sentence.
        where: file, row, column or key; empty when there is no such place.
        cure: how to mend it; empty when the message says it already.
    """

    def __init__(self, what: str, *, where: str = "", cure: str = "") -> None:
        # Whatever stands in a file, a message stays one.
        what, cure = shortened(what), shortened(cure)
        self.what, self.where, self.cure = what, where, cure
        super().__init__(what, where, cure)

    def __reduce__(self) -> tuple[object, ...]:
        return partial(type(self), where=self.where, cure=self.cure), (self.what,)

    def _render_traceback_(self) -> list[str]:
        """What IPython and Jupyter show: the line that was typed and the message.

        Frames within the package say nothing to who can mend the input; `%debug` still has them.
        """
        kind, typed = type(self).__name__, _typed(self.__traceback__)
        return [*([f"----> {typed}"] if typed else []), f"{kind}: {self}"]

    def __str__(self) -> str:
        place = f"{self.where}: " if self.where else ""
        cure = f"\n  → {self.cure}" if self.cure else ""
        return f"{place}{self.what}{cure}"


def _typed(traceback: TracebackType | None) -> str:
    """The last line on the way to an error that is not of this package."""
    found = ""
    while traceback is not None:
        frame = traceback.tb_frame
        if str(frame.f_globals.get("__name__", "")).partition(".")[0] == "deltaid":
            break
        line = linecache.getline(frame.f_code.co_filename, traceback.tb_lineno).strip()
        found, traceback = (f"{traceback.tb_lineno} {line}" if line else ""), traceback.tb_next
    return found


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


class LostReadingError(RecordingError):
    """A few rows of a log hold a number that no motion makes."""


class IdentificationError(DeltaidError):
    """The identification cannot be posed, or a solver did not reach its end."""


class UnsettledFrictionError(IdentificationError):
    """Friction that depends on load changes from one round of the fit to the next."""


def nearest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """'did you mean P.m? ', or nothing where no known name is like it."""
    near = closest(name, known, cutoff)
    return f"did you mean {near}? " if near else ""


def closest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The known name that is most like another one, if only in other letters; empty if none is."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=cutoff)
    if not near:
        lower = {name.lower(): name for name in names}
        near = [lower[match] for match in difflib.get_close_matches(name.lower(), lower, 1, cutoff)]
    return near[0] if near else ""


def unknown(
    name: object, known: Iterable[str], what: str, where: str, *, also: str = ""
) -> UnknownNameError:
    """An error that says which name is nearest, and some of those that there are.

    Args:
        also: the name that is meant, where that is known.
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
    """Settings of a dataclass with some of them given by name.

    Raises:
        UnknownNameError: there is no such setting.
    """
    for name in options:
        if name not in vars(settings):
            raise unknown(name, vars(settings), "setting", where)
    return type(settings)(**{**vars(settings), **options})


def typed(option: str, value: object, kinds: type | tuple[type, ...], what: str) -> None:
    """Refuse a value of another type than a setting has; truth values are no numbers.

    Raises:
        DeltaidError: the value of this option or setting is refused.
    """
    if not isinstance(value, kinds) or (isinstance(value, bool) and kinds is not bool):
        raise DeltaidError(f"must be {what}, not {quoted(repr(value))}", where=option)


def positive(
    option: str, value: float | None, limits: tuple[float, float] = (0.0, math.inf)
) -> None:
    """Refuse a value that is not a positive, finite number within limits; None stands for none.

    Raises:
        DeltaidError: the value of this option or setting is refused.
    """
    if value is None:
        return
    typed(option, value, Real, "a number")
    if not 0 < value < math.inf:
        raise DeltaidError(f"must be a positive number, not {value:g}", where=option)
    within(option, value, limits)


def within(option: str, value: float, limits: tuple[float, float]) -> None:
    """Refuse a value outside limits, or that is no number.

    Raises:
        DeltaidError: the value of this option or setting is refused.
    """
    typed(option, value, Real, "a number")
    low, high = limits
    if not low <= value <= high:
        raise DeltaidError(f"must lie between {low:g} and {high:g}, not {value:g}", where=option)


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


def quoted(text: str) -> str:
    """What a file holds as messages quote it: shortened where it is long."""
    return text if len(text) <= _QUOTED else f"{text[: _QUOTED - 1]}…"


def shortened(text: str) -> str:
    """A message of which every word is quoted that is too long to be one."""
    return _LONG_WORD.sub(lambda word: quoted(word[0]), text)


def visible(text: str, kept: str = "\n" + _SPACES) -> str:
    """Text with a question mark for every character that would command a terminal or a printer.

    Names in files may hold escape sequences, or signs that turn the direction of what follows.

    Args:
        kept: characters that stay although they do not print; none in what has to be one line.
    """
    return "".join(c if c.isprintable() or c in kept else "?" for c in text)
