"""Tables of arrays, and files of NumPy.

A `.npy` file is mapped into memory; a `.npz` archive is read member by member.
"""

import math
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial, reduce
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from deltaid.grouping import grouped
from deltaid.recording.address import Pick, RecordedField
from deltaid.recording.source import BATCH_ROWS, LogTable, Rows, damage, opened

# Units of dates with a constant length, unlike months and years.
_UNITS = ("W", "D", "h", "m", "s", "ms", "us", "ns")
_KINDS = {
    "S": "text",
    "U": "text",
    "O": "objects, which are never loaded",
    "c": "complex numbers",
    "M": "dates",
    "m": "durations",
}
# Largest compression ratio of deflate.
DEFLATE_RATIO = 1100
# Name of the array of a .npy file.
_ONLY = "array"
_END = ".npy"
# Errors of numpy and zipfile about damaged files.
_DAMAGE = (
    ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError,
    RuntimeError, KeyError, TypeError, OverflowError, MemoryError, SyntaxError, IndexError,
    tokenize.TokenError,
)  # fmt: skip
_damage = partial(
    damage,
    errors=_DAMAGE,
    what="is a damaged NumPy file",
    cure="copy it again, or save it again with numpy.save or numpy.savez",
)


@runtime_checkable
class Sliceable(Protocol):
    """Array that is read part by part, in the order of its samples."""

    def __getitem__(self, index: tuple[slice, ...], /) -> np.ndarray: ...


# Arrays by name, and number of samples to read at a time.
Arrays = tuple[Mapping[str, Sliceable], int]


@dataclass(frozen=True)
class ArrayTable(LogTable):
    """A file of arrays, read in steps along the samples.

    Attributes:
        arrays: returns a context manager with the arrays of some columns, which raises a
            RecordingError if the file is damaged.
    """

    arrays: Callable[[Sequence[Pick]], AbstractContextManager[Arrays]]

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        picks = self.picks(columns)
        samples = picks[0].samples or 0
        with self.arrays(picks) as (arrays, step):
            for start in range(0, samples, step):
                parts = list(_cut(arrays, picks, start, min(start + step, samples)))
                yield Rows(parts, parts)


def entries_of(dtype: Any) -> Iterator[tuple[tuple[str, ...], tuple[int, ...], Any]]:
    """Path of names, additional axes and plain type of each entry of a type."""
    for name in dtype.names or ():
        for names, axes, plain in entries_of(dtype.fields[name][0]):
            yield (name, *names), axes, plain
    if dtype.subdtype:
        base, outer = dtype.subdtype
        for names, axes, plain in entries_of(base):
            yield names, (*outer, *axes), plain
    elif not dtype.names:
        yield (), (), dtype


def fields_of(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Iterator[RecordedField]:
    """Fields of an array; each entry of a structured one is a field."""
    for names, axes, plain in entries_of(dtype):
        is_clock = plain.kind == "M" and np.datetime_data(plain)[0] in _UNITS
        holds = "" if plain.kind in "iufb" else _KINDS.get(plain.kind, str(plain)[:40])
        yield RecordedField(
            ".".join(filter(None, (name, *names))),
            (*shape, *axes),
            holds="" if is_clock else holds,
            is_clock=is_clock,
            is_truth=plain.kind == "b",
        )


def parts_of(name: str, array: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays of the fields of `fields_of` by name, without a copy."""
    return {
        ".".join(filter(None, (name, *names))): reduce(lambda part, key: part[key], names, array)
        for names, _, _ in entries_of(array.dtype)
    }


def _cut(
    arrays: Mapping[str, Sliceable], picks: Sequence[Pick], start: int, stop: int
) -> Iterable[np.ndarray]:
    together = grouped(((pick.field.name, pick.axis), pick) for pick in picks)
    blocks: dict[tuple[str, int], tuple[np.ndarray, list[int]]] = {}
    for (name, axis), same in together.items():
        places = [[i or 0 for i in numbers] for numbers in zip(*(p.at for p in same), strict=True)]
        index = [slice(min(numbers), max(numbers) + 1) for numbers in places]
        index[axis] = slice(start, stop)
        blocks[name, axis] = arrays[name][tuple(index)], [min(numbers) for numbers in places]
    for pick in picks:
        block, first = blocks[pick.field.name, pick.axis]
        at = [slice(None) if i is None else i - low for i, low in zip(pick.at, first, strict=True)]
        yield block[tuple(at)]


def open_npy(path: Path) -> LogTable:
    """Open a file of one array, called `array`, or of the columns of a structured array."""
    with _damage(path), opened(path) as file:
        shape, _, dtype = _header(file)
        claimed, size = math.prod(shape) * dtype.itemsize, path.stat().st_size - file.tell()
        if claimed > size and not dtype.hasobject:
            raise ValueError(f"claims {claimed} bytes, but has {size}")
    fields = fields_of("" if dtype.names else _ONLY, shape, dtype)
    return ArrayTable(path, tuple(fields), partial(_mapped, path))


@contextmanager
def _mapped(path: Path, picks: Sequence[Pick]) -> Generator[Arrays, None, None]:
    with _damage(path):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    yield parts_of("" if array.dtype.names else _ONLY, array), BATCH_ROWS


def is_npz(start: bytes, path: Path) -> bool:
    length = int.from_bytes(start[26:28], "little")
    return start.startswith(b"PK\3\4") and start[30 : 30 + length].endswith(_END.encode())


def open_npz(path: Path) -> LogTable:
    fields: list[RecordedField] = []
    with _archive(path) as archive:
        for member in _arrays_of(archive):
            with archive.open(member) as file:
                shape, _, dtype = _header(file)
            claimed, size = math.prod(shape) * dtype.itemsize, member.compress_size
            is_sane = claimed <= member.file_size <= (size + 100) * DEFLATE_RATIO
            if not (is_sane or dtype.hasobject):  # objects are not read at all
                raise ValueError(f"{member.filename} claims {claimed} bytes, but has {size}")
            fields += fields_of(member.filename.removesuffix(_END), shape, dtype)
    return ArrayTable(path, tuple(fields), partial(_members, path))


@contextmanager
def _members(path: Path, picks: Sequence[Pick]) -> Generator[Arrays, None, None]:
    """Arrays of an archive; those with one sample per row are streamed, others are loaded."""
    axes = grouped((pick.field.name, pick.axis) for pick in picks)
    with _archive(path) as archive, ExitStack() as members:
        arrays: dict[str, Sliceable] = {}
        for member in _arrays_of(archive):
            base = member.filename.removesuffix(_END)
            if not any(f"{name}.".startswith(f"{base}.") for name in axes):
                continue
            stream = _Stream(members.enter_context(archive.open(member)))
            if {*axes.get(base, ())} == {0} and stream.is_by_rows:
                arrays.setdefault(base, stream)
                continue
            with archive.open(member) as file:
                array = np.lib.format.read_array(file, allow_pickle=False)
            arrays = parts_of(base, array) | arrays
        yield arrays, BATCH_ROWS


class _Stream:
    def __init__(self, file: Any) -> None:
        self._file, self._row = file, 0
        self._shape, by_columns, self._dtype = _header(file)
        self.is_by_rows = not by_columns or len(self._shape) == 1

    def __getitem__(self, index: tuple[slice, ...], /) -> np.ndarray:
        rows = index[0]
        assert rows.start == self._row, "rows come in order"
        self._row = rows.stop
        shape = (rows.stop - rows.start, *self._shape[1:])
        size = math.prod(shape) * self._dtype.itemsize
        data = self._file.read(size)
        if len(data) < size:
            raise EOFError("an array is cut off")
        return np.frombuffer(data, self._dtype).reshape(shape)[(slice(None), *index[1:])]


def _arrays_of(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    return [member for member in archive.infolist() if member.filename.endswith(_END)]


@contextmanager
def _archive(path: Path) -> Generator[zipfile.ZipFile, None, None]:
    with _damage(path), opened(path) as file, zipfile.ZipFile(file) as archive:
        yield archive


def _header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape of an array, whether it is in Fortran order, and its type.

    Raises:
        ValueError: the header is damaged.
    """
    is_first = np.lib.format.read_magic(file) == (1, 0)
    read = np.lib.format.read_array_header_1_0 if is_first else np.lib.format.read_array_header_2_0
    with warnings.catch_warnings(action="ignore"):  # about headers that Python 2 wrote
        shape, by_columns, dtype = read(file)
    if min(shape, default=0) < 0:
        raise ValueError(f"it claims the shape {shape}")
    return shape, by_columns, dtype
