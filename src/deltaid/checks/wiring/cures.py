"""Lines of a mapping that correct its columns."""

from collections.abc import Mapping

import numpy as np

from deltaid.checks.evidence import Evidence
from deltaid.model.verdict import Proposal
from deltaid.recording.mapped_columns import AllDrives, DriveColumn
from deltaid.recording.mapping import Quantity
from deltaid.recording.resolution import si_unit

# What a unit becomes by a factor of its numbers.
_UNITS = {
    ("rad", np.pi / 180): "deg",
    ("rad", 2 * np.pi): "rev",
    ("deg", 180 / np.pi): "rad",
    ("m", 1e-3): "mm",
    ("mm", 1e3): "m",
    ("rad/s", np.pi / 30): "rpm",
    ("rad/s", np.pi / 180): "deg/s",
    ("rpm", 30 / np.pi): "rad/s",
    ("deg/s", 180 / np.pi): "rad/s",
    ("m/s", 1e-3): "mm/s",
    ("mm/s", 1e3): "m/s",
    ("N m", 1e-3): "mN*m",
    ("N*m", 1e-3): "mN*m",
    ("N", 1e-3): "mN",
}

Values = dict[int, dict[str, object]]


class Entries:
    """Entries of a mapping for each drive's columns, and corrected ones."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence, robot = evidence, evidence.robot
        self._linear = [robot.is_linear(drive) for drive in robot.drives]

    def entry(self, quantity: Quantity, drive: int) -> DriveColumn:
        """That of a drive, its default where there is none."""
        columns = getattr(self._evidence.mapping, quantity, None)
        if isinstance(columns, AllDrives):
            columns = columns.entries(len(self._linear), quantity)
        if columns is not None:
            return columns[drive]
        name, unit = self.name(quantity, drive), si_unit(quantity, linear=self._linear[drive])
        return DriveColumn(column=name, unit=self._evidence.table.units.get(name, unit))

    def name(self, quantity: Quantity, drive: int) -> str:
        return getattr(self._evidence.columns, quantity)[drive].column

    def turned(self, quantity: Quantity, drive: int) -> dict[str, object]:
        return {"sign": -self.entry(quantity, drive).sign}

    def in_unit(self, quantity: Quantity, drive: int, factor: float) -> dict[str, object]:
        """With a unit whose numbers are `factor` times those of the unit now; empty if unnamed."""
        now = self.entry(quantity, drive).unit
        for (unit, by), name in _UNITS.items():
            if unit == now and abs(by / factor - 1) < 1e-6:
                return {"unit": name}
        return {}

    def of_motor(self, quantity: Quantity, drive: int, factor: float) -> dict[str, object]:
        """Of a motor whose numbers must be multiplied by `factor`."""
        slower = 1 / factor if quantity == "torque" else factor
        if self._linear[drive]:
            return {"unit": si_unit(quantity, linear=False), "lead": rounded(2 * np.pi * slower)}
        return {"gear": rounded(self.entry(quantity, drive).gear / slower)}

    def moved(self, quantity: Quantity, drive: int, source: int) -> dict[str, object]:
        """All that another drive's entry says."""
        own, moved_entry = (self.entry(quantity, i).model_dump() for i in (drive, source))
        return {key: value for key, value in moved_entry.items() if value != own[key]}

    def shifted(self, drive: int, shift: float) -> dict[str, object]:
        """With a zero at which the joint value is larger by `shift` [rad or m]."""
        scale = self._evidence.columns.position[drive].scale
        return {"zero": float(f"{self.entry('position', drive).zero - shift / scale:.6g}")}

    def proposal(self, values: Mapping[Quantity, Values]) -> tuple[Proposal, ...]:
        """New values of entries, by quantity, drive and key, as changes of the mapping."""
        changes: list[tuple[str, object]] = []
        for quantity, drives in values.items():
            columns = getattr(self._evidence.mapping, quantity, None)
            entries = [(i, key, value) for i, new in drives.items() for key, value in new.items()]
            if not isinstance(columns, AllDrives):
                changes += [(f"{quantity}[{i}].{key}", value) for i, key, value in entries]
                continue
            for key in dict.fromkeys(key for _, key, _ in entries):
                new = [
                    drives.get(i, {}).get(key, getattr(self.entry(quantity, i), key))
                    for i in range(len(self._linear))
                ]
                plural = "columns" if key == "column" else key
                same = all(value == new[0] for value in new)
                changes.append((f"{quantity}.{plural}", new[0] if same else new))
                if key == "column" and columns.column is not None:
                    changes.append((f"{quantity}.column", None))
        return (Proposal("mapping", tuple(changes)),) if changes else ()


def rounded(value: float) -> float:
    """Three digits, or a whole number that is within 2 %."""
    whole = round(value)
    if whole >= 2 and abs(value / whole - 1) < min(0.02, 0.25 / whole):
        return float(whole)
    return float(f"{value:.3g}")
