"""Recordings with interruptions, and the masks that are found in them."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from deltaid.recording.log import Log
from deltaid.recording.masks.masks import Mask
from deltaid.recording.masks.search import MaskSearch, timed
from deltaid.recording.opening import open_log
from deltaid.recording.time.clock import Clock
from interrupted import Interrupted
from logs import write

CLAVEL, IRB = "clavel-delta3", "irb360-6-1600"


def opened(one: Interrupted, folder: Path, **options: bool) -> Log:
    path = write(folder / "log.parquet", one.frame)
    return open_log(path, one.dynamics.kinematics, **options)


def searched(one: Interrupted, size: int = 1 << 16) -> tuple[Mask, ...]:
    """Masks by rule, without the rest of the survey."""
    search = MaskSearch(one.dynamics.dof, [np.inf] * one.dynamics.dof)
    rows = one.frame.to_numpy()
    for start in range(0, len(rows), size):
        search.add(rows[start : start + size], 1 / one.rate)
    clock = Clock(1 / one.rate, len(rows), 0.0, (len(rows) - 1) / one.rate)
    return timed(search.runs(), clock)


def by_hand(log: Log, *spans: tuple[tuple[int, ...], int, int]) -> Log:
    """A log without some drives' rows."""
    masks = (Mask("standing still", drives, a, b, 0.0, 0.0) for drives, a, b in spans)
    return replace(log, masks=tuple(masks), keep_all=True)
