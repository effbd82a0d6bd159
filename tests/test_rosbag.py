"""Bags of ROS: every kind gives the same samples, whatever its clocks and publishers."""

import shutil
import sqlite3
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
    ROWS,
    TIME,
    address,
    read,
    refused,
    states,
)
from deltaid.checks.evidence import evidence
from deltaid.checks.signal import checked_signals
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import RecordingError
from deltaid.recording.formats.bag_reader import _CHUNK
from deltaid.recording.formats.ros_messages import decoded
from deltaid.recording.opening import open_log
from deltaid.recording.table import open_table
from deltaid.robot.load import load_robot
from test_lag import frame


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_gives_the_same_samples(kind: str, tmp_path: Path) -> None:
    """And by the default names, since those of the joints leave no doubt."""
    other = [replace(message, topic="/other", at=message.stamp + 7) for message in MESSAGES[::50]]
    messages = sorted(MESSAGES + other, key=lambda message: message.received)
    table = open_table(KINDS[kind](tmp_path, messages if "ros1" not in kind else MESSAGES))
    topics = [address("position", joint) for joint in JOINTS]
    assert np.array_equal(read(table, ["t", *topics]), ALL[:, :4])
    assert not table.doubts
    if "ros1" in kind:
        assert np.array_equal(read(table, ["t", *NAMES]), ALL)
        assert "joint_1, joint_2, joint_3 are taken for drives 1 to 3" in table.warnings[0]


def test_both_orders_of_bytes_and_any_padding_are_read() -> None:
    message = replace(MESSAGES[3], frame="ab", joints=["a", "bcde", "f"])
    wanted = [("effort", "f"), ("position", "a"), ("effort", "none")]
    expected = [COLUMNS["effort"][3, 2], COLUMNS["position"][3, 0], np.nan]
    little, big = message.raw(), message.raw(little=False)
    padded = bytearray(little)
    padded[19] = padded[31] = padded[41] = 0xAB  # behind the frame's and joints' names
    assert padded != little
    stamps, values = decoded([little, big, bytes(padded)], wanted, message.type, cdr=True)
    assert stamps.tolist() == [message.stamp] * 3
    assert np.array_equal(values, [expected] * 3, equal_nan=True)


def test_messages_of_many_kinds_are_decoded() -> None:
    many = [replace(MESSAGES[k], joints=[f"{k:03}", "b", "c"]) for k in range(200)]
    raws, wanted = [message.raw() for message in many], [("position", "b"), ("effort", "199")]
    _, values = decoded(raws, wanted, many[0].type, cdr=True)
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
    lacks = "no position of joint_3, no velocity of joint_3, no effort of joint_3"
    said = f"3 of 500 messages of /joint_states have {lacks}, the first is message 1"
    assert said in table.doubts[0]
    assert np.array_equal(read(table, ["t", "q1", "q2"]), ALL[:, :3])
    assert not table.doubts


def test_messages_without_torques_are_no_logger_that_falls_behind(tmp_path: Path) -> None:
    table = frame(np.zeros(3))
    columns = {
        key: table.select(f"{short}{k}" for k in (1, 2, 3)).to_numpy()
        for key, short in (("position", "q"), ("effort", "tau"))
    }
    messages = states(table["t"].to_numpy(), columns, JOINTS)
    for k in (7, 60, 61, 300):
        del messages[k].numbers["effort"]
    found = evidence(load_robot("clavel-delta3"), KINDS["mcap"](tmp_path, messages))
    (verdict,) = (verdict for verdict in checked_signals(found) if verdict.key == "clock")
    assert verdict.seen == "4 rows are missing in 3 places"
    assert verdict.cause == "rows that lack a number in a used column are excluded (see warnings)"
    assert found.surveyed is not None
    lacks = "have no effort of joint_1, joint_2, joint_3, the first is message 8; they are excluded"
    assert any(lacks in warning for warning in found.surveyed.log.warnings)


def test_a_second_publisher_without_torques_is_excluded(tmp_path: Path) -> None:
    """As joint_state_publisher does: zeros for positions, and nothing else."""
    second = [
        replace(
            message, numbers={"position": np.zeros(3)}, joints=JOINTS[::-1], at=message.stamp + 5
        )
        for message in MESSAGES
    ]
    messages = [message for pair in zip(MESSAGES, second, strict=True) for message in pair]
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


@pytest.mark.parametrize("holds", ["empty lists", "NaN only"])
def test_torques_of_drives_that_are_switched_on_later_are_read(holds: str, tmp_path: Path) -> None:
    """Neither the first hundred messages nor the first in memory have any."""
    count = _CHUNK + 400
    time, q = np.arange(count) / 1000, np.sin(np.arange(count) / 100)
    empty = np.full(count, np.nan)[:, None] if holds == "NaN only" else np.zeros((count, 0))
    before, after = (
        states(time, {"position": q[:, None], "effort": effort}, ["a"])
        for effort in (empty, q[:, None])
    )
    table = open_table(KINDS["mcap"](tmp_path, [*before[: _CHUNK + 100], *after[_CHUNK + 100 :]]))
    values = read(table, [address("effort", "a")])
    assert np.array_equal(values[:, 0], q[_CHUNK + 100 :])


def test_headers_without_stamps_leave_the_time_of_receipt(tmp_path: Path) -> None:
    messages = [replace(message, stamp=0, at=message.stamp) for message in MESSAGES]
    table = open_table(KINDS["ros1"](tmp_path, messages))
    assert np.array_equal(read(table, ["t", "q1"]), ALL[:, :2])
    assert "header stamps are all zero; the time of receipt is used" in table.doubts[0]


def test_the_time_of_receipt_may_be_asked_for(tmp_path: Path) -> None:
    messages = [
        replace(message, at=message.stamp + 10**6 * (k % 3)) for k, message in enumerate(MESSAGES)
    ]
    table = open_table(KINDS["ros1"](tmp_path, messages))
    late = TIME + np.arange(ROWS) % 3 / 1000
    assert read(table, ["received", "q1"])[:, 0] == pytest.approx(np.sort(late), abs=1e-12)
    assert read(table, ["received"])[:, 0] == pytest.approx(np.sort(late), abs=1e-12)
    assert np.array_equal(np.sort(read(table, ["t", "q1"])[:, 0]), TIME)


def test_topics_with_clocks_of_their_own_are_brought_together(tmp_path: Path) -> None:
    """Torques at 400 Hz, a little later: they are interpolated to the instants of positions."""
    time, slow = np.arange(800) / 1000, 0.0007 + np.arange(320) / 400
    wave = lambda t: np.column_stack([np.sin(9 * t + k) for k in range(3)])  # noqa: E731
    messages = states(time, {"position": wave(time)}, JOINTS) + states(
        slow, {"effort": wave(slow)}, JOINTS[::-1], topic="/torques"
    )
    messages.sort(key=lambda message: message.received)
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
    messages = [message for pair in zip(positions, torques, strict=True) for message in pair]
    table = open_table(KINDS["sqlite"](tmp_path, messages))
    columns = [address("effort", joint, "/torques") for joint in JOINTS]
    assert np.array_equal(read(table, ["t", *columns, "q1"]), ALL[:, [0, 7, 8, 9, 1]])
    assert not table.doubts
    assert np.array_equal(read(table, ["t", "tau3"]), ALL[:, [0, 9]])


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
    assert np.array_equal(batch[:, :10], np.column_stack([t, q, qd, tau]))
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
    assert "is a folder, not a file" in refused(tmp_path / "empty", ["t"])


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
