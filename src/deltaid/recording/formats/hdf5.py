"""Reads HDF5 files by h5py in slices; MATLAB files of version 7.3 are HDF5 files too."""

import math
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from deltaid.errors import RecordingError
from deltaid.recording.address import Pick, RecordedField
from deltaid.recording.formats.arrays import (
    DEFLATE_RATIO,
    Arrays,
    ArrayTable,
    entries_of,
    fields_of,
)
from deltaid.recording.formats.matlab import DEEPEST, MOST_FIELDS, matlab_object
from deltaid.recording.source import BATCH_ROWS, LogTable, damage, library, opened

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Possible places of the signature [bytes]: a user block, such as MATLAB's, may come first.
_STARTS = (0, 512, 1024, 2048)
# Largest chunk [bytes], because a chunk is unpacked as a whole; and largest dataset that may be
# stored as nothing, as zeros are.
_LARGEST_CHUNK = 1 << 30
# Largest slice of whole chunks [bytes].
_HELD = 1 << 27
# Errors of h5py about damaged files.
_DAMAGE = (
    OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, OverflowError,
    MemoryError, IndexError,
)  # fmt: skip
_PLAIN = (
    "double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64",
    "logical", "char", "struct", "cell",
)  # fmt: skip


def is_hdf5(start: bytes, path: Path) -> bool:
    return any(start[place:].startswith(_SIGNATURE) for place in _STARTS)


def open_hdf5(path: Path) -> LogTable:
    with _opened(path) as file, path.open("rb") as start:
        by_matlab = file.userblock_size >= 512 and start.read(6) == b"MATLAB"
        contents = list(islice(_contents(file, by_matlab), MOST_FIELDS))
    places = {field.name: place for field, place in contents if place}
    fields = tuple(field for field, _ in contents)
    return ArrayTable(path, fields, partial(_arrays, path, places, by_matlab))


# Place of a field's numbers: path of a dataset or a reference to it, and the names of the entry in
# a compound type.
_Place = tuple[Any, tuple[str, ...]]


@contextmanager
def _arrays(
    path: Path, places: Mapping[str, _Place], by_matlab: bool, picks: Sequence[Pick]
) -> Generator[Arrays, None, None]:
    """Datasets of some columns, with a few chunks in memory at a time.

    Whole chunks are read if they are small enough, so that each is unpacked once.
    """
    used = {(pick.field.name, pick.axis) for pick in picks}
    with _opened(path) as file:
        arrays = {
            name: _Dataset(file, places[name], by_matlab, f"{path}, {name}") for name, _ in used
        }
        chunk = max(arrays[name].chunk(axis) for name, axis in used)
        row = sum(arrays[name].nbytes // max(arrays[name].shape[axis], 1) for name, axis in used)
        whole = 0 < chunk * row <= _HELD
        yield arrays, -(-BATCH_ROWS // chunk) * chunk if whole else BATCH_ROWS


class _Dataset:
    def __init__(self, file: Any, place: _Place, reverse: bool, where: str) -> None:
        dataset, self._entry = file[place[0]], place[1]
        order = slice(None, None, -1 if reverse else None)
        self._dataset, self._reverse = dataset, reverse
        self.shape, self.nbytes = dataset.shape[order], dataset.nbytes
        self._chunks = (dataset.chunks or ())[order]
        # Sizes of a damaged header are refused before memory is allocated.
        chunk = math.prod(self._chunks) * dataset.dtype.itemsize
        stored = dataset.id.get_storage_size()
        if chunk > _LARGEST_CHUNK or dataset.nbytes > max(stored * DEFLATE_RATIO, _LARGEST_CHUNK):
            raise RecordingError(
                f"claims {dataset.nbytes:.3g} bytes in chunks of {chunk:.3g}, but "
                f"{stored:.3g} are stored",
                where=where,
                cure="it is damaged or was never written; copy or export it again, in chunks of at "
                f"most {_LARGEST_CHUNK >> 20} MB",
            )

    def __getitem__(self, index: tuple[slice, ...], /) -> np.ndarray:
        outer = index[: self._dataset.ndim]
        if self._entry:
            part = self._dataset.fields(self._entry[0])[outer]
            for name in self._entry[1:]:
                part = part[name]
            return part[(slice(None),) * len(outer) + index[len(outer) :]]
        return self._dataset[outer[::-1]].T if self._reverse else self._dataset[outer]

    def chunk(self, axis: int) -> int:
        """Number of samples per chunk; 0 for a contiguous dataset."""
        return self._chunks[axis] if axis < len(self._chunks) else 0


@contextmanager
def _opened(path: Path) -> Generator[Any, None, None]:
    """Open a file by h5py; its errors about damaged files become messages.

    Raises:
        RecordingError: the file is missing or damaged, or h5py is not installed.
    """
    h5py = library("h5py", "an HDF5 file", path)
    with opened(path):
        pass
    what = "is a damaged HDF5 file, or cannot be read"
    cure = (
        "copy or export it again; `h5repack -f GZIP=4 OLD NEW` writes it with a compression that "
        "is always there"
    )
    with damage(path, _DAMAGE, what, cure), h5py.File(path, "r", rdcc_nbytes=1 << 24) as file:
        yield file


def _contents(
    group: Any, by_matlab: bool, name: str = "", depth: int = 0
) -> Iterator[tuple[RecordedField, _Place | None]]:
    """Content of a group, by hard links only, because other links may lead to other files."""
    for key in group:
        hidden = by_matlab and not depth and key.startswith("#")
        linked = type(group.get(key, getlink=True)).__name__ == "HardLink"
        if linked and not hidden and depth <= DEEPEST:
            mark = ("." if by_matlab else "/") if name else ""
            yield from _fields_under(f"{name}{mark}{key}", group[key], by_matlab, depth)


def _fields_under(
    name: str, item: Any, by_matlab: bool, depth: int
) -> Iterator[tuple[RecordedField, _Place | None]]:
    kind = _matlab_class(item) if by_matlab else ""
    if kind and (kind not in _PLAIN or "MATLAB_object_decode" in item.attrs):
        yield matlab_object(name, kind), None
    elif not hasattr(item, "shape"):
        if hasattr(item, "keys"):
            yield from _contents(item, by_matlab, name, depth + 1)
    elif item.dtype.kind == "O" and by_matlab:
        yield from _members(name, item, depth)
    elif item.is_virtual or item.external:
        yield RecordedField(name, item.shape, holds="numbers kept in other files"), None
    elif item.shape is not None:
        dtype = np.dtype(bool) if kind == "logical" else item.dtype  # kept as bytes
        fields = fields_of(name, item.shape[::-1] if by_matlab else item.shape, dtype)
        for field, (entry, *_) in zip(fields, entries_of(dtype), strict=True):
            yield field, (item.name or item.ref, entry)


def _members(name: str, item: Any, depth: int) -> Iterator[tuple[RecordedField, _Place | None]]:
    """Members of a MATLAB cell or of a field of a struct array, by their numbers.

    In a struct array the number precedes the field: `signals[0].values`.
    """
    base, mark, last = name.rpartition(".")
    in_struct = mark and _matlab_class(item) != "cell"
    for i, reference in enumerate(item[()].T.ravel()[:MOST_FIELDS] if depth <= DEEPEST else ()):
        numbered = f"{base}[{i}].{last}" if in_struct else f"{name}[{i}]"
        yield from _fields_under(numbered, item.file[reference], True, depth + 1)


def _matlab_class(item: Any) -> str:
    kind = item.attrs.get("MATLAB_class", b"")
    return kind.decode("ascii", "replace") if isinstance(kind, bytes) else ""
