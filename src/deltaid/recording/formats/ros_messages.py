"""Decodes JointState and DynamicJointState messages from bytes.

Messages of a topic usually have the same joints and lengths of text. So one message of each layout
is parsed field by field, and all others with this layout are decoded together, which takes half a
microsecond per message; creating an object takes 7 to 25. Both types are the same in all releases,
so no message definition is needed, which SQLite bags of older releases lack.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

# A quantity and a joint: ("position", "joint_1").
Number = tuple[str, str]


class MessageError(ValueError):
    """Raised for a message that does not fit its type.

    Attributes:
        index: index of the message among those that are decoded together.
    """

    index = 0


@dataclass(frozen=True, eq=False)
class MessageLayout:
    """Layout that several messages share.

    Attributes:
        order: byte order, `<` or `>`.
        stamp: offset of seconds and nanoseconds, four bytes each.
        numbers: offset of the number of each quantity and joint [bytes].
        fixed: offsets of counts and names, which are equal in all messages of this layout.
        pattern: bytes at these offsets. Padding between fields is arbitrary.
    """

    order: str
    stamp: int
    numbers: dict[Number, int]
    fixed: Int[np.ndarray, " fixed"]
    pattern: UInt8[np.ndarray, " fixed"]

    def decode(
        self, rows: UInt8[np.ndarray, "messages size"], wanted: Sequence[Number]
    ) -> tuple[Int[np.ndarray, " messages"], Float[np.ndarray, "messages wanted"]]:
        """Stamps [ns] and numbers of messages of this layout; NaN for numbers that they lack."""
        words = np.ascontiguousarray(rows[:, self.stamp : self.stamp + 8]).view(f"{self.order}i4")
        values = np.full((len(rows), len(wanted)), np.nan)
        known = [k for k, number in enumerate(wanted) if number in self.numbers]
        starts = np.array([self.numbers[wanted[k]] for k in known], dtype=np.int64)
        packed = rows[:, (starts[:, None] + np.arange(8)).ravel()]
        values[:, known] = np.ascontiguousarray(packed).view(f"{self.order}f8")
        return words[:, 0].astype(np.int64) * 1_000_000_000 + words[:, 1], values


def layout_of(raw: bytes, kind: str, cdr: bool) -> MessageLayout:
    """Layout of a message.

    Args:
        raw: bytes of the message.
        kind: type of the message, one of `TYPES`.
        cdr: whether the message is in the encoding of ROS 2, else in that of ROS 1.

    Raises:
        MessageError: the message is damaged, or in an unknown encoding.
    """
    cursor = _Cursor(raw, cdr)
    if not cdr:
        cursor.skip(4)  # header.seq counts the messages
    stamp = cursor.skip(8)
    cursor.text(same=False)
    numbers, rest = TYPES[kind](cursor), len(raw) - cursor.at
    if rest > 3 * cdr:  # padding
        raise MessageError(f"has {rest} bytes after its last field")
    fixed = np.concatenate([np.array(part, dtype=np.int64) for part in cursor.fixed])
    return MessageLayout(cursor.order, stamp, numbers, fixed, np.frombuffer(raw, np.uint8)[fixed])


def decoded(
    raws: Sequence[bytes], wanted: Sequence[Number], kind: str, cdr: bool
) -> tuple[Int[np.ndarray, " messages"], Float[np.ndarray, "messages wanted"]]:
    """Header stamps [ns] and wanted numbers; NaN for numbers that a message lacks.

    Args:
        raws: messages of one topic.
        wanted: quantity and joint of each number.
        kind, cdr: as in `layout_of`.

    Raises:
        MessageError: as in `layout_of`, with the index of the message.
    """
    stamps, values = np.empty(len(raws), dtype=np.int64), np.empty((len(raws), len(wanted)))
    sizes = np.array([len(raw) for raw in raws])
    for size in np.unique(sizes).tolist():
        pending = np.flatnonzero(sizes == size)
        joined = b"".join([raws[i] for i in pending.tolist()])
        rows = np.frombuffer(joined, np.uint8).reshape(len(pending), size)
        while len(pending):
            try:
                layout = layout_of(raws[pending[0]], kind, cdr)
            except MessageError as error:
                error.index = int(pending[0])
                raise
            fits = (rows[:, layout.fixed] == layout.pattern).all(axis=1)
            stamps[pending[fits]], values[pending[fits]] = layout.decode(rows[fits], wanted)
            pending, rows = pending[~fits], rows[~fits]
    return stamps, values


class _Cursor:
    """Reads the fields of a message, and records the offsets of bytes that its layout fixes."""

    def __init__(self, raw: bytes, cdr: bool) -> None:
        self._raw, self._aligned = raw, cdr
        self.order = "<"
        if cdr:
            if raw[:2] not in (b"\x00\x00", b"\x00\x01"):
                raise MessageError("is not in CDR, the encoding of ROS 2")
            self.order = "<" if raw[1] else ">"
        self._start = self.at = 4 if cdr else 0
        self.fixed: list[range] = [range(self._start)]

    def skip(self, size: int) -> int:
        """Skip `size` bytes; returns the offset of the first."""
        start, self.at = self.at, self.at + size
        if self.at > len(self._raw):
            raise MessageError("ends in the middle of a field")
        return start

    def count(self) -> int:
        self._align(4)
        start = self.skip(4)
        self.fixed.append(range(start, self.at))
        return int.from_bytes(self._raw[start : self.at], "little" if self.order == "<" else "big")

    def text(self, *, same: bool = True) -> str:
        start = self.skip(self.count())
        if same:
            self.fixed.append(range(start, self.at))
        return self._raw[start : self.at].rstrip(b"\0").decode(errors="replace")

    def texts(self) -> list[str]:
        return [self.text() for _ in range(self.items(4))]

    def numbers(self) -> list[int]:
        """Offsets of the numbers of a list of binary64."""
        if count := self.count():
            self._align(8)
        start = self.skip(8 * count)
        return list(range(start, self.at, 8))

    def items(self, smallest: int) -> int:
        """Length of a list whose items have at least `smallest` bytes each."""
        count = self.count()
        if count * smallest > len(self._raw) - self.at:
            raise MessageError(f"says that it has a list of {count} entries, but is too short")
        return count

    def _align(self, size: int) -> None:
        if self._aligned:
            self.at += -(self.at - self._start) % size


def _joint_state(cursor: _Cursor) -> dict[Number, int]:
    joints, numbers = _unique(cursor.texts(), "joint"), dict[Number, int]()
    for quantity in ("position", "velocity", "effort"):
        at = cursor.numbers()
        if at and len(at) != len(joints):
            raise MessageError(f"has {len(joints)} joints but {len(at)} numbers of {quantity}")
        numbers |= {(quantity, joint): start for joint, start in zip(joints, at, strict=False)}
    return numbers


def _dynamic_joint_state(cursor: _Cursor) -> dict[Number, int]:
    joints, numbers = _unique(cursor.texts(), "joint"), dict[Number, int]()
    if (count := cursor.items(8)) != len(joints):
        raise MessageError(f"has {len(joints)} joints but values of {count}")
    for joint in joints:
        interfaces, at = _unique(cursor.texts(), f"interface of {joint}"), cursor.numbers()
        if len(at) != len(interfaces):
            raise MessageError(f"has {len(interfaces)} interfaces but {len(at)} values of {joint}")
        numbers |= {(name, joint): start for name, start in zip(interfaces, at, strict=True)}
    return numbers


def _unique(names: list[str], what: str) -> list[str]:
    for name in names:
        if names.count(name) > 1:
            raise MessageError(f"names the {what} '{name[:40]}' {names.count(name)} times")
    return names


TYPES: dict[str, Callable[[_Cursor], dict[Number, int]]] = {
    "sensor_msgs/msg/JointState": _joint_state,
    "control_msgs/msg/DynamicJointState": _dynamic_joint_state,
}
