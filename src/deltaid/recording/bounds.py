"""Numbers that no recording of a robot holds, however finite they are.

Wrong units and broken rows make them. A recording may go beyond the limits that a description
states, but not a hundred times; where none is stated, no machine of this class comes near.
"""

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.recording.columns import Columns
from deltaid.recording.source import Table
from deltaid.robot.description import RobotDescription

# How many times a described limit may be exceeded.
_FACTOR = 100.0
# s, and the largest magnitudes of position, velocity, acceleration and torque of a turning drive
# [rad, rad/s, rad/s², N m] and of a sliding one [m, m/s, m/s², N].
_LONGEST = 1e12
_TURNING = (1e5, 1e3, 1e6, 1e6)
_SLIDING = (100.0, 300.0, 1e6, 1e7)
_UNITS = {False: ("rad", "rad/s", "rad/s²", "N m"), True: ("m", "m/s", "m/s²", "N")}


class Bounds:
    """The largest magnitude of each channel but those beside the drives, as in `Columns.all`."""

    def __init__(self, table: Table, columns: Columns, robot: RobotDescription) -> None:
        self._table, self._columns = table, columns
        largest, units = [_LONGEST], ["s"]
        parts = (columns.position, columns.velocity, columns.acceleration, columns.torque)
        for quantity, channels in enumerate(parts):
            for drive, _ in zip(robot.drives, channels, strict=False):
                slides = robot.is_linear(drive)
                stated = _stated(robot, drive)[quantity]
                highest = (_SLIDING if slides else _TURNING)[quantity]
                largest.append(min(highest, _FACTOR * stated) if stated else highest)
                units.append(_UNITS[slides][quantity])
        self._largest, self._units = np.array(largest), units

    def check(self, values: Float[np.ndarray, "rows channels"], row: int) -> None:
        """Refuse the first row with a number beyond its bound; `row` numbers the first one.

        Raises:
            RecordingError: with row, column, number and bound.
        """
        values = values[:, : len(self._largest)]
        if np.all(np.abs(values).max(axis=0) <= self._largest):
            return
        i, k = (int(index) for index in np.argwhere(np.abs(values) > self._largest)[0])
        channel, unit = self._columns.all[k], self._units[k]
        raise RecordingError(
            f"column {channel.column} is {values[i, k]:.4g} {unit}, but no recording of this robot "
            f"goes beyond {self._largest[k]:.4g} {unit}",
            where=self._table.row_place(row + i),
            cure="repair or remove the row; if all rows are like it, declare the column's unit and "
            "gear with --columns MAPPING.yaml",
        )


def _stated(robot: RobotDescription, drive: str) -> tuple[float | None, ...]:
    """What the description says of a drive: nothing of its position, which may be wrapped."""
    limits = robot.drive_limits.get(drive)
    if limits is None:
        return None, None, None, None
    return None, limits.top_speed, limits.top_acceleration, limits.effort
