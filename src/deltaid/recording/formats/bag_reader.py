"""Reads messages of all kinds of ROS bags as bytes, and topics of joint states.

On each pass, compressed bags are unpacked, and bags with a suffix that rosbags does not know are
copied, into a temporary folder.
"""

import shutil
from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from deltaid.errors import RecordingError, visible
from deltaid.recording.address import RecordedField, listing
from deltaid.recording.formats.ros_messages import TYPES, MessageError, decoded, layout_of
from deltaid.recording.source import ZSTD, content, damage, library, packed_by, unzstd

_ROS_1, _MCAP, _SQLITE = b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\0"
_SUFFIXES = {_ROS_1: ".bag", _MCAP: ".mcap", _SQLITE: ".db3"}
_CURES = {
    ".bag": "copy it again; if its recording was cut off, `rosbag reindex FILE` repairs it",
    ".mcap": "copy it again; if its recording was cut off, `mcap recover FILE -o NEW` repairs it",
}
_FOLDER_CURE = "copy it again; if its recording was cut off, `ros2 bag reindex FOLDER` repairs it"
# Number of messages in memory at a time, and of the first ones whose joints may differ.
_CHUNK, _FIRST = 4096, 100
JOINT_STATE = "sensor_msgs/msg/JointState"
# Quantities for which a topic is read on until they have numbers.
_NEEDED = {"position", "effort"}
# For each quantity of a message: quantity in mappings, unit of turning joints, and default name.
QUANTITIES = {
    "position": ("position", "rad", "q"),
    "velocity": ("velocity", "rad/s", "qd"),
    "effort": ("torque", "N*m", "tau"),
}


@dataclass(frozen=True)
class Bag:
    """An open ROS bag.

    Attributes:
        path: path of the bag.
        topics: types of messages by topic.
        cdr: whether messages are in the encoding of ROS 2, else in that of ROS 1.
    """

    path: Path
    topics: dict[str, str]
    cdr: bool
    _reader: Any

    def messages(self, topics: list[str]) -> Iterator[list[tuple[str, int, bytes]]]:
        """All messages of some topics, in pieces: topic, time of receipt [ns], bytes.

        Raises:
            RecordingError: the bag is damaged.
        """
        with _reporting(self.path):
            wanted = [
                connection
                for connection in self._reader.connections
                if connection.topic in topics
                and connection.msgtype == self.topics[connection.topic]
            ]
            # Without connections, rosbags returns the messages of all topics.
            messages: Iterator[Any] = (
                self._reader.messages(connections=wanted) if wanted else iter(())
            )
            while chunk := [(c.topic, time, raw) for c, time, raw in islice(messages, _CHUNK)]:
                for topic, time, raw in chunk:  # a damaged SQLite file has values of any type
                    if not (
                        isinstance(time, int) and isinstance(raw, bytes) and abs(time) < 1 << 62
                    ):
                        raise ValueError(f"a message of {topic} is not one")
                if chunk[0][2].startswith(ZSTD):
                    chunk = [(topic, time, unzstd(raw, self.path)) for topic, time, raw in chunk]
                yield chunk


def is_bag(start: bytes, path: Path) -> bool:
    """Whether a file is a bag by its first bytes, or whether a folder holds one."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or bool(storage(path))
    return any(start.startswith(signature) for signature in _SUFFIXES)


@contextmanager
def opened_bag(path: Path) -> Generator[Bag, None, None]:
    """Open a bag for reading.

    Raises:
        RecordingError: the bag is damaged, or the library rosbags is not installed.
    """
    rosbag1, rosbag2 = (library(f"rosbags.rosbag{k}", "a ROS bag", path) for k in (1, 2))
    with ExitStack() as stack:
        place = _readable_bag(path, stack)
        with _reporting(path):
            cdr = place.suffix != ".bag"
            reader = stack.enter_context((rosbag2 if cdr else rosbag1).Reader(place))
            topics = {connection.topic: connection.msgtype for connection in reader.connections}
        yield Bag(path, topics, cdr, reader)


def _readable_bag(path: Path, stack: ExitStack) -> Path:
    """Path that rosbags reads: a folder with metadata, or an uncompressed file with the suffix of
    its kind."""
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        files = storage(path)
        if len(files) != 1:
            raise RecordingError(
                f"holds {len(files)} files of a bag, but no metadata.yaml that joins them",
                where=str(path),
                cure="copy the whole folder, or run `ros2 bag reindex FOLDER`",
            )
        path = files[0]
    if path.is_dir():
        return path
    with content(path) as unpacked:
        start = unpacked.peek(16)
        suffix = next((end for sign, end in _SUFFIXES.items() if start.startswith(sign)), "")
        if not suffix or (suffix == path.suffix and not packed_by(path)):
            return path
        place = Path(stack.enter_context(TemporaryDirectory()), f"bag{suffix}")
        with place.open("wb") as file:
            shutil.copyfileobj(unpacked, file, 1 << 20)
    return place


def storage(folder: Path) -> list[Path]:
    """Files of messages in a folder."""
    ends = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
    return sorted(path for path in folder.iterdir() if path.name.endswith(ends))


def _reporting(path: Path) -> AbstractContextManager[None]:
    """Convert any error of the libraries that read a bag to one message.

    On damaged bytes they raise assertion, lookup, type, struct, codec and memory errors, and those
    of their own dependencies, which change with versions. So all exceptions are caught, around
    calls of these libraries only.
    """
    cure = _CURES.get(path.suffix, _FOLDER_CURE)
    return damage(path, Exception, "cannot be read as a ROS bag", cure)


@dataclass(frozen=True)
class Topic:
    """A topic of joint states, described by its first messages.

    Attributes:
        name: name of the topic.
        type: type of its messages.
        joints: joints that have a number, by quantity.
        hollow: what quantities without numbers hold instead, by quantity.
        first: first header stamp that is not zero [ns]; 0 if all are zero.
        received: time of receipt of the first message [ns].
    """

    name: str
    type: str
    joints: dict[str, tuple[str, ...]]
    hollow: dict[str, str]
    first: int
    received: int

    @property
    def fields(self) -> list[RecordedField]:
        """Fields of the topic: one array per quantity, with one column per joint."""
        full = [
            RecordedField(f"{self.name}.{quantity}", (None, len(joints)), joints)
            for quantity, joints in self.joints.items()
        ]
        return full + [
            RecordedField(f"{self.name}.{key}", holds=why) for key, why in self.hollow.items()
        ]

    def __str__(self) -> str:
        joints = self.joints.get("position") or next(iter(self.joints.values()), ())
        return f"{self.name} ({listing([*map(RecordedField, joints)])})"


def topics_of(bag: Bag) -> list[Topic]:
    """Topics of joint states that have messages.

    Raises:
        RecordingError: no topic has messages of joint states, or the bag is damaged.
    """
    known = [name for name, kind in bag.topics.items() if kind in TYPES]
    topics = [topic for name in known if (topic := _topic(bag, name))]
    if not topics:
        raise RecordingError(
            "has no messages of sensor_msgs/JointState or control_msgs/DynamicJointState; its "
            f"topics are {listing([*map(RecordedField, bag.topics)])}"
            if bag.topics
            else "holds no topics",
            where=str(bag.path),
            cure="record the topic of the joint states as well, often /joint_states",
        )
    return topics


def _topic(bag: Bag, name: str) -> Topic | None:
    """A topic by its first messages, or by more as long as positions or torques have no numbers:
    drives that are switched on later have no torques before."""
    kind, before, first, received = bag.topics[name], 0, 0, None
    joints: dict[str, tuple[str, ...]] = {}
    hollow = dict.fromkeys(QUANTITIES, "empty lists") if kind == JOINT_STATE else {}
    for chunk in bag.messages([name]):
        raws = [raw for _, _, raw in chunk]
        try:
            stamps, _ = decoded(raws, (), kind, bag.cdr)
            shown = (*raws[:_FIRST], *{len(raw): raw for raw in raws}.values())
            layouts = (layout_of(raw, kind, bag.cdr) for raw in shown)
            numbers = list(dict.fromkeys(key for layout in layouts for key in layout.numbers))
            _, values = decoded(raws, numbers, kind, bag.cdr)
        except MessageError as error:
            raise damaged(bag, name, error, before) from None
        full = dict[str, tuple[str, ...]]()
        for (quantity, joint), column in zip(numbers, values.T, strict=True):
            if np.isfinite(column).any():
                full[quantity] = (*full.get(quantity, ()), joint)
            else:
                hollow[quantity] = "NaN only"
        joints = full | joints
        hollow = {quantity: why for quantity, why in hollow.items() if quantity not in joints}
        first = first or next(iter(stamps[stamps != 0].tolist()), 0)
        received = chunk[0][1] if received is None else received
        before += len(chunk)
        if not _NEEDED & hollow.keys():
            break
    return None if received is None else Topic(name, kind, joints, hollow, first, received)


def damaged(bag: Bag, topic: str, error: MessageError, before: int) -> RecordingError:
    """Error for a message that does not fit its type, after `before` others of the topic."""
    return RecordingError(
        f"message {before + error.index + 1} of {visible(topic)} {visible(str(error))}",
        where=str(bag.path),
        cure="the bag is damaged there, or was not written as ROS does; copy or record it again",
    )
