"""Topics of a bag that tell states of joints: what they hold, and which joint is which drive."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.errors import RecordingError, visible
from deltaid.recording.address import RecordedField
from deltaid.recording.formats.bag_reader import Bag
from deltaid.recording.formats.ros_messages import TYPES, Decoder, MessageError, Number

# Messages of a topic that show what it holds.
_FIRST = 100
_JOINT_STATE = "sensor_msgs/msg/JointState"
# What a mapping calls the quantities, their units for turning joints, and their default names.
_QUANTITIES = {
    "position": ("position", "rad", "q"),
    "velocity": ("velocity", "rad/s", "qd"),
    "effort": ("torque", "N*m", "tau"),
}
_NUMBERED = re.compile(r"(?P<before>.*?)(?P<number>\d{1,4})(?P<after>\D*)")


@dataclass(frozen=True)
class Topic:
    """A topic of joint states, as its first messages show it.

    Attributes:
        joints: those that have a number, for each quantity.
        hollow: quantities that have none, and what they hold.
        stamped: whether headers have stamps; else all of them are zero.
        first: the first stamp, and
        received: when the first message was received [ns].
    """

    name: str
    type: str
    joints: dict[str, tuple[str, ...]]
    hollow: dict[str, str]
    stamped: bool
    first: int
    received: int

    @property
    def fields(self) -> list[RecordedField]:
        """One array a quantity, one column a joint."""
        full = [
            RecordedField(f"{self.name}.{quantity}", (None, len(joints)), joints)
            for quantity, joints in self.joints.items()
        ]
        return full + [
            RecordedField(f"{self.name}.{key}", holds=why) for key, why in self.hollow.items()
        ]

    def __str__(self) -> str:
        joints = self.joints.get("position") or next(iter(self.joints.values()), ())
        return f"{self.name} ({_some(joints)})"


def topics_of(bag: Bag) -> list[Topic]:
    """The topics of joint states that have messages.

    Raises:
        RecordingError: there are none, or the bag is damaged.
    """
    known = [name for name, kind in bag.topics.items() if kind in TYPES]
    topics = [topic for name in known if (topic := _topic(bag, name))]
    if not topics:
        raise RecordingError(
            "has no messages of sensor_msgs/JointState or control_msgs/DynamicJointState; its "
            f"topics are {_some(list(bag.topics))}"
            if bag.topics
            else "holds no topics",
            where=str(bag.path),
            cure="record the topic of the joint states as well, often /joint_states",
        )
    return topics


def default_columns(topics: Sequence[Topic]) -> dict[str, tuple[str, Number]]:
    """Default names of columns, where names of joints leave no doubt which drive is which.

    That is where one topic tells positions of joints whose names differ by a number only, counted
    from 1 or 0 without a gap.
    """
    topic = _main(topics)
    joints = in_order(topic.joints["position"]) if topic else None
    if not joints:
        return {}
    return {
        f"{short}{i + 1}": (teller.name, (quantity, joint))
        for quantity, (_, _, short) in _QUANTITIES.items()
        if (teller := _teller(topics, quantity, joints))
        for i, joint in enumerate(joints)
    }


def in_order(joints: Sequence[str]) -> list[str] | None:
    """Joints by their number; None if they are not numbered through."""
    matches = [_NUMBERED.fullmatch(joint) for joint in joints]
    found = {int(m["number"]): m for m in matches if m}
    around = {(m["before"], m["after"]) for m in found.values()}
    if len(found) < len(joints) or len(around) != 1:
        return None
    numbers = sorted(found)
    through = numbers[0] in (0, 1) and numbers[-1] - numbers[0] == len(numbers) - 1
    return [found[number].string for number in numbers] if through else None


def mapping_lines(topics: Sequence[Topic]) -> str:
    """A mapping with all joints of the topic of positions, to be put into the order of q."""
    topic = _main(topics) or next(
        (topic for topic in topics if "position" in topic.joints), topics[0]
    )
    joints = _by_number(topic.joints.get("position") or next(iter(topic.joints.values()), ()))
    lines: list[str] = []
    for quantity, (key, unit, _) in _QUANTITIES.items():
        if teller := _teller(topics, quantity, joints):
            columns = [json.dumps(f"{teller.name}.{quantity}[{joint}]") for joint in joints]
            lines.append(f"{key}: {{columns: [{', '.join(columns)}], unit: {unit}}}")
    return "\n    ".join(lines)


def _teller(topics: Sequence[Topic], quantity: str, joints: Sequence[str]) -> Topic | None:
    """The topic that tells a quantity of these joints: that of their positions, or the only one."""
    able = [topic for topic in topics if set(joints) <= set(topic.joints.get(quantity, ()))]
    plain = [topic for topic in able if topic.type == _JOINT_STATE]
    main = [topic for topic in able if topic is _main(topics)]
    return next((tellers[0] for tellers in (main, plain, able) if len(tellers) == 1), None)


def _main(topics: Sequence[Topic]) -> Topic | None:
    told = [topic for topic in topics if "position" in topic.joints]
    plain = [topic for topic in told if topic.type == _JOINT_STATE]
    tellers = plain or told
    return tellers[0] if len(tellers) == 1 else None


def _topic(bag: Bag, name: str) -> Topic | None:
    chunk = next(bag.messages([name]), [])[:_FIRST]
    if not chunk:
        return None
    decoder, raws = Decoder(bag.topics[name], bag.cdr), [raw for _, _, raw in chunk]
    try:
        numbers = list(dict.fromkeys(key for raw in raws for key in decoder.layout(raw).numbers))
        stamps, values = decoder.decode(raws, numbers)
    except MessageError as error:
        raise damaged(bag, name, error, 0) from None
    joints: dict[str, tuple[str, ...]] = {}
    hollow = dict.fromkeys(_QUANTITIES, "empty lists") if decoder.type == _JOINT_STATE else {}
    for (quantity, joint), column in zip(numbers, values.T, strict=True):
        if np.isfinite(column).any():
            joints[quantity] = (*joints.get(quantity, ()), joint)
        else:
            hollow[quantity] = "NaN only"
    hollow = {quantity: why for quantity, why in hollow.items() if quantity not in joints}
    first = int(np.flatnonzero(stamps)[0]) if stamps.any() else 0
    return Topic(
        name, decoder.type, joints, hollow, bool(stamps.any()), int(stamps[first]), chunk[0][1]
    )


def damaged(bag: Bag, topic: str, error: MessageError, before: int) -> RecordingError:
    """A message is not what its type says; so many of the topic were read before."""
    return RecordingError(
        f"message {before + error.index + 1} of {visible(topic)} {visible(error.what)}",
        where=str(bag.path),
        cure="the bag is damaged there, or was not written as ROS does; copy or record it again",
    )


def _by_number(joints: Sequence[str]) -> list[str]:
    def key(joint: str) -> list[tuple[bool, int, str]]:
        parts = re.findall(r"\d+|\D+", joint)
        return [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]

    return sorted(joints, key=key)


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    shown = [name if len(name) <= 60 else f"{name[:57]}…" for name in names[:20]]
    return visible(", ".join(shown)) + more
