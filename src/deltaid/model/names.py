"""Parameters by their names, and the nearest name where there is none."""

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.errors import unknown

# What people call the entries of a body.
_ALSO = {"mass": "m", "weight": "m", "x": "mcx", "y": "mcy", "z": "mcz", "com": "mcx",
         "inertia": "Izz"}  # fmt: skip


def place(layout: ParameterLayout, name: str, where: str) -> int:
    """Where a parameter stands in p.

    Raises:
        UnknownNameError: there is none of that name.
    """
    if name in layout.names:
        return layout.names.index(name)
    raise unknown(name, layout.names, "parameter", where, also=_usual(layout, name))


def _usual(layout: ParameterLayout, name: str) -> str:
    """The parameter that is called otherwise elsewhere: P.mass is P.m."""
    body, _, entry = name.partition(".")
    found = f"{body}.{_ALSO.get(entry.lower(), '')}"
    return found if found in layout.names else ""
