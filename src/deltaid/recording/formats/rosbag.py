"""Reads joint states of ROS 1 bags, ROS 2 bags in SQLite or MCAP, and MCAP files."""

import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deltaid.errors import Doubt, RecordingError
from deltaid.grouping import grouped
from deltaid.recording.address import Pick, RecordedField, listing
from deltaid.recording.formats.bag_reader import (
    JOINT_STATE,
    QUANTITIES,
    Topic,
    damaged,
    opened_bag,
    storage,
    topics_of,
)
from deltaid.recording.formats.ros_messages import MessageError, Number, decoded
from deltaid.recording.source import INCOMPLETE, LogTable, Rows, opened
from deltaid.recording.time.signals import Signal, merged

# Names of the columns of header stamps and of times of receipt.
_STAMPED, _RECEIVED = "t", "received"
_NUMBERED = re.compile(r"(?P<before>.*?)(?P<number>\d{1,4})(?P<after>\D*)")
# Consecutive messages of a topic: times [s] and wanted numbers.
_Piece = tuple[str, Signal]


def open_bag(path: Path) -> LogTable:
    """Open a bag: the first messages determine its topics of joint states.

    Raises:
        RecordingError: the bag is damaged, or holds no joint states.
    """
    with opened_bag(path) as bag:
        topics = topics_of(bag)
    names = default_columns(topics)
    taken = [joint for _, (quantity, joint) in names.values() if quantity == "position"]
    by_number = Doubt(
        f"joints {', '.join(taken)} are taken for drives 1 to {len(taken)}",
        cause="their names end in numbers, and no mapping says more",
        cure="if the order is another, name the joints in a mapping",
    )
    fields = [field for topic in topics for field in topic.fields]
    joints = listing([field for field in fields if field.labels])
    silent = f"let the driver publish it and record again, or map what holds it: {joints}"
    arrays = [replace(field, cure=silent) if field.holds else field for field in fields]
    hollow = [f"{t.name}.effort holds {t.hollow['effort']}" for t in topics if "effort" in t.hollow]
    of_joints = [topic for topic in topics if "position" in topic.joints]
    several = f" ({'; '.join(map(str, of_joints))})" if len(of_joints) > 1 else ""
    cure = (
        f"say with --columns MAPPING.yaml which joint is which drive{several}, in order of q "
        "(units of drives that slide are m, m/s and N)"
    )
    if lines := mapping_lines(topics):  # lines of one topic
        cure += f":\n    {lines}"
    return BagTable(
        path,
        (RecordedField(_STAMPED), *map(RecordedField, names), *arrays, RecordedField(_RECEIVED)),
        {topic.name: topic for topic in topics},
        names,
        warnings=(by_number,) if taken else (),
        cure_of_missing=cure,
        cure_without_torque=f"{'; '.join(hollow)}: no torques are recorded; let the driver publish "
        "them, or map what holds them with --columns MAPPING.yaml"
        if hollow
        else cure,
    )


@dataclass(frozen=True)
class BagTable(LogTable):
    """An open ROS bag.

    If one topic is used, a few thousand messages are in memory at a time. Several topics have
    different clocks, so their used columns are in memory as a whole.

    Attributes:
        topics: topics of joint states by name.
        names: topic and number of each default column, if names of joints are unambiguous.
    """

    topics: dict[str, Topic]
    names: dict[str, tuple[str, Number]]

    def checksum(self, columns: Sequence[str]) -> str:
        """SHA-256 of the file, or of the files of messages in a folder."""
        if not self.path.is_dir():
            return super().checksum(columns)
        digest = hashlib.sha256()
        for part in storage(self.path):
            with opened(part) as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
        return digest.hexdigest()

    def row_name(self, row: int) -> str:
        return f"sample {row}"

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """Read as in `LogTable.rows`; messages that lack a column are excluded and counted."""
        places = [self._place(pick) for pick in self.picks(columns)]
        wanted = grouped(place for place in places if isinstance(place, tuple))
        if not wanted:  # times of receipt alone are those of the first topic
            wanted = {next(iter(self.topics)): []}
        self.doubts.clear()
        received = _RECEIVED in places or not all(self.topics[name].first for name in wanted)
        if received and _RECEIVED not in places:
            self.doubts.append(
                Doubt(
                    "header stamps are all zero; the time of receipt is used in their place, which "
                    "has the jitter of the way to the recorder",
                    cause="the publisher does not set header.stamp",
                    cure="set it to the instant of measurement",
                )
            )
        pieces = self._pieces(wanted, received)
        parts = [self._merged(list(pieces), wanted)] if len(wanted) > 1 else (p for _, p in pieces)
        order = [(name, number) for name, numbers in wanted.items() for number in numbers]
        at = [order.index(place) if isinstance(place, tuple) else None for place in places]
        for part in parts:
            numbers = [part.time if k is None else part.values[:, k] for k in at]
            yield Rows(numbers, numbers)

    def _place(self, pick: Pick) -> tuple[str, Number] | str:
        name = pick.field.name
        if name in self.names:
            return self.names[name]
        if not pick.field.labels:
            return name
        topic, _, quantity = name.rpartition(".")
        return topic, (quantity, pick.field.labels[pick.at[1] or 0])

    def _pieces(self, wanted: dict[str, list[Number]], received: bool) -> Iterator[_Piece]:
        used = [self.topics[name] for name in wanted]
        start = min(topic.received if received else topic.first for topic in used)
        total, lost = dict.fromkeys(wanted, 0), dict.fromkeys(wanted, 0)
        lacks = {name: np.zeros(len(numbers), dtype=bool) for name, numbers in wanted.items()}
        first = dict[str, int]()
        with opened_bag(self.path) as bag:
            for chunk in bag.messages(list(wanted)):
                for name, numbers in wanted.items():
                    messages = [(time, raw) for topic, time, raw in chunk if topic == name]
                    raws = [raw for _, raw in messages]
                    try:
                        stamps, values = decoded(raws, numbers, self.topics[name].type, bag.cdr)
                    except MessageError as error:
                        raise damaged(bag, name, error, total[name]) from None
                    if received:
                        stamps = np.array([time for time, _ in messages], dtype=np.int64)
                    absent = np.isnan(values)
                    whole = ~absent.any(axis=1)
                    lacks[name] |= absent.any(axis=0)
                    if not whole.all():
                        first.setdefault(name, total[name] + int(np.argmin(whole)) + 1)
                    total[name] += len(values)
                    lost[name] += int((~whole).sum())
                    if whole.any():
                        yield name, Signal((stamps[whole] - start) / 1e9, values[whole])
        for name in wanted:
            if lost[name] == total[name]:
                raise RecordingError(
                    f"no message of {name} has a number in each of the columns in use",
                    where=str(self.path),
                    cure="map joints and quantities that come in the same message",
                )
            if lost[name]:
                numbers = [wanted[name][k] for k in np.flatnonzero(lacks[name])]
                self.doubts.append(_incomplete(name, lost[name], total[name], first[name], numbers))

    def _merged(self, pieces: list[_Piece], wanted: dict[str, list[Number]]) -> Signal:
        names = list(wanted)
        parts = [[part for topic, part in pieces if topic == name] for name in names]
        signal, same = merged([f"topic {name}" for name in names], parts, str(self.path))
        if not all(same):
            onto = names[same.index(True)]
            others = [name for name, is_same in zip(names, same, strict=True) if not is_same]
            self.doubts.append(
                Doubt(
                    f"{', '.join(others)} is interpolated to the instants of {onto}, because their "
                    "stamps differ",
                    cause="they are published by different nodes or in different cycles",
                    cure="publish positions and torques in one message to keep them in step",
                )
            )
        return signal


def _incomplete(topic: str, lost: int, total: int, first: int, lacks: Sequence[Number]) -> Doubt:
    joints_of = grouped(lacks)
    absent = [f"{quantity} of {', '.join(joints)}" for quantity, joints in joints_of.items()]
    return Doubt(
        f"{lost} of {total} messages of {topic} have no {', no '.join(absent)}, the first is "
        f"message {first}; they are excluded",
        cause="a second node publishes there, or the driver does not fill in all of each message",
        cure="no action is needed for a second node, unless it is the wrong topic",
        key=INCOMPLETE,
    )


def default_columns(topics: Sequence[Topic]) -> dict[str, tuple[str, Number]]:
    """Topic and number of each default column; empty unless names of joints determine the drives.

    They do if one topic has positions of joints whose names differ only in a number, from 1 or 0
    without a gap.
    """
    topic = _main_topic(topics)
    joints = in_order(topic.joints["position"]) if topic else None
    if not joints:
        return {}
    return {
        f"{short}{i + 1}": (source.name, (quantity, joint))
        for quantity, (_, _, short) in QUANTITIES.items()
        if (source := _source(topics, quantity, joints))
        for i, joint in enumerate(joints)
    }


def in_order(joints: Sequence[str]) -> list[str] | None:
    """Joints in order of their numbers; None if these are not consecutive."""
    ordered = _by_number(joints)
    matches = [match for joint in ordered if (match := _NUMBERED.fullmatch(joint))]
    numbers = [int(match["number"]) for match in matches]
    same_name = len({(match["before"], match["after"]) for match in matches}) == 1
    through = numbers in (list(range(k, k + len(ordered))) for k in (0, 1))
    return ordered if same_name and through else None


def mapping_lines(topics: Sequence[Topic]) -> str:
    """Lines of a mapping with all joints of the topic of positions, for the user to reorder."""
    topic = _main_topic(topics) or next(
        (topic for topic in topics if "position" in topic.joints), topics[0]
    )
    joints = _by_number(topic.joints.get("position") or next(iter(topic.joints.values()), ()))
    lines: list[str] = []
    for quantity, (key, unit, _) in QUANTITIES.items():
        if source := _source(topics, quantity, joints):
            columns = [json.dumps(f"{source.name}.{quantity}[{joint}]") for joint in joints]
            lines.append(f"{key}: {{columns: [{', '.join(columns)}], unit: {unit}}}")
    return "\n    ".join(lines)


def _source(topics: Sequence[Topic], quantity: str, joints: Sequence[str]) -> Topic | None:
    """Topic with a quantity of these joints: that of their positions, or the only one."""
    able = [topic for topic in topics if set(joints) <= set(topic.joints.get(quantity, ()))]
    plain = [topic for topic in able if topic.type == JOINT_STATE]
    main = [topic for topic in able if topic is _main_topic(topics)]
    return next((sources[0] for sources in (main, plain, able) if len(sources) == 1), None)


def _main_topic(topics: Sequence[Topic]) -> Topic | None:
    of_joints = [topic for topic in topics if "position" in topic.joints]
    sources = [topic for topic in of_joints if topic.type == JOINT_STATE] or of_joints
    return sources[0] if len(sources) == 1 else None


def _by_number(joints: Sequence[str]) -> list[str]:
    def key(joint: str) -> list[tuple[bool, int, str]]:
        parts = re.findall(r"\d+|\D+", joint)
        return [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]

    return sorted(joints, key=key)
