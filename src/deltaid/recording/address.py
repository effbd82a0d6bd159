"""Addresses of fields in a recording: `name`, `name[0]`, `group/name[0]`, `topic.field[joint]`.

All kinds of files share this syntax. `name[i]` is a column of an array or an element of a list,
counted from 0, whichever axis has the samples; `name[:,i]` and `name[i,:]` name that axis.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from deltaid.errors import RecordingError, closest, few, quoted, visible

_INDEXED = re.compile(r"(?s)(?P<base>.+)\[(?P<inner>[^\[\]]*)\]")


@dataclass(frozen=True)
class RecordedField:
    """A named field of a recording.

    Attributes:
        name: address of the field.
        shape: shape of its numbers; None for a number of samples that only reading determines.
        labels: names of its columns, such as joints, which may replace indices.
        holds: content of the field if it holds no numbers; else empty.
        cure: fix of a field without numbers.
        is_opaque: whether the field may hold numbers of a recording, but cannot be read.
        is_clock: whether it holds dates or times of day, which become seconds since the first row.
        is_duration: whether it holds durations, which are read as seconds.
        is_truth: whether it holds true and false, which are read as 1 and 0.
    """

    name: str
    shape: tuple[int | None, ...] = (None,)
    labels: tuple[str, ...] = ()
    holds: str = ""
    cure: str = "store it as numbers; times as seconds since the start"
    is_clock: bool = False
    is_duration: bool = False
    is_opaque: bool = False
    is_truth: bool = False

    @property
    def wide(self) -> tuple[int, ...]:
        """Axes that are longer than one."""
        return tuple(axis for axis, size in enumerate(self.shape) if size != 1)

    def __str__(self) -> str:
        shown = visible(self.name[:41], kept="")
        name = shown if len(shown) <= 40 else f"{shown[:37]}…"
        if self.holds:
            return f"{name} ({self.holds})"
        if self.shape in ((), (None,)):
            return name if self.shape else f"{name} (one number)"
        sizes = " × ".join("n" if size is None else str(size) for size in self.shape)
        return f"{name} ({sizes})"


@dataclass(frozen=True)
class Pick:
    """One column of a field.

    Attributes:
        field: the field.
        at: index of the column in the field, with None on the axis of the samples.
        axis: axis of the samples.
        samples: number of samples; None if only reading determines it.
    """

    field: RecordedField
    at: tuple[int | None, ...]

    @property
    def axis(self) -> int:
        return self.at.index(None)

    @property
    def samples(self) -> int | None:
        return self.field.shape[self.axis]


def find(fields: Sequence[RecordedField], address: str) -> tuple[RecordedField, str] | None:
    """Field of an address, and the text in the last brackets of the address; None if the recording
    has no such field.

    A name that has brackets itself takes precedence over an element of an array. `.` and `/` are
    equivalent, and `[0]` may be added to names or omitted.
    """
    by_name = {field.name: field for field in reversed(fields)}
    by_key = {_key(field.name): field for field in reversed(fields)}
    match, whole = _INDEXED.fullmatch(address), [(address, "")]
    element = [(match["base"], match["inner"])] if match else []
    for known, spell, spellings in (
        (by_name, str, whole + element),
        (by_key, _key, element + whole),
        (by_key, lambda name: _key(name).replace("[0]", ""), element + whole),
    ):
        for name, inner in spellings:
            if spell(name) in known:
                return known[spell(name)], inner
    return None


def locate(
    fields: Sequence[RecordedField], addresses: Sequence[str], where: str, cure: str
) -> list[Pick]:
    """Columns of addresses, which must have one length.

    Args:
        fields: fields of the recording.
        addresses: addresses, of which the first plain column determines the number of samples.
        where: name of the recording, for messages.
        cure: fix of a missing column.

    Raises:
        RecordingError: a column is missing, or longer than the others.
    """
    matched = _matched(fields, addresses, where, cure)
    plain = (field.shape[field.wide[0]] for field, _ in matched if len(field.wide) == 1)
    samples, picks = next(plain, None), list[Pick]()
    for address, (field, inner) in zip(addresses, matched, strict=True):
        picks.append(Pick(field, _index(field, inner, samples, address, where)))
        if samples is not None and picks[-1].samples not in (None, samples):
            raise RecordingError(
                f"{address} has {picks[-1].samples} samples, but {addresses[0]} has {samples}",
                where=where,
                cure="all columns of a recording have one length; "
                f"say which axis holds the samples, as in {field.name}[:,0]"
                if len(field.wide) > 1
                else "all columns of a recording have one length; name those that belong together",
            )
    return picks


def listing(fields: Sequence[RecordedField]) -> str:
    """Fields of a recording for a message, shortened."""
    return few([str(field) for field in fields], 20)


def near(fields: Sequence[RecordedField], address: str) -> str:
    """A name similar to an unknown address; empty if there is none."""
    match = _INDEXED.fullmatch(address)
    name = (match["base"] if match else address).lower()
    names = {field.name.lower(): field.name for field in fields if not field.holds}
    if inside := [whole for whole in names.values() if _key(whole).startswith(f"{_key(name)}.")]:
        return inside[0]
    last = {re.split(r"[./]", key)[-1]: whole for key, whole in reversed(names.items())}
    for known in (names, last):
        if alike := closest(name, known, cutoff=0.7):
            return known[alike]
    return ""


def _key(name: str) -> str:
    return name.replace("/", ".").lstrip(".")


def _matched(
    fields: Sequence[RecordedField], addresses: Sequence[str], where: str, cure: str
) -> list[tuple[RecordedField, str]]:
    matches = {address: find(fields, address) for address in addresses}
    if missing := [address for address, match in matches.items() if match is None]:
        meant = [match[0].name for match in matches.values() if match is not None and not match[1]]
        guess = near([field for field in fields if field.name not in meant], missing[0])
        cure = next((field.cure for field in fields if field.is_opaque), cure)
        raise RecordingError(
            f"has no column {', '.join(map(quoted, missing))}; its columns are {listing(fields)}",
            where=where,
            cure=f"did you mean {guess}? Otherwise {cure}" if guess else cure,
        )
    known = [match for address in addresses if (match := matches[address]) is not None]
    for field, _ in known:
        if field.holds:
            raise RecordingError(
                f"column {quoted(field.name)} holds {field.holds}, not numbers",
                where=where,
                cure=field.cure,
            )
    return known


def _index(
    field: RecordedField, inner: str, samples: int | None, address: str, where: str
) -> tuple[int | None, ...]:
    if not field.shape:
        raise _refused(f"{field.name} is one number, not a column", field, where)
    if ":" in inner:
        return _as_written(field, inner, where)
    # Samples are on the axis that is as long as the time; without a time, on the longest one.
    fitting = [axis for axis, size in enumerate(field.shape) if size in (None, samples)]
    axis = [*fitting, max(range(len(field.shape)), key=lambda axis: field.shape[axis] or 0)][0]
    across = [a for a in field.wide if a != axis]
    if len(across) > 1:
        raise _refused(f"{field} has more than two axes", field, where)
    count = (field.shape[across[0]] if across else 1) or 0
    if not inner and count > 1:
        raise RecordingError(
            f"{address} has {count} columns",
            where=where,
            cure=f"say which one: {field.name}[0] … {field.name}[{count - 1}]",
        )
    number = _number(field, inner, count, where)
    return tuple(
        None if a == axis else number if a in across else 0 for a in range(len(field.shape))
    )


def _number(field: RecordedField, inner: str, count: int, where: str) -> int:
    text = inner.strip(" '\"")
    if text in field.labels:
        return field.labels.index(text)
    if text and not text.isdecimal():
        has = f"are called {', '.join(field.labels[:20])}" if field.labels else "have no names"
        raise RecordingError(
            f"{field.name} has no column '{text[:40]}'",
            where=where,
            cure=f"its columns {has}; they are counted from 0, as in {field.name}[0]",
        )
    number = int(text[:9] or 0)
    if number >= count:
        only = "it is a single column" if count == 1 else f"it has {count} columns"
        raise RecordingError(
            f"there is no {field.name}[{number}]: {only}",
            where=where,
            cure="columns are counted from 0",
        )
    return number


def _as_written(field: RecordedField, inner: str, where: str) -> tuple[int | None, ...]:
    """An index that names every axis, such as `:,0`."""
    parts = [part.strip() for part in inner.split(",")]
    numbers = [part[:9] for part in parts if part.isdecimal()]
    fits = len(parts) == len(field.shape) and parts.count(":") == 1 == len(parts) - len(numbers)
    at = tuple(None if part == ":" else int(part[:9]) for part in parts) if fits else ()
    inside = all(i is None or i < (size or 0) for i, size in zip(at, field.shape, strict=False))
    if not (fits and inside):
        raise _refused(f"there is no {field.name}[{inner[:40]}]: it is {field}", field, where)
    return at


def _refused(what: str, field: RecordedField, where: str) -> RecordingError:
    example = ",".join([":", *"0" * (max(len(field.shape), 2) - 1)])
    return RecordingError(
        what,
        where=where,
        cure=f"give an array of numbers, samples by drives; all its axes are named as in "
        f"{field.name}[{example}]",
    )
