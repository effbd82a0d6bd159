"""Bags of ROS: the same samples from every kind, by name of joint, on the clock of the headers."""

import random
import shutil
import sqlite3
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bags import KINDS, State, states
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import RecordingError
from deltaid.recording.formats.ros_messages import Decoder, MessageError
from deltaid.recording.formats.rosbag import BagTable
from deltaid.recording.mapping import load_mapping
from deltaid.recording.opening import open_log
from deltaid.recording.resolution import resolve_columns
from deltaid.recording.source import Table
from deltaid.recording.table import open_table

JOINTS = ["joint_1", "joint_2", "joint_3"]
ROWS = 500
TIME = np.arange(ROWS) / 1000
RNG = np.random.default_rng(5)
COLUMNS = {key: RNG.normal(size=(ROWS, 3)) for key in ("position", "velocity", "effort")}
MESSAGES = states(TIME, COLUMNS, JOINTS)
NAMES = [f"{short}{i + 1}" for short in ("q", "qd", "tau") for i in range(3)]
ALL = np.hstack([TIME[:, None], *COLUMNS.values()])


def read(table: Table, columns: list[str]) -> np.ndarray:
    return np.vstack([np.column_stack(rows.numbers) for rows in table.rows(columns)])


def address(quantity: str, joint: str, topic: str = "/joint_states") -> str:
    return f"{topic}.{quantity}[{joint}]"


def told(path: Path) -> str:
    """What is said of a bag that cannot be read; nothing if it can."""
    try:
        read(open_table(path), ["t", *NAMES])
    except RecordingError as error:
        return str(error)
    return ""


def refused(path: Path, columns: list[str]) -> str:
    with pytest.raises(RecordingError) as caught:
        read(open_table(path), columns)
    return str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_gives_the_same_samples(kind: str, tmp_path: Path) -> None:
    """And by the default names, since those of the joints leave no doubt."""
    other = [replace(one, topic="/other", at=one.stamp + 7) for one in MESSAGES[::50]]
    messages = sorted(MESSAGES + other, key=lambda one: one.received)
    table = open_table(KINDS[kind](tmp_path, messages if "ros1" not in kind else MESSAGES))
    topics = [address("position", joint) for joint in JOINTS]
    assert np.array_equal(read(table, ["t", *topics]), ALL[:, :4])
    assert not table.doubts
    if "ros1" in kind:
        assert np.array_equal(read(table, ["t", *NAMES]), ALL)
        assert "joint_1, joint_2, joint_3 are taken for drives 1 to 3" in table.warnings[0]


@pytest.mark.parametrize("kind", ["ros1", "mcap-lz4"])
@pytest.mark.parametrize("dynamic", [False, True])
def test_joints_are_found_by_name_whatever_their_order(
    kind: str, dynamic: bool, tmp_path: Path
) -> None:
    shuffle = random.Random(3)
    messages: list[State] = []
    for one in MESSAGES:
        order = shuffle.sample(range(3), 3)
        numbers = {key: np.asarray(value)[order] for key, value in one.numbers.items()}
        joints, frame = [JOINTS[k] for k in order], "base"[: shuffle.randrange(5)]
        messages.append(replace(one, joints=joints, numbers=numbers, frame=frame, dynamic=dynamic))
    table = open_table(KINDS[kind](tmp_path, messages))
    assert np.array_equal(read(table, ["t", *NAMES]), ALL)


def test_an_interface_of_any_name_is_a_column(tmp_path: Path) -> None:
    """Such as a current, of which a torque constant makes a torque."""
    columns = {"position": COLUMNS["position"], "current": COLUMNS["effort"]}
    messages = states(TIME, columns, JOINTS, topic="/dynamic", dynamic=True)
    table = open_table(KINDS["db3"](tmp_path, messages))
    found = read(table, ["t", address("current", "joint_2", "/dynamic"), "q3"])
    assert np.array_equal(found, ALL[:, [0, 8, 3]])


def test_both_orders_of_bytes_and_any_padding_are_read() -> None:
    one = replace(MESSAGES[3], frame="ab", joints=["a", "bcde", "f"])
    wanted = [("effort", "f"), ("position", "a"), ("effort", "none")]
    expected = [COLUMNS["effort"][3, 2], COLUMNS["position"][3, 0], np.nan]
    little, big = one.raw(), one.raw(little=False)
    padded = bytearray(little)
    padded[19] = padded[31] = padded[41] = 0xAB  # behind the frame's and joints' names
    assert padded != little
    stamps, values = Decoder(one.type, True).decode([little, big, bytes(padded)], wanted)
    assert stamps.tolist() == [one.stamp] * 3
    assert np.array_equal(values, [expected] * 3, equal_nan=True)


def test_messages_of_more_kinds_than_are_kept_are_decoded() -> None:
    many = [replace(MESSAGES[k], joints=[f"{k:03}", "b", "c"]) for k in range(200)]
    decoder = Decoder(many[0].type, True)
    _, values = decoder.decode([one.raw() for one in many], [("position", "b"), ("effort", "199")])
    assert np.array_equal(values[:, 0], COLUMNS["position"][:200, 1])
    assert values[199, 1] == COLUMNS["effort"][199, 0]


def test_a_message_without_a_joint_is_a_lost_row(tmp_path: Path) -> None:
    messages = list(MESSAGES)
    for k in (0, 7, 499):
        short = {key: np.asarray(value)[:2] for key, value in MESSAGES[k].numbers.items()}
        messages[k] = replace(MESSAGES[k], joints=JOINTS[:2], numbers=short)
    table = open_table(KINDS["mcap"](tmp_path, messages))
    kept = np.delete(ALL, [0, 7, 499], axis=0)
    assert np.array_equal(read(table, ["t", *NAMES]), kept)
    assert "3 of 500 messages of /joint_states do not have a number" in table.doubts[0]
    assert np.array_equal(read(table, ["t", "q1", "q2"]), ALL[:, :3])
    assert not table.doubts


def test_a_second_publisher_without_torques_is_left_out(tmp_path: Path) -> None:
    """As joint_state_publisher does: zeros for positions, and nothing else."""
    second = [
        replace(one, numbers={"position": np.zeros(3)}, joints=JOINTS[::-1], at=one.stamp + 5)
        for one in MESSAGES
    ]
    messages = [one for pair in zip(MESSAGES, second, strict=True) for one in pair]
    table = open_table(KINDS["sqlite"](tmp_path, messages))
    assert np.array_equal(read(table, ["t", *NAMES]), ALL)
    assert "500 of 1000" in table.doubts[0]


@pytest.mark.parametrize("holds", ["empty lists", "NaN only"])
def test_torques_that_are_not_recorded_are_said(
    holds: str, clavel: Dynamics, tmp_path: Path
) -> None:
    effort = np.full((ROWS, 3), np.nan) if holds == "NaN only" else np.zeros((ROWS, 0))
    messages = states(TIME, COLUMNS | {"effort": effort}, JOINTS)
    path = KINDS["mcap"](tmp_path, messages)
    with pytest.raises(RecordingError, match=f"effort holds {holds}: no torques are recorded"):
        open_log(path, clavel.kinematics)
    assert f"/joint_states.effort holds {holds}" in refused(path, ["t", address("effort", "a")])


def test_headers_without_stamps_leave_the_time_of_receipt(tmp_path: Path) -> None:
    messages = [replace(one, stamp=0, at=one.stamp) for one in MESSAGES]
    table = open_table(KINDS["ros1"](tmp_path, messages))
    assert np.array_equal(read(table, ["t", "q1"]), ALL[:, :2])
    assert "header stamps are all zero; the time of receipt is used" in table.doubts[0]


def test_the_time_of_receipt_may_be_asked_for(tmp_path: Path) -> None:
    messages = [replace(one, at=one.stamp + 10**6 * (k % 3)) for k, one in enumerate(MESSAGES)]
    table = open_table(KINDS["ros1"](tmp_path, messages))
    late = TIME + np.arange(ROWS) % 3 / 1000
    assert read(table, ["received", "q1"])[:, 0] == pytest.approx(np.sort(late), abs=1e-12)
    assert np.array_equal(np.sort(read(table, ["t", "q1"])[:, 0]), TIME)


def test_topics_with_clocks_of_their_own_are_brought_together(tmp_path: Path) -> None:
    """Torques at 400 Hz, a little later: they are interpolated to the instants of positions."""
    time, slow = np.arange(800) / 1000, 0.0007 + np.arange(320) / 400
    wave = lambda t: np.column_stack([np.sin(9 * t + k) for k in range(3)])  # noqa: E731
    messages = states(time, {"position": wave(time)}, JOINTS) + states(
        slow, {"effort": wave(slow)}, JOINTS[::-1], topic="/torques"
    )
    messages.sort(key=lambda one: one.received)
    table = open_table(KINDS["mcap-lz4"](tmp_path, messages))
    columns = [address("effort", joint, "/torques") for joint in JOINTS[::-1]]
    found = read(table, ["t", "q1", *columns])
    assert np.isin(found[:, 0], time).all()
    assert len(found) > 790
    assert np.array_equal(found[:, 1], np.sin(9 * found[:, 0]))
    assert found[:, 2:] == pytest.approx(wave(found[:, 0]), abs=1e-6)
    assert "/torques is interpolated to the instants of /joint_states" in table.doubts[0]


def test_topics_that_share_their_stamps_stay_as_they_are(tmp_path: Path) -> None:
    torques = states(TIME, {"effort": COLUMNS["effort"]}, JOINTS, topic="/torques")
    positions = states(TIME, {"position": COLUMNS["position"]}, JOINTS)
    messages = [one for pair in zip(positions, torques, strict=True) for one in pair]
    table = open_table(KINDS["sqlite"](tmp_path, messages))
    columns = [address("effort", joint, "/torques") for joint in JOINTS]
    assert np.array_equal(read(table, ["t", *columns, "q1"]), ALL[:, [0, 7, 8, 9, 1]])
    assert not table.doubts
    assert np.array_equal(read(table, ["t", "tau3"]), ALL[:, [0, 9]])


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
    second = [replace(one, topic="/left/joint_states") for one in MESSAGES]
    path = KINDS["mcap"](tmp_path, MESSAGES + second)
    with pytest.raises(RecordingError) as caught:
        open_log(path, clavel.kinematics)
    both = "/joint_states (joint_1, joint_2, joint_3); /left/joint_states (joint_1"
    assert both in str(caught.value)
    dynamic = [replace(one, topic="/dynamic_joint_states", dynamic=True) for one in MESSAGES]
    (tmp_path / "both").mkdir()
    table = open_table(KINDS["mcap-lz4"](tmp_path / "both", MESSAGES + dynamic))
    assert isinstance(table, BagTable)
    assert table.names["q1"] == ("/joint_states", ("position", "joint_1"))


def test_a_bag_is_identified_as_any_recording(clavel: Dynamics, tmp_path: Path) -> None:
    """Its numbers are those of joints in SI units, and drives may lie in any order."""
    t = np.arange(2000) / 1000
    q = 0.3 + 0.2 * np.sin(7 * t[:, None] + np.arange(3))
    qd = 1.4 * np.cos(7 * t[:, None] + np.arange(3))
    tau = np.sin(20 * t[:, None] + np.arange(3))
    path = KINDS["sqlite"](
        tmp_path, states(t, {"position": q, "velocity": qd, "effort": tau}, JOINTS)
    )
    log = open_log(path, clavel.kinematics)
    assert (log.samples, log.rate) == (2000, pytest.approx(1000))
    batch = next(log.batches())
    assert np.array_equal(batch.values[:, :10], np.column_stack([t, q, qd, tau]))
    assert any("are taken for drives 1 to 3" in warning for warning in log.warnings)
    copy = shutil.copytree(path, tmp_path / "copy")
    assert open_log(copy, clavel.kinematics).sha256 == log.sha256


def test_folders(tmp_path: Path) -> None:
    folder = KINDS["sqlite"](tmp_path, MESSAGES)
    (folder / "metadata.yaml").unlink()
    assert np.array_equal(read(open_table(folder), ["t", *NAMES]), ALL)
    shutil.copy(next(folder.glob("*.db3")), folder / "second.db3")
    said = refused(folder, ["t"])
    assert "2 files" in said
    assert "ros2 bag reindex" in said
    (tmp_path / "empty").mkdir()
    assert "is a folder, not a log" in refused(tmp_path / "empty", ["t"])


def test_a_bag_without_joint_states(tmp_path: Path) -> None:
    """Its topics are listed."""
    path = KINDS["sqlite-oldest"](tmp_path, [])
    assert "holds no topics" in refused(path, ["t"])
    with sqlite3.connect(path) as base:
        base.execute("INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr')")
        base.execute("INSERT INTO topics VALUES (2, '/js', 'sensor_msgs/msg/JointState', 'cdr')")
    said = refused(path, ["t"])
    assert "has no messages of sensor_msgs/JointState" in said
    assert "/imu, /js" in said


def test_the_library_may_be_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = KINDS["mcap"](tmp_path, MESSAGES[:5])
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    assert "pip install 'deltaid[formats]'" in refused(path, ["t"])


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
def test_a_damaged_message_is_told(change: Callable[[bytes], bytes], said: str) -> None:
    raws = [one.raw() for one in MESSAGES[:9]]
    raws[7] = change(raws[7])
    with pytest.raises(MessageError, match=said) as caught:
        Decoder(MESSAGES[0].type, True).decode(raws, [("position", "joint_1")])
    assert caught.value.index == 7


def test_a_damaged_message_is_told_with_its_place(tmp_path: Path) -> None:
    path = KINDS["sqlite-oldest"](tmp_path, MESSAGES)
    with sqlite3.connect(path) as base:
        base.execute("UPDATE messages SET data = x'00010000' WHERE id = 205")
    assert "message 205 of /joint_states ends in the middle" in refused(path, ["t", "q1"])
    with sqlite3.connect(path) as base:
        base.execute("UPDATE messages SET data = NULL WHERE id = 205")
    assert "a message of /joint_states is not one" in refused(path, ["t", "q1"])


@pytest.mark.parametrize("kind", ["ros1", "ros1-lz4", "sqlite", "db3-zstd", "mcap-lz4", "mcap"])
def test_damaged_bags_get_one_message(kind: str, tmp_path: Path) -> None:
    """With the file's name; or damage is in bytes that do not matter, or in a number."""
    good = KINDS[kind](tmp_path, MESSAGES[:60])
    file = next(good.glob("*.db3")) if good.is_dir() else good
    whole, rng = file.read_bytes(), random.Random(kind)
    count = 0
    for _ in range(25):
        spoiled = bytearray(whole)
        for _ in range(rng.choice((1, 3, 30))):
            spoiled[rng.randrange(len(whole))] = rng.randrange(256)
        file.write_bytes(spoiled[: rng.choice((len(whole), rng.randrange(len(whole))))])
        said = told(good)
        count += bool(said)
        assert not said or (str(good) in said and "→" in said)
    assert count > 5
