"""Which joints of a bag are which drives, and where a bag or a message is damaged."""

import random
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bags import (
    ALL,
    COLUMNS,
    JOINTS,
    KINDS,
    MESSAGES,
    NAMES,
    RNG,
    ROWS,
    TIME,
    State,
    address,
    read,
    refused,
    states,
)
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import RecordingError
from deltaid.recording.formats.ros_messages import MessageError, decoded
from deltaid.recording.formats.rosbag import BagTable
from deltaid.recording.mapping import load_mapping
from deltaid.recording.opening import open_log
from deltaid.recording.resolution import resolve_columns
from deltaid.recording.table import open_table


@pytest.mark.parametrize("kind", ["ros1", "mcap-lz4"])
@pytest.mark.parametrize("dynamic", [False, True])
def test_joints_are_found_by_name_whatever_their_order(
    kind: str, dynamic: bool, tmp_path: Path
) -> None:
    shuffle = random.Random(3)
    messages: list[State] = []
    for message in MESSAGES:
        order = shuffle.sample(range(3), 3)
        numbers = {key: np.asarray(value)[order] for key, value in message.numbers.items()}
        joints, frame = [JOINTS[k] for k in order], "base"[: shuffle.randrange(5)]
        messages.append(
            replace(message, joints=joints, numbers=numbers, frame=frame, dynamic=dynamic)
        )
    table = open_table(KINDS[kind](tmp_path, messages))
    assert np.array_equal(read(table, ["t", *NAMES]), ALL)


def test_an_interface_of_any_name_is_a_column(tmp_path: Path) -> None:
    """Such as a current, of which a torque constant makes a torque."""
    columns = {"position": COLUMNS["position"], "current": COLUMNS["effort"]}
    messages = states(TIME, columns, JOINTS, topic="/dynamic", dynamic=True)
    table = open_table(KINDS["db3"](tmp_path, messages))
    found = read(table, ["t", address("current", "joint_2", "/dynamic"), "q3"])
    assert np.array_equal(found, ALL[:, [0, 8, 3]])


NOT_NUMBERED = {
    "words": ["base", "elbow", "wrist"],
    "a gap": ["joint_1", "joint_2", "joint_4"],
    "one more": ["joint_1", "joint_2", "gripper"],
    "two families": ["a1", "b2", "a3"],
}


@pytest.mark.parametrize("joints", NOT_NUMBERED.values(), ids=NOT_NUMBERED)
def test_joints_without_a_clear_order_are_not_guessed(joints: list[str], tmp_path: Path) -> None:
    """The message has a mapping that can be pasted, with joints in the order of their names."""
    path = KINDS["mcap"](tmp_path, states(TIME, COLUMNS, joints[::-1]))
    with pytest.raises(RecordingError) as caught:
        resolve_columns(open_table(path), (False,) * 3)
    lines = str(caught.value).split("\n")
    (tmp_path / "columns.yaml").write_text("\n".join(line.strip() for line in lines[2:]))
    columns = load_mapping(tmp_path / "columns.yaml")
    table = open_table(path)
    found = [channel.column for channel in resolve_columns(table, (False,) * 3, columns).all]
    order = [joints[::-1].index(joint) for joint in sorted(joints)]
    expected = [part[:, order] for part in COLUMNS.values()]
    assert np.array_equal(read(table, found), np.column_stack([TIME, *expected]))


NUMBERED = {
    "from 0": ["axis0", "axis1", "axis2"],
    "two digits": [f"j{k}_motor" for k in range(1, 12)],
    "numbers alone": ["1", "2", "3"],
}


@pytest.mark.parametrize("joints", NUMBERED.values(), ids=NUMBERED)
def test_numbered_joints_are_drives(joints: list[str], tmp_path: Path) -> None:
    positions = RNG.normal(size=(ROWS, len(joints)))
    messages = states(TIME, {"position": positions[:, ::-1]}, joints[::-1])
    table = open_table(KINDS["mcap"](tmp_path, messages))
    names = [f"q{k + 1}" for k in range(len(joints))]
    assert np.array_equal(read(table, names), positions)


def test_several_topics_of_joints_are_listed(clavel: Dynamics, tmp_path: Path) -> None:
    """Unless the second one is the same as DynamicJointState, as ros2_control publishes both."""
    second = [replace(message, topic="/left/joint_states") for message in MESSAGES]
    path = KINDS["mcap"](tmp_path, MESSAGES + second)
    with pytest.raises(RecordingError) as caught:
        open_log(path, clavel.kinematics)
    both = "/joint_states (joint_1, joint_2, joint_3); /left/joint_states (joint_1"
    assert both in str(caught.value)
    assert "m/s and N); `deltaid columns" in str(caught.value)
    dynamic = [
        replace(message, topic="/dynamic_joint_states", dynamic=True) for message in MESSAGES
    ]
    (tmp_path / "both").mkdir()
    table = open_table(KINDS["mcap-lz4"](tmp_path / "both", MESSAGES + dynamic))
    assert isinstance(table, BagTable)
    assert table.names["q1"] == ("/joint_states", ("position", "joint_1"))


def _swapped(raw: bytes, at: int, new: bytes) -> bytes:
    return raw[:at] + new + raw[at + len(new) :]


BAD_MESSAGES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "cut": (lambda raw: raw[:60], "too short|middle"),
    "more": (lambda raw: raw + bytes(8), "8 bytes after its last field"),
    "not CDR": (lambda raw: b"{}" + raw, "not in CDR"),
    "endless list": (lambda raw: _swapped(raw, 20, b"\xff\xff\xff\x7f"), "too short"),
    "one name twice": (lambda raw: raw.replace(b"joint_2", b"joint_1"), "'joint_1' 2 times"),
    "fewer numbers": (lambda raw: _swapped(raw, 60, b"\2"), "3 joints but 2 numbers"),
    "empty": (lambda raw: b"", "not in CDR"),
}


@pytest.mark.parametrize(("change", "said"), BAD_MESSAGES.values(), ids=BAD_MESSAGES)
def test_a_damaged_message_is_reported(change: Callable[[bytes], bytes], said: str) -> None:
    raws = [message.raw() for message in MESSAGES[:9]]
    raws[7] = change(raws[7])
    with pytest.raises(MessageError, match=said) as caught:
        decoded(raws, [("position", "joint_1")], MESSAGES[0].type, cdr=True)
    assert caught.value.index == 7


def test_a_damaged_message_is_reported_with_its_place(tmp_path: Path) -> None:
    path = KINDS["sqlite-oldest"](tmp_path, MESSAGES)
    with sqlite3.connect(path) as base:
        base.execute("UPDATE messages SET data = x'00010000' WHERE id = 205")
    assert "message 205 of /joint_states ends in the middle" in refused(path, ["t", "q1"])
    with sqlite3.connect(path) as base:
        base.execute("UPDATE messages SET data = NULL WHERE id = 205")
    assert "a message of /joint_states is not one" in refused(path, ["t", "q1"])
