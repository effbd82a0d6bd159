"""Reads MATLAB files of versions 5 to 7; those of 7.3 are HDF5.

A file is a sequence of tagged elements in the byte order of the writer. Headers describe the
content of a variable; the sizes that they state are checked against that of the file. Numbers are
read from the mapped file, or from the unpacked variable if it is compressed, which is MATLAB's
default.
"""

import math
import mmap
import zlib
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from deltaid.recording.address import Pick, RecordedField
from deltaid.recording.formats.arrays import DEFLATE_RATIO, Arrays, ArrayTable
from deltaid.recording.source import BATCH_ROWS, CHUNK, LogTable, damage, opened

# Place of the mark of the byte order, at the end of the header [bytes].
_ORDER = slice(126, 128)
# Types of elements that are variables.
_MATRIX, _COMPRESSED = 14, 15
# Types of elements that hold numbers.
_TYPES = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
# Classes of matrices without numbers; those of numbers are 6 to 15.
_CELL, _STRUCT, _OBJECT, _OPAQUE = 1, 2, 3, 17
_HOLDS = {4: "text", 5: "a sparse matrix", 16: "a function"}
# Flags of a matrix with an imaginary part, and of a matrix of truth values.
_COMPLEX, _LOGICAL = 0x800, 0x200
# Most levels of structs, and most fields of a variable, that are read.
DEEPEST, MOST_FIELDS = 16, 2000
_CURES = {
    "timetable": "s.t = seconds(x.Time - x.Time(1)); s.q = x.Variables",
    "timeseries": "s.t = x.Time; s.q = squeeze(x.Data)",
    "Simulink.SimulationData.Dataset": "v = x.get('q').Values; s.t = v.Time; s.q = v.Data",
}


class DamagedMatError(Exception):
    """Raised for a file whose content contradicts its headers."""


@dataclass(frozen=True)
class MatVariable:
    """Place of a variable in the file [bytes], whether it is compressed, and its byte order."""

    start: int
    size: int
    is_compressed: bool
    order: str

    def unpacked(self, data: memoryview, most: int | None = None) -> memoryview:
        """Element of the variable with its tag, or the first `most` bytes of it.

        Raises:
            DamagedMatError: the compressed data is damaged.
        """
        held, where = data[self.start :][: self.size], f"the variable at byte {self.start}"
        if not self.is_compressed:
            return held
        try:
            start = zlib.decompressobj().decompress(held, 8)
            size = 8 + int(np.frombuffer(start, f"{self.order}u4", 2)[1])
            if size > CHUNK + DEFLATE_RATIO * len(held):
                raise DamagedMatError(f"{where} claims {size} bytes")
            size = min(size, most or size)
            whole = zlib.decompressobj().decompress(held, size)
        except (zlib.error, ValueError) as error:
            raise DamagedMatError(f"{where} does not unpack: {error}") from None
        if len(whole) < size:
            raise DamagedMatError(f"{where} is cut off")
        return memoryview(whole)


@dataclass(frozen=True)
class Numbers:
    """Place, type and shape of an array in an unpacked variable."""

    offset: int
    dtype: str
    shape: tuple[int, ...]

    def array(self, data: memoryview) -> np.ndarray:
        """Array in the memory of the variable.

        Raises:
            DamagedMatError: the array does not fit into the variable.
        """
        count = math.prod(self.shape)
        if self.offset + count * np.dtype(self.dtype).itemsize > len(data):
            raise DamagedMatError(
                f"an array of {count} numbers ends behind the end of its variable"
            )
        return np.frombuffer(data, self.dtype, count, self.offset).reshape(self.shape, order="F")


# Content of an address: an array, or a field of another kind.
_Held = tuple[str, Numbers | RecordedField]


def is_matlab(start: bytes, path: Path) -> bool:
    return start.startswith(b"MATLAB") or start[_ORDER] in (b"IM", b"MI")


def open_matlab(path: Path) -> LogTable:
    """Open a MATLAB file before 7.3: its variables, and members of structs and cells."""
    fields: list[RecordedField] = []
    places: dict[str, tuple[MatVariable, Numbers]] = {}
    with _mapped(path) as data:
        for variable in _variables(data):
            contents = _Reader(data, variable).matrix("", 0)
            for name, held in islice(contents, MOST_FIELDS):
                if isinstance(held, Numbers):
                    fields.append(RecordedField(name, held.shape, is_truth=held.dtype == "?"))
                    places.setdefault(name, (variable, held))
                else:
                    fields.append(held)
    return ArrayTable(path, tuple(fields), partial(_arrays, path, places))


@contextmanager
def _arrays(
    path: Path, places: Mapping[str, tuple[MatVariable, Numbers]], picks: Sequence[Pick]
) -> Generator[Arrays, None, None]:
    """Arrays of some columns: compressed variables are unpacked in memory, others are mapped."""
    used = {pick.field.name: places[pick.field.name] for pick in picks}
    with _mapped(path) as data:
        unpacked = {variable: variable.unpacked(data) for variable, _ in used.values()}
        arrays = {
            name: numbers.array(unpacked[variable]) for name, (variable, numbers) in used.items()
        }
        yield arrays, BATCH_ROWS


@contextmanager
def _mapped(path: Path) -> Generator[memoryview, None, None]:
    """Map a file into memory.

    Raises:
        RecordingError: the file is damaged; names the place.
    """
    cure = "copy it again, or save it again with save('log.mat', '-v7')"
    with opened(path) as file, damage(path, DamagedMatError, "is a damaged MATLAB file", cure):
        # Arrays keep the map alive, so it is closed with the last of them.
        yield memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def matlab_object(name: str, kind: str) -> RecordedField:
    """Field that holds an object of a class, whose storage only MATLAB knows."""
    line = _CURES.get(kind, _CURES["timeseries"])
    return RecordedField(
        name,
        (),
        holds=f"a MATLAB object of class {kind[:40]}",
        cure=f"in MATLAB: x = {name}; {line}; save('log.mat', '-struct', 's')",
        is_opaque=True,
    )


def _variables(data: memoryview) -> Iterator[MatVariable]:
    order = {b"IM": "<", b"MI": ">"}.get(bytes(data[_ORDER]))
    if order is None:
        raise DamagedMatError("its header of 128 bytes does not say the byte order")
    at = _ORDER.stop
    while at + 8 <= len(data):
        kind, size = (int(n) for n in np.frombuffer(data, f"{order}u4", 2, at))
        if kind not in (_MATRIX, _COMPRESSED):
            raise DamagedMatError(f"there is no variable at byte {at}")
        if at + 8 + size > len(data):
            raise DamagedMatError(f"the variable at byte {at} ends behind the end of the file")
        packed = kind == _COMPRESSED
        yield MatVariable(at + 8 * packed, size + 8 * (not packed), packed, order)
        at += 8 + size + (0 if packed else -size % 8)


class _Reader:
    """Reads the elements of a variable, whose headers may be inconsistent.

    Only a variable that contains others is unpacked as a whole.
    """

    def __init__(self, file: memoryview, variable: MatVariable) -> None:
        self._file, self._variable = file, variable
        self._data, self._order, self._at = variable.unpacked(file, CHUNK), variable.order, 0
        self._where = f"the variable at byte {variable.start}"

    def matrix(self, name: str, depth: int) -> Iterator[_Held]:
        """Content of the next matrix, under the given name or, if that is empty, its own."""
        kind, start, size = self._element()
        end = _padded(start + size)
        if kind != _MATRIX:
            raise DamagedMatError(f"{self._where} has no matrix at its byte {start}")
        if not size:
            yield name, RecordedField(name, (0, 0))
            return
        self._at = start
        flags = self._integers("u4", 1)[0]
        kind = flags & 0xFF
        if kind in (_CELL, _STRUCT, _OBJECT) and not depth:
            self._data = self._variable.unpacked(self._file)
        if kind == _OPAQUE:
            title, _, of_class = (self._text() for _ in range(3))
            yield name or title, matlab_object(name or title, of_class)
            self._at = end
            return
        shape, title = self._integers("i4", 64), self._text()
        name = name or title
        if min(shape, default=0) < 0 or len(shape) < 2:
            raise DamagedMatError(f"{self._where} has the size {shape}")
        if kind in _HOLDS or flags & _COMPLEX:
            yield name, RecordedField(name, tuple(shape), holds=_HOLDS.get(kind, "complex numbers"))
        elif kind in (_CELL, _STRUCT, _OBJECT):
            if kind == _OBJECT:
                self._element()
            yield from self._entries(name, kind, math.prod(shape), start + size, depth)
        elif name:  # variables without a name are internal
            numbers = self._numbers(tuple(shape))
            is_truth = flags & _LOGICAL and np.dtype(numbers.dtype).itemsize == 1
            yield name, replace(numbers, dtype="?") if is_truth else numbers
        self._at = end

    def _entries(self, name: str, kind: int, count: int, end: int, depth: int) -> Iterator[_Held]:
        tails = [""] if kind == _CELL else self._fields()
        entries = count * len(tails)
        if entries * 8 > end - self._at or depth > DEEPEST:
            raise DamagedMatError(f"{self._where} claims {entries} entries at level {depth}")
        for i in range(count):
            base = name if kind != _CELL and count == 1 else f"{name}[{i}]"
            for tail in tails:
                yield from self.matrix(f"{base}{tail}", depth + 1)

    def _fields(self) -> list[str]:
        (length,), table = self._integers("i4", 1), bytes(self._held())
        if length < 1:
            raise DamagedMatError(f"{self._where} has names of fields of length {length}")
        rows = (table[i : i + length] for i in range(0, len(table), length))
        return ["." + row.partition(b"\0")[0].decode("utf-8", "replace") for row in rows]

    def _numbers(self, shape: tuple[int, ...]) -> Numbers:
        number, start, size = self._element()
        kind = _TYPES.get(number)
        if kind is None:
            raise DamagedMatError(f"{self._where} holds elements of type {number}")
        if math.prod(shape) * int(kind[1]) != size:
            raise DamagedMatError(
                f"{self._where} is of size {shape}, but holds {size} bytes of {kind}"
            )
        return Numbers(start, self._order + kind, shape)

    def _element(self) -> tuple[int, int, int]:
        """Consume the next element; returns its type, start and size [bytes]."""
        at = self._at
        if at + 8 > len(self._data):
            raise DamagedMatError(f"{self._where} ends within a header")
        kind, size = (int(n) for n in np.frombuffer(self._data, f"{self._order}u4", 2, at))
        if kind >> 16:  # the tag holds up to four bytes of content
            self._at += 8
            return kind & 0xFFFF, at + 4, min(kind >> 16, 4)
        self._at = _padded(at + 8 + size)
        return kind, at + 8, size

    def _held(self) -> memoryview:
        _, start, size = self._element()
        held = self._data[start : start + size]
        if len(held) < size:
            raise DamagedMatError(f"{self._where} ends within a header")
        return held

    def _integers(self, kind: str, most: int) -> list[int]:
        held = self._held()
        if not int(kind[1]) <= len(held) <= 8 * most or len(held) % int(kind[1]):
            raise DamagedMatError(f"{self._where} has a header of {len(held)} bytes")
        return [int(n) for n in np.frombuffer(held, self._order + kind)]

    def _text(self) -> str:
        return bytes(self._held()).decode("utf-8", "replace")


def _padded(at: int) -> int:
    return at + -at % 8
