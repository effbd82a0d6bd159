"""Recordings whose columns are numpy arrays, or what can be cut like them."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from deltaid.recording.address import Pick, RecordedField
from deltaid.recording.source import LogTable, Rows

# Units of dates that are finer than the month, whose length is not even.
_UNITS = ("W", "D", "h", "m", "s", "ms", "us", "ns")


@runtime_checkable
class Sliceable(Protocol):
    """An array of which parts are read, in the order of its samples."""

    def __getitem__(self, index: tuple[slice, ...], /) -> np.ndarray: ...


# Arrays by their names, and how many samples to read at a time.
Arrays = tuple[Mapping[str, Sliceable], int]


@dataclass(frozen=True)
class ArrayTable(LogTable):
    """A file of arrays, read in steps along the samples.

    Attributes:
        arrays: opens those of some columns, which are readable while the context lasts. Raises a
            RecordingError if the file is damaged.
    """

    arrays: Callable[[Sequence[Pick]], AbstractContextManager[Arrays]]

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """Rows of some columns, as in `LogTable.rows`."""
        picks, origins = self.picks(columns), dict[str, np.datetime64]()
        samples = picks[0].samples or 0
        with self.arrays(picks) as (arrays, step):
            for start in range(0, samples, step):
                parts = _cut(arrays, picks, start, min(start + step, samples))
                numbers = [
                    _seconds(part, pick.field.name, origins) if pick.field.is_clock else part
                    for pick, part in zip(picks, parts, strict=True)
                ]
                yield Rows(numbers, numbers)


def fields_of(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Iterator[RecordedField]:
    """What an array holds; the entries of a structured one under names of their own."""
    if dtype.names:
        for entry, inner in entries_of_type(dtype).items():
            yield from fields_of(f"{name}.{entry}", shape, inner)
    elif dtype.subdtype:
        base, inner = dtype.subdtype
        yield from fields_of(name, (*shape, *inner), base)
    elif dtype.kind == "M" and np.datetime_data(dtype)[0] in _UNITS:
        yield RecordedField(name, shape, is_clock=True)
    elif dtype.kind in "iufb":
        yield RecordedField(name, shape, is_truth=dtype.kind == "b")
    else:
        yield RecordedField(name, shape, holds=_KINDS.get(dtype.kind, str(dtype)[:40]))


_KINDS = {
    "S": "text",
    "U": "text",
    "O": "objects, which are never loaded",
    "c": "complex numbers",
    "M": "dates",
    "m": "durations",
}


def entries_of_type(dtype: np.dtype[Any]) -> dict[str, np.dtype[Any]]:
    """The entries of a structured type, in order."""
    fields: Any = dtype.fields
    return {name: fields[name][0] for name in dtype.names or ()}


def entries_of(name: str, array: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays behind the names of `fields_of`, without a copy."""
    if not array.dtype.names:
        return {name: array}
    parts: dict[str, np.ndarray] = {}
    for entry in array.dtype.names:
        parts |= entries_of(f"{name}.{entry}", array[entry])
    return parts


def _cut(
    arrays: Mapping[str, Sliceable], picks: Sequence[Pick], start: int, stop: int
) -> Iterable[np.ndarray]:
    """Columns from one sample to another; each array is read once."""
    together: dict[tuple[str, int], list[Pick]] = {}
    for pick in picks:
        together.setdefault((pick.field.name, pick.axis), []).append(pick)
    blocks: dict[tuple[str, int], tuple[np.ndarray, list[int]]] = {}
    for key, same in together.items():
        first = [min(pick.at[a] or 0 for pick in same) for a in range(len(same[0].at))]
        last = [max(pick.at[a] or 0 for pick in same) for a in range(len(same[0].at))]
        index = [slice(low, high + 1) for low, high in zip(first, last, strict=True)]
        index[key[1]] = slice(start, stop)
        blocks[key] = arrays[key[0]][tuple(index)], first
    for pick in picks:
        block, first = blocks[pick.field.name, pick.axis]
        at = [slice(None) if i is None else i - low for i, low in zip(pick.at, first, strict=True)]
        yield block[tuple(at)]


def _seconds(dates: np.ndarray, name: str, origins: dict[str, np.datetime64]) -> np.ndarray:
    """Dates as seconds since the first one, from whole numbers; NaN where there is no date."""
    since = dates - origins.setdefault(name, dates[0])
    seconds = since.astype("m8[ns]").astype(np.int64) / 1e9
    seconds[np.isnat(since)] = np.nan
    return seconds
