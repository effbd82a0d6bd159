"""Damaged files: what may happen to bytes on their way, and what opening them may come to."""

import random
import resource
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltaid.errors import DeltaidError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.opening import open_log

_EDGE = 4096


def damaged(data: bytes, rng: random.Random) -> bytes:
    """The bytes of a file cut off, with bits flipped, ranges zeroed, filled, or exchanged.

    Half of the damage is near the ends, where headers and tables of contents are.
    """
    held = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        at, size = _place(held, rng), rng.choice((1, 4, 8, 64, 512))
        match rng.randrange(6):
            case 0:
                del held[at:]
            case 1 | 2:
                for _ in range(rng.choice((1, 1, 3, 30))):
                    held[_place(held, rng)] ^= 1 << rng.randrange(8)
            case 3:
                held[at : at + size] = bytes(len(held[at : at + size]))
            case 4:
                held[at : at + size] = b"\xff" * len(held[at : at + size])
            case _:
                other = _place(held, rng)
                size = min(size, len(held) - max(at, other))
                first, second = held[at : at + size], held[other : other + size]
                held[at : at + size], held[other : other + size] = second, first
        if not held:
            break
    return bytes(held)


def changed_bit(data: bytes, rng: random.Random) -> bytes:
    """The bytes of a file with one bit changed."""
    held, bit = bytearray(data), rng.randrange(8 * len(data))
    held[bit // 8] ^= 1 << bit % 8
    return bytes(held)


def unclear(message: str, place: str) -> str:
    """What a refusal lacks: its place, its cure, or signs that can be printed; empty if nothing."""
    if place not in message:
        return f"names no place: {message}"
    if "→" not in message:
        return f"names no cure: {message}"
    if any(not sign.isprintable() and sign != "\n" for sign in message):
        return f"cannot be printed: {message!r}"
    return ""


def _place(held: bytearray, rng: random.Random) -> int:
    edge = min(_EDGE, len(held))
    first = rng.choice((0, 0, len(held) - edge, None, None))
    return rng.randrange(len(held)) if first is None else first + rng.randrange(edge)


@dataclass(frozen=True)
class Outcome:
    """What opening a file came to.

    Attributes:
        end: 'refused', 'read' if every number is as it was, or 'altered': no kind of file has a
            checksum over everything.
        message: of a refusal.
        seconds: that it took.
        megabytes: by which the largest memory of the process grew.
    """

    end: str
    message: str
    seconds: float
    megabytes: float


def outcome(
    path: Path, columns: ColumnMapping | None, rows: np.ndarray, kinematics: Kinematics
) -> Outcome:
    """Open a file and read all of it.

    Raises:
        Exception: whatever is not the package's own error.
    """
    start, memory = time.monotonic(), largest_memory()
    end, message = "altered", ""
    try:
        log = open_log(path, kinematics, columns)
        values = np.concatenate(list(log.batches()))
        if np.array_equal(values[:, : rows.shape[1]], rows):
            end = "read"
    except DeltaidError as error:
        end, message = "refused", str(error)
    return Outcome(end, message, time.monotonic() - start, largest_memory() - memory)


def complaint(found: Outcome, path: Path) -> str:
    """What is wrong with an outcome; empty if nothing is."""
    if found.end == "refused":
        if not found.message.startswith(str(path)):
            return f"begins with no place: {found.message}"
        if lacks := unclear(found.message, str(path)):
            return lacks
    if found.seconds > 10:
        return f"took {found.seconds:.1f} s"
    if found.megabytes > 1000:
        return f"took {found.megabytes:.0f} MB"
    return ""


def largest_memory() -> float:
    """Largest memory of this process so far [MB]."""
    status = Path("/proc/self/status")
    if status.exists():  # what `resource` tells there begins with the memory of the parent
        return int(status.read_text().partition("VmHWM:")[2].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20)
