"""Elements of a MATLAB file of versions 5 to 7 as variables.

A file is a row of tagged elements, in the byte order of the writer. Nothing of what a header claims
is believed before it fits into the file. What a variable holds is found from its headers. Numbers
are read where they lie in the file, or from the whole variable in memory if it is compressed, as
MATLAB does unless told otherwise.
"""

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from deltaid.recording.address import RecordedField

# Bytes before the first element, as the format has it; types of elements that are variables.
_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
# Types of elements that hold numbers.
_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
# Classes of matrices: those of numbers are 6 to 15.
_CELL, _STRUCT, _OBJECT, _TEXT, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_HOLDS = {_TEXT: "text", _SPARSE: "a sparse matrix", _FUNCTION: "a function"}
# The flag of a matrix that has an imaginary part.
_COMPLEX = 0x800
# That of truth values.
_LOGICAL = 0x200
# Levels of structs, and fields of a variable, that are looked at; bytes that hold every header.
_DEEPEST, _MOST, _HEAD = 16, 2000, 1 << 14
_CURES = {
    "timetable": "s.t = seconds(x.Time - x.Time(1)); s.q = x.Variables",
    "timeseries": "s.t = x.Time; s.q = squeeze(x.Data)",
    "Simulink.SimulationData.Dataset": "v = x.get('q').Values; s.t = v.Time; s.q = v.Data",
}


class DamagedMatError(Exception):
    """A file does not hold what its headers say."""


@dataclass(frozen=True)
class MatVariable:
    """Where a variable is in the file [bytes], and whether compressed."""

    start: int
    size: int
    is_compressed: bool
    order: str

    def unpacked(self, data: memoryview, most: int | None = None) -> memoryview:
        """Its element with the tag, or as much of it from its beginning.

        Raises:
            DamagedMatError: what is compressed is broken.
        """
        held = data[self.start : self.start + self.size]
        if not self.is_compressed:
            return held
        try:
            start = zlib.decompressobj().decompress(held, 8)
            size = 8 + int(np.frombuffer(start, f"{self.order}u4", 2)[1])
            if size > _HEAD + 1100 * len(held):  # no more than deflate can do
                raise DamagedMatError(f"the variable at byte {self.start} claims {size} bytes")
            whole = zlib.decompressobj().decompress(held, min(size, most or size))
        except (zlib.error, ValueError) as error:
            raise DamagedMatError(
                f"the variable at byte {self.start} does not unpack: {error}"
            ) from None
        if len(whole) < min(size, most or size):
            raise DamagedMatError(f"the variable at byte {self.start} is cut off")
        return memoryview(whole)


@dataclass(frozen=True)
class Numbers:
    """Where in an unpacked variable an array is."""

    offset: int
    dtype: str
    shape: tuple[int, ...]

    def array(self, data: memoryview) -> np.ndarray:
        """The array, in the memory of the variable.

        Raises:
            DamagedMatError: it does not fit into the variable.
        """
        count = math.prod(self.shape)
        if self.offset + count * np.dtype(self.dtype).itemsize > len(data):
            raise DamagedMatError(
                f"an array of {count} numbers ends behind the end of its variable"
            )
        return np.frombuffer(data, self.dtype, count, self.offset).reshape(self.shape, order="F")


def variables(data: memoryview) -> Iterator[MatVariable]:
    """All variables of a file.

    Raises:
        DamagedMatError: it ends within one, or its header is none.
    """
    order = {b"IM": "<", b"MI": ">"}.get(bytes(data[126:128]))
    if order is None:
        raise DamagedMatError("its header of 128 bytes does not say the byte order")
    at = _HEADER
    while at + 8 <= len(data):
        kind, size = (int(n) for n in np.frombuffer(data, f"{order}u4", 2, at))
        if kind not in (_MATRIX, _COMPRESSED):
            raise DamagedMatError(f"there is no variable at byte {at}")
        if at + 8 + size > len(data):
            raise DamagedMatError(f"the variable at byte {at} ends behind the end of the file")
        if kind == _COMPRESSED:
            yield MatVariable(at + 8, size, True, order)
        else:
            yield MatVariable(at, 8 + size, False, order)
        at += 8 + size + (-size % 8 if kind == _MATRIX else 0)


def contents(
    data: memoryview, variable: MatVariable
) -> Iterator[tuple[str, Numbers | RecordedField]]:
    """What a variable holds, with the addresses: arrays, and what are none.

    Raises:
        DamagedMatError: its headers contradict one another.
    """
    head = _Reader(variable.unpacked(data, _HEAD), variable)
    if head.next_class() in (_CELL, _STRUCT, _OBJECT):
        head = _Reader(variable.unpacked(data), variable)
    yield from islice(head.matrix("", 0), _MOST)


@dataclass
class _Element:
    kind: int
    start: int
    size: int


class _Reader:
    def __init__(self, data: memoryview, variable: MatVariable) -> None:
        self._data, self._order = data, variable.order
        self._where = f"the variable at byte {variable.start}"
        self._at = 0

    def next_class(self) -> int:
        """Of the matrix that comes next; it is not read."""
        before = self._at
        self._at = self._element().start
        flags = self._element()
        self._at = before
        return self._integers(flags, "u4", 1)[0] & 0xFF

    def matrix(self, name: str, depth: int) -> Iterator[tuple[str, Numbers | RecordedField]]:
        """What the matrix that comes next holds; its own name if none is given."""
        whole = self._element()
        end = whole.start + whole.size
        if whole.kind != _MATRIX:
            raise DamagedMatError(f"{self._where} has no matrix at its byte {whole.start}")
        if not whole.size:
            yield name, RecordedField(name, (0, 0))
            return
        self._at = whole.start
        flags = self._integers(self._element(), "u4", 1)[0]
        kind = flags & 0xFF
        if kind == _OPAQUE:
            own, _, of_class = (self._text(self._element()) for _ in range(3))
            yield name or own, matlab_object(name or own, of_class)
            self._at = _padded(end)
            return
        shape = self._integers(self._element(), "i4", 64)
        own = self._text(self._element())
        name = name or own
        if min(shape, default=0) < 0 or len(shape) < 2:
            raise DamagedMatError(f"{self._where} has the size {shape}")
        if kind in _HOLDS or flags & _COMPLEX:
            yield name, RecordedField(name, tuple(shape), holds=_HOLDS.get(kind, "complex numbers"))
        elif kind in (_CELL, _STRUCT, _OBJECT):
            if kind == _OBJECT:
                self._element()
            yield from self._entries(name, kind, math.prod(shape), end, depth)
        elif name:  # what has none is MATLAB's own
            numbers = self._numbers(self._element(), tuple(shape))
            is_truth = flags & _LOGICAL and np.dtype(numbers.dtype).itemsize == 1
            yield name, replace(numbers, dtype="?") if is_truth else numbers
        self._at = _padded(end)

    def _entries(
        self, name: str, kind: int, count: int, end: int, depth: int
    ) -> Iterator[tuple[str, Numbers | RecordedField]]:
        tails = [""] if kind == _CELL else self._fields()
        entries = count * len(tails)
        if entries * 8 > end - self._at or depth > _DEEPEST:
            raise DamagedMatError(f"{self._where} claims {entries} entries at level {depth}")
        for i in range(count):
            base = name if kind != _CELL and count == 1 else f"{name}[{i}]"
            for tail in tails:
                yield from self.matrix(f"{base}{tail}", depth + 1)

    def _fields(self) -> list[str]:
        (length,) = self._integers(self._element(), "i4", 1)
        table = bytes(self._bytes(self._element()))
        if length < 1:
            raise DamagedMatError(f"{self._where} has names of fields of length {length}")
        rows = (table[i : i + length] for i in range(0, len(table), length))
        return ["." + row.partition(b"\0")[0].decode("utf-8", "replace") for row in rows]

    def _numbers(self, element: _Element, shape: tuple[int, ...]) -> Numbers:
        kind = _TYPES.get(element.kind)
        if kind is None:
            raise DamagedMatError(f"{self._where} holds elements of type {element.kind}")
        if math.prod(shape) * int(kind[1]) != element.size:
            raise DamagedMatError(
                f"{self._where} is of size {shape}, but holds {element.size} bytes of {kind}"
            )
        return Numbers(element.start, self._order + kind, shape)

    def _element(self) -> _Element:
        """The tag that comes next; what follows it is skipped."""
        if self._at + 8 > len(self._data):
            raise DamagedMatError(f"{self._where} ends within a header")
        kind, size = (int(n) for n in np.frombuffer(self._data, f"{self._order}u4", 2, self._at))
        if kind >> 16:  # up to four bytes stand in the tag itself
            element = _Element(kind & 0xFFFF, self._at + 4, min(kind >> 16, 4))
            self._at += 8
        else:
            element = _Element(kind, self._at + 8, size)
            self._at = _padded(self._at + 8 + size)
        return element

    def _bytes(self, element: _Element) -> memoryview:
        held = self._data[element.start : element.start + element.size]
        if len(held) < element.size:
            raise DamagedMatError(f"{self._where} ends within a header")
        return held

    def _integers(self, element: _Element, kind: str, most: int) -> list[int]:
        held = self._bytes(element)
        if not int(kind[1]) <= len(held) <= 8 * most or len(held) % int(kind[1]):
            raise DamagedMatError(f"{self._where} has a header of {len(held)} bytes")
        return [int(n) for n in np.frombuffer(held, self._order + kind)]

    def _text(self, element: _Element) -> str:
        return bytes(self._bytes(element)).decode("utf-8", "replace")


def _padded(at: int) -> int:
    return at + -at % 8


def matlab_object(name: str, kind: str) -> RecordedField:
    """An object of a class, of which only MATLAB knows how it is stored."""
    line = _CURES.get(kind, _CURES["timeseries"])
    return RecordedField(
        name,
        (),
        holds=f"a MATLAB object of class {kind[:40]}",
        cure=f"in MATLAB: x = {name}; {line}; save('log.mat', '-struct', 's')",
        is_opaque=True,
    )
