"""Recordings as real drives write them, of robots whose truth is known.

`case(row, kind, seed)` makes the recordings of a row of the table in `docs/real_drives.md`, for one
of six kinds of robot. Bodies and mechanics come from the oracle (`plants.py`): from the link by
way of gear and friction to the motor (`happening.py`), and from there into a log (`sensors.py`).
"""

from drives.cases import case
from drives.causes import CAUSES
from drives.robots import KINDS
from drives.rows import ROWS, Case
from drives.timing import TIMING

__all__ = ["CAUSES", "KINDS", "ROWS", "TIMING", "Case", "case"]
