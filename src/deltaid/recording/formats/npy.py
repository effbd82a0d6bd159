"""Arrays that numpy has saved: `.npy` is read where it lies, `.npz` member by member."""

import math
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deltaid.errors import RecordingError
from deltaid.recording.address import Pick, RecordedField
from deltaid.recording.formats.arrays import Arrays, ArrayTable, Sliceable, entries_of, fields_of
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import BATCH_ROWS, LogTable, first_line, opened

# The one array of a .npy file is called so.
_ONLY = "array"
_END = ".npy"
# What numpy and zipfile raise over damaged files.
_DAMAGE = (
    ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError,
    RuntimeError, KeyError, TypeError, OverflowError, MemoryError, SyntaxError, IndexError,
    tokenize.TokenError,
)  # fmt: skip


def open_npy(path: Path, mapping: ColumnMapping) -> LogTable:
    """A file of one array: it is called `array`; of a structured one, its columns."""
    with _damage(path), opened(path) as file:
        header = _header(file)
        size = path.stat().st_size - file.tell()
        if header.bytes > size and not header.dtype.hasobject:
            raise ValueError(f"claims {header.bytes} bytes, but has {size}")
    fields = header.fields("" if header.dtype.names else _ONLY)
    return ArrayTable(path, tuple(fields), partial(_mapped, path))


@contextmanager
def _mapped(path: Path, picks: Sequence[Pick]) -> Generator[Arrays, None, None]:
    """The array of a .npy file, which stays on the disk."""
    with _damage(path):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    parts = entries_of("" if array.dtype.names else _ONLY, array)
    yield {name.removeprefix("."): part for name, part in parts.items()}, BATCH_ROWS


def is_npz(start: bytes, path: Path) -> bool:
    """Whether the first member of an archive is an array."""
    length = int.from_bytes(start[26:28], "little")
    return start.startswith(b"PK\3\4") and start[30 : 30 + length].endswith(_END.encode())


def open_npz(path: Path, mapping: ColumnMapping) -> LogTable:
    """A file of several arrays, by their headers."""
    fields: list[RecordedField] = []
    with _archive(path) as archive:
        for member in _arrays_of(archive):
            with archive.open(member) as file:
                header = _header(file)
            _require_sane(header, member)
            fields += header.fields(member.filename.removesuffix(_END))
    return ArrayTable(path, tuple(fields), partial(_members, path))


@contextmanager
def _members(path: Path, picks: Sequence[Pick]) -> Generator[Arrays, None, None]:
    """Arrays of an archive: those with a sample a row are streamed, others are in memory."""
    axes: dict[str, set[int]] = {}
    for pick in picks:
        axes.setdefault(pick.field.name, set()).add(pick.axis)
    with _archive(path) as archive, ExitStack() as members:
        found: dict[str, Sliceable] = {}
        for member in _arrays_of(archive):
            base = member.filename.removesuffix(_END)
            used = [name for name in axes if f"{name}.".startswith(f"{base}.")]
            if not used:
                continue
            stream = _Stream(members.enter_context(archive.open(member)))
            if axes.get(base) == {0} and stream.is_by_rows:
                found.setdefault(base, stream)
                continue
            with archive.open(member) as file:
                array = np.lib.format.read_array(file, allow_pickle=False)
            found = entries_of(base, array) | found
        yield found, BATCH_ROWS


@dataclass(frozen=True)
class _ArrayHeader:
    """What stands before the numbers of an array."""

    shape: tuple[int, ...]
    by_columns: bool
    dtype: np.dtype[Any]

    @property
    def bytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize

    def fields(self, name: str) -> list[RecordedField]:
        found = fields_of(name, self.shape, self.dtype)
        return [replace(field, name=field.name.removeprefix(".")) for field in found]


class _Stream:
    """An array that is read from its beginning to its end."""

    def __init__(self, file: Any) -> None:
        self._file, self._header, self._row = file, _header(file), 0
        self.is_by_rows = not self._header.by_columns or len(self._header.shape) == 1

    def __getitem__(self, index: tuple[slice, ...], /) -> np.ndarray:
        rows = index[0]
        assert rows.start == self._row, "rows come in order"
        self._row = rows.stop
        shape = (rows.stop - rows.start, *self._header.shape[1:])
        size = math.prod(shape) * self._header.dtype.itemsize
        data = self._file.read(size)
        if len(data) < size:
            raise EOFError("an array is cut off")
        part = np.frombuffer(data, self._header.dtype).reshape(shape)
        return part[(slice(None), *index[1:])]


def _arrays_of(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    return [member for member in archive.infolist() if member.filename.endswith(_END)]


@contextmanager
def _archive(path: Path) -> Generator[zipfile.ZipFile, None, None]:
    with _damage(path), opened(path) as file, zipfile.ZipFile(file) as archive:
        yield archive


@contextmanager
def _damage(path: Path) -> Generator[None, None, None]:
    """Turn what is raised over a damaged file into one message."""
    try:
        yield
    except _DAMAGE as error:
        raise RecordingError(
            f"is a damaged NumPy file: {first_line(error) or type(error).__name__}",
            where=str(path),
            cure="copy it again, or save it again with numpy.save or numpy.savez",
        ) from None


def _require_sane(header: _ArrayHeader, member: zipfile.ZipInfo) -> None:
    """Refuse an array that cannot be in what is stored, before memory is asked for."""
    if header.dtype.hasobject:
        return  # is not read at all
    if header.bytes > member.file_size or member.file_size > (member.compress_size + 100) * 1100:
        raise ValueError(
            f"{member.filename} claims {header.bytes} bytes, but has {member.compress_size}"
        )


def _header(file: Any) -> _ArrayHeader:
    """The header of an array.

    Raises:
        ValueError: it is damaged.
    """
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        read = np.lib.format.read_array_header_2_0
    with warnings.catch_warnings(action="ignore"):  # about headers that Python 2 wrote
        shape, by_columns, dtype = read(file)
    if min(shape, default=0) < 0:
        raise ValueError(f"it claims the shape {shape}")
    return _ArrayHeader(shape, by_columns, dtype)
