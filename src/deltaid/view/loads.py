"""Table of the loads that recordings held, for the terminal and for pages alike."""

from collections.abc import Sequence

from deltaid.model.parameter_record import HeldLoad
from deltaid.view.model_tables import value_and_width
from deltaid.view.table import Table

# What of a load is shown, where a torque shows it or it was declared.
_SHOWN = ("data", "fixed")


def load_table(loads: Sequence[HeldLoad]) -> Table | None:
    """Mass, first moment and inertia of each load, as far as they are known; None without loads."""
    if not loads:
        return None
    rows = tuple(
        (
            parameter.name,
            *value_and_width(parameter),
            parameter.unit,
            "declared" if parameter.determined_by == "fixed" else "data",
            load.body,
            ", ".join(load.logs),
        )
        for load in loads
        for parameter in load.parameters
        if parameter.determined_by in _SHOWN and parameter.value
    )
    return Table(
        ("load", "value", "± (95 %)", "unit", "from", "held by", "in"),
        rows,
        "Moments and inertia are about the origin of the body that holds the load. The model is of "
        "the robot without it.",
        title="loads",
    )
