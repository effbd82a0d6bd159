"""Bags and messages that are damaged are told with their place."""

import random
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from bags import KINDS
from deltaid.recording.formats.ros_messages import Decoder, MessageError
from joint_states import MESSAGES, refused, told


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
