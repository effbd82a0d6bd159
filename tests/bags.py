"""Bags for tests: one recording of joint states in each kind of bag, read or refused."""

import gzip
import sqlite3
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mcap.writer
import numpy as np
import pytest
import zstandard
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from deltaid.errors import RecordingError
from deltaid.recording.source import LogTable
from deltaid.recording.table import open_table

START = 1_700_000_000_000_000_000
_DYNAMIC = "control_msgs/msg/DynamicJointState"
_STATE = "sensor_msgs/msg/JointState"
_ROS_1, _ROS_2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
for _store in (_ROS_1, _ROS_2):
    _store.register(
        get_types_from_msg(
            "string[] interface_names\nfloat64[] values", "control_msgs/msg/InterfaceValue"
        )
        | get_types_from_msg(
            "std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values",
            _DYNAMIC,
        )
    )


@dataclass
class State:
    """A message: numbers by joint, for each quantity.

    Attributes:
        stamp: of the header [ns].
        at: when it was received [ns]; the stamp by default.
        frame, number: frame_id and seq of the header.
    """

    stamp: int
    joints: Sequence[str]
    numbers: dict[str, Sequence[float] | np.ndarray]
    topic: str = "/joint_states"
    dynamic: bool = False
    at: int = 0
    frame: str = ""
    number: int = 0

    @property
    def type(self) -> str:
        return _DYNAMIC if self.dynamic else _STATE

    @property
    def received(self) -> int:
        return self.at or self.stamp

    def raw(self, ros1: bool = False, little: bool = True) -> bytes:
        """In the encoding of ROS 1 or 2."""
        store = _ROS_1 if ros1 else _ROS_2
        kinds: Any = store.types
        time = kinds["builtin_interfaces/msg/Time"](*divmod(self.stamp, 10**9))
        counted = [self.number] * ros1
        header = kinds["std_msgs/msg/Header"](*counted, stamp=time, frame_id=self.frame)
        numbers = {key: np.ascontiguousarray(value, float) for key, value in self.numbers.items()}
        if self.dynamic:
            message_type = kinds["control_msgs/msg/InterfaceValue"]
            values = [
                message_type(list(numbers), np.array([column[i] for column in numbers.values()]))
                for i in range(len(self.joints))
            ]
            message = kinds[_DYNAMIC](header, list(self.joints), values)
        else:
            lists = [numbers.get(key, np.zeros(0)) for key in ("position", "velocity", "effort")]
            message = kinds[_STATE](header, list(self.joints), *lists)
        if ros1:
            return bytes(store.serialize_ros1(message, self.type))
        return bytes(store.serialize_cdr(message, self.type, little_endian=little))


def states(
    time: np.ndarray, columns: dict[str, np.ndarray], joints: Sequence[str], **more: Any
) -> list[State]:
    """One message a row, times in whole nanoseconds."""
    stamps = START + np.round(time * 1e9).astype(int)
    return [
        State(int(stamp), joints, {key: column[k] for key, column in columns.items()}, **more)
        for k, stamp in enumerate(stamps)
    ]


def _ros1(path: Path, messages: Iterable[State], packed: str = "") -> Path:
    path = path / "log.bag"
    writer = rosbag1.Writer(path)
    if packed:
        writer.set_compression(writer.CompressionFormat[packed])
    _write(writer, messages, ros1=True)
    return path


def _ros2(
    path: Path,
    messages: Iterable[State],
    storage: str = "SQLITE3",
    packed: str = "",
    version: Any = 9,
) -> Path:
    path = path / "log"
    writer = rosbag2.Writer(path, version=version, storage_plugin=rosbag2.StoragePlugin[storage])
    if packed:
        mode = rosbag2.CompressionMode[packed]
        writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    _write(writer, messages, ros1=False)
    return path


def _write(writer: Any, messages: Iterable[State], *, ros1: bool) -> None:
    """All messages, which are numbered in ROS 1, with a connection for each topic."""
    topics: dict[str, Any] = {}
    with writer:
        for k, message in enumerate(messages):
            if message.topic not in topics:
                topics[message.topic] = writer.add_connection(
                    message.topic, message.type, typestore=_ROS_1 if ros1 else _ROS_2
                )
            message.number = k
            writer.write(topics[message.topic], message.received, message.raw(ros1))


def _mcap(path: Path, messages: Iterable[State], packed: str = "LZ4", **options: Any) -> Path:
    """Written by the library of the format's makers."""
    path = path / "log.mcap"
    with path.open("wb") as file:
        kind = mcap.writer.CompressionType[packed]
        writer = mcap.writer.Writer(file, compression=kind, **{"chunk_size": 1 << 14} | options)
        writer.start("ros2", "test")
        channels: dict[str, int] = {}
        for message in messages:
            if message.topic not in channels:
                schema = writer.register_schema(message.type, "ros2msg", b"")
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            writer.add_message(
                channels[message.topic], message.received, message.raw(), message.received
            )
        writer.finish()
    return path


def _alone(path: Path, messages: Iterable[State], end: str, **options: Any) -> Path:
    """The file of messages without its folder."""
    folder = _ros2(path, messages, **options)
    return next(folder.glob(f"*{end}")).rename(path / f"alone{end}")


def _oldest(path: Path, messages: Iterable[State]) -> Path:
    """As the first releases of ROS 2 wrote it, without definitions of messages."""
    path = path / "old.db3"
    with closing(sqlite3.connect(path)) as base:
        columns = "id INTEGER PRIMARY KEY, name, type, serialization_format"
        base.execute(f"CREATE TABLE topics({columns})")
        base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        topics: dict[str, int] = {}
        for message in messages:
            if message.topic not in topics:
                topics[message.topic] = len(topics) + 1
                row = (topics[message.topic], message.topic, message.type, "cdr")
                base.execute("INSERT INTO topics VALUES (?, ?, ?, ?)", row)
            row = (topics[message.topic], message.received, message.raw())
            base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)
        base.commit()
    return path


def _gzipped(path: Path, messages: Iterable[State]) -> Path:
    bag = _ros1(path, messages)
    packed = path / "log.bag.gz"
    packed.write_bytes(gzip.compress(bag.read_bytes()))
    return packed


def _renamed(path: Path, messages: Iterable[State]) -> Path:
    return _ros1(path, messages).rename(path / "log.data")


def _zstandard(path: Path, messages: Iterable[State]) -> Path:
    file = _mcap(path, messages, packed="NONE")
    packed = path / "log.mcap.zst"
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    return packed


# How to write messages into a folder, by the kind of bag.
KINDS: dict[str, Callable[[Path, Iterable[State]], Path]] = {
    "ros1": _ros1,
    "ros1-lz4": lambda path, messages: _ros1(path, messages, "LZ4"),
    "ros1-bz2": lambda path, messages: _ros1(path, messages, "BZ2"),
    "ros1-gzip": _gzipped,
    "ros1-renamed": _renamed,
    "sqlite": _ros2,
    "sqlite-old": lambda path, messages: _ros2(path, messages, version=8),
    "sqlite-zstd": lambda path, messages: _ros2(path, messages, packed="FILE"),
    "sqlite-messages": lambda path, messages: _ros2(path, messages, packed="MESSAGE"),
    "sqlite-oldest": _oldest,
    "db3": lambda path, messages: _alone(path, messages, ".db3"),
    "db3-zstd": lambda path, messages: _alone(path, messages, ".db3.zstd", packed="FILE"),
    "db3-messages": lambda path, messages: _alone(path, messages, ".db3", packed="MESSAGE"),
    "mcap-folder": lambda path, messages: _ros2(path, messages, "MCAP"),
    "mcap-zstd": lambda path, messages: _ros2(path, messages, "MCAP", "STORAGE"),
    "mcap": lambda path, messages: _alone(path, messages, ".mcap", storage="MCAP"),
    "mcap-lz4": _mcap,
    "mcap-plain": lambda path, messages: _mcap(path, messages, "NONE", use_chunking=False),
    "mcap-file-zstd": _zstandard,
}


JOINTS = ["joint_1", "joint_2", "joint_3"]
ROWS = 500
TIME = np.arange(ROWS) / 1000
RNG = np.random.default_rng(5)
COLUMNS = {key: RNG.normal(size=(ROWS, 3)) for key in ("position", "velocity", "effort")}
MESSAGES = states(TIME, COLUMNS, JOINTS)
NAMES = [f"{short}{i + 1}" for short in ("q", "qd", "tau") for i in range(3)]
ALL = np.hstack([TIME[:, None], *COLUMNS.values()])


def read(table: LogTable, columns: list[str]) -> np.ndarray:
    return np.vstack([np.column_stack(rows.numbers) for rows in table.rows(columns)])


def address(quantity: str, joint: str, topic: str = "/joint_states") -> str:
    return f"{topic}.{quantity}[{joint}]"


def refused(path: Path, columns: list[str]) -> str:
    with pytest.raises(RecordingError) as caught:
        read(open_table(path), columns)
    return str(caught.value)
