"""Mappings of columns."""

from deltaid.recording.mapped_columns import AllDrives, DriveColumn, TimeColumn
from deltaid.recording.mapping import QUANTITIES, ColumnMapping
from deltaid.view.card import Card


def card(value: ColumnMapping) -> Card:
    """Which column is what, and in which unit; what is left to the default names is not told."""
    facts = [("time", _time(value.time))]
    for quantity in QUANTITIES:
        columns: AllDrives | tuple[DriveColumn, ...] | None = getattr(value, quantity)
        each = (columns,) if isinstance(columns, AllDrives) else columns or ()
        facts += [(quantity, ", ".join(_column(one) for one in each))] * bool(each)
    facts += [("sensors", ", ".join(value.sensors))] * bool(value.sensors)
    facts += [("loads", ", ".join(load.name for load in value.loads))] * bool(value.loads)
    return Card("Mapping of columns", (), "", tuple(facts), apart=True)


def _time(time: TimeColumn) -> str:
    if time.is_absent:
        return f"{time.rate:g} Hz"
    return f"{time.column} [{time.unit if time.rate is None else f'{time.rate:g} / s'}]"


def _column(one: DriveColumn | AllDrives) -> str:
    """'tau2 [N m; sign -1]': name, unit, and what else is done to its numbers."""
    name = one.column or ", ".join(getattr(one, "columns", None) or ())
    more = [
        f"{key.replace('_', ' ')} {getattr(one, key)}"
        for key, usual in (("sign", 1), ("gear", 1.0), ("zero", 0.0), ("torque_constant", None))
        if getattr(one, key) not in (usual, None)
    ]
    return f"{name} [{'; '.join([str(one.unit), *more])}]"
