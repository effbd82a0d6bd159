"""Parameters by their names, and the nearest name where there is none."""

from collections.abc import Iterable

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.errors import UnknownNameError, nearest

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


def unknown(
    name: object, known: Iterable[str], what: str, where: str, *, also: str = ""
) -> UnknownNameError:
    """An error that says which name is nearest, and some of those that there are.

    Args:
        also: the name that is meant, where that is known.
    """
    names, text = list(known), str(name)
    hint = f"did you mean {also}? " if also else nearest(text, names)
    head = text.partition(".")[0]
    own = [one for one in names if one.startswith(f"{head}.")]
    shown = own or names
    listed = ", ".join(shown[:12]) + (", …" if len(shown) > 12 else "")
    return UnknownNameError(
        f"has no {what} '{text}'", where=where, cure=f"{hint}there are: {listed}"
    )


def _usual(layout: ParameterLayout, name: str) -> str:
    """The parameter that is called otherwise elsewhere: P.mass is P.m."""
    body, _, entry = name.partition(".")
    found = f"{body}.{_ALSO.get(entry.lower(), '')}"
    return found if found in layout.names else ""
