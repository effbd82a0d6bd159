"""What a log's sensors hold, while it is surveyed: nothing, always the same, or gaps."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.columns import Columns
from deltaid.recording.source import Table


@dataclass
class SensorCheck:
    """Running check; `add` all rows, then `require` and ask what is `told`."""

    table: Table
    columns: Columns
    _low: Float[np.ndarray, " channels"] = field(init=False)
    _high: Float[np.ndarray, " channels"] = field(init=False)
    _empty: Int[np.ndarray, " channels"] = field(init=False)
    _first: dict[int, int] = field(default_factory=dict[int, int])
    _rows: int = 0

    def __post_init__(self) -> None:
        places = self.columns.sensor_places
        count = places.stop - places.start
        self._low, self._high = np.full(count, np.inf), np.full(count, -np.inf)
        self._empty = np.zeros(count, dtype=np.int64)

    def add(self, values: Float[np.ndarray, "rows channels"], row: int) -> None:
        """Take in rows, columns as in `Columns.all`; `row` numbers the first for messages."""
        shown = values[:, self.columns.sensor_places]
        self._rows += len(shown)
        if not shown.size:
            return
        empty = np.isnan(shown)
        self._low = np.minimum(self._low, np.where(empty, np.inf, shown).min(axis=0))
        self._high = np.maximum(self._high, np.where(empty, -np.inf, shown).max(axis=0))
        for k in np.flatnonzero(empty.any(axis=0)).tolist():
            self._first.setdefault(k, row + int(np.argmax(empty[:, k])))
        self._empty += np.count_nonzero(empty, axis=0)

    def require(self) -> None:
        """Refuse columns in which nothing was recorded.

        Raises:
            RecordingError: a column holds no number, or one number only.
        """
        for k, (sensor, column) in enumerate(self._named()):
            if self._low[k] < self._high[k]:
                continue
            what = "holds no number in any row"
            if self._empty[k] < self._rows:
                what = f"is {self._low[k]:.6g} in all rows, so nothing was recorded"
            raise RecordingError(
                f"column {column} of sensor {sensor} {what}",
                where=str(self.table.path),
                cure="check the logger's signal, map the right column, or leave the sensor out of "
                f"this recording by the line `sensors: {{{sensor}: null}}` of a mapping",
            )

    def told(self) -> list[Doubt]:
        """Rows without a number."""
        named = self._named()
        return [
            Doubt(
                f"column {named[k][1]} of sensor {named[k][0]} holds no number in "
                f"{self._empty[k]} of {self._rows} rows, the first "
                f"{self.table.row_place(row).removeprefix(f'{self.table.path}, ')}",
                cause="the sensor is read less often than the drives, or lost its connection",
                cure="such rows do not count for the sensor; all others do",
            )
            for k, row in sorted(self._first.items())
        ]

    def _named(self) -> list[tuple[str, str]]:
        """Sensor and column of each channel."""
        return [(one.name, c.column) for one in self.columns.sensors for c in one.channels]
