"""Recordings with the effects of real drives, of robots with known parameters.

`case(row, kind, seed)` makes the recordings of a row of the table in `docs/real_drives.md`, for one
of six kinds of robot. Torques of the links come from the oracle (`plants.py`); gear and friction
add to them (`happening.py`), and sensors write the log (`sensors.py`).
"""

from drives.cases import case
from drives.causes import CAUSES
from drives.robots import KINDS
from drives.rows import ROWS, Case
from drives.timing import TIMING

__all__ = ["CAUSES", "KINDS", "ROWS", "TIMING", "Case", "case"]
