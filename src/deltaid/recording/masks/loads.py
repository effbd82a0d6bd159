"""When the loads of a recording are taken up and put down, while it is surveyed."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.carried import Load
from deltaid.recording.columns import Columns
from deltaid.recording.masks.masks import LOAD_CHANGES, Mask
from deltaid.recording.masks.runs import Runs, joined
from deltaid.recording.masks.search import timed
from deltaid.recording.source import Table
from deltaid.recording.time.clock import Clock

# A gripper's signal and its grip are so far apart at most [s].
_ABOUT = 0.012


@dataclass
class LoadSearch:
    """Running search; `add` consecutive rows, then ask for `masks` and `told`."""

    table: Table
    columns: Columns
    _changes: list[np.ndarray] = field(default_factory=list[np.ndarray])
    _last: Bool[np.ndarray, "loads 1"] | None = None
    _ever: Bool[np.ndarray, "loads 1"] | None = None
    _rows: int = 0

    def add(self, values: Float[np.ndarray, "rows channels"], row: int) -> None:
        """Take in rows, columns as in `Columns.all`; `row` numbers the first for messages.

        Raises:
            RecordingError: a column is neither 0 nor 1, and the mapping names no other numbers.
        """
        if not self.columns.loads:
            return
        extra = values[:, self.columns.extra_places]
        for load in self.columns.loads:
            if load.column is not None and load.holding is None:
                self._require_truth(load, extra[:, self.columns.beside(load.column)], row)
        held = self.columns.held(values[:, 0], extra)
        before = held[:, :1] if self._last is None else self._last
        changed = np.any(np.diff(held, axis=1, prepend=before), axis=0)
        self._changes.append(self._rows + np.flatnonzero(changed))
        self._last = held[:, -1:]
        seen = held if self._ever is None else np.hstack([self._ever, held])
        self._ever = np.logical_or.reduce(seen, axis=1, keepdims=True)
        self._rows += len(values)

    def masks(self, clock: Clock) -> tuple[Mask, ...]:
        """Rows about the changes, which count for no drive."""
        about = max(1, round(_ABOUT * clock.rate))
        changes = np.concatenate([np.zeros(0, dtype=np.int64), *self._changes])
        runs: Runs = joined(np.column_stack([changes - about, changes + about - 1]))
        runs = np.clip(runs, 0, self._rows - 1)
        drives = tuple(range(len(self.columns.torque)))
        return timed([(LOAD_CHANGES, drives, runs)] if drives else [], clock)

    def told(self) -> list[Doubt]:
        """Spans in which nothing was recorded."""
        if self._ever is None:
            return []
        return [
            Doubt(
                f"load {load.name} is declared for spans in which nothing was recorded",
                cause="spans count in the time of another recording, or in another unit",
                cure="give spans in s, by the time of this recording",
            )
            for load, ever in zip(self.columns.loads, self._ever.ravel(), strict=True)
            if load.spans is not None and not ever
        ]

    def _require_truth(self, load: Load, numbers: Float[np.ndarray, " rows"], row: int) -> None:
        other = np.flatnonzero((numbers != 0.0) & (numbers != 1.0))
        if other.size:
            raise RecordingError(
                f"column {load.column} of load {load.name} is {numbers[other[0]]:.10g}, neither 0 "
                "nor 1",
                where=self.table.row_place(row + int(other[0])),
                cure="list the numbers at which the load is held: "
                f"load: {{column: {load.column}, when: [{numbers[other[0]]:.10g}]}}",
            )
