"""What the short names in tables stand for: bodies, and entries of the parameter vector."""

import re
from collections.abc import Iterable

from deltaid.robot.body import body_in_words

_ENTRIES = {"m": "mass"}
_ENTRIES |= {f"mc{axis}": f"mass times centre of mass along {axis}" for axis in "xyz"}
_ENTRIES |= {f"I{axis}{axis}": f"moment of inertia about {axis}" for axis in "xyz"}
_ENTRIES |= {f"I{pair}": f"product of inertia of {pair[0]} and {pair[1]}"
             for pair in ("xy", "xz", "yz")}  # fmt: skip
_ENTRIES |= {f"S{axis}{axis}": f"second moment of mass along {axis}" for axis in "xyz"}
_ENTRIES |= {f"S{pair}": f"second moment of mass along {pair[0]} and {pair[1]}"
             for pair in ("xy", "xz", "yz")}  # fmt: skip
_ENTRY = rf"(?:{'|'.join(_ENTRIES)})"
# 'U.mcx', in formulas 'mcx_U', in descriptions 'bodies.U', of what a body is put on 'scale:U'.
NAME = re.compile(
    rf"(?<![\w.])(?:(?P<body>[^\W\d_]\w*)\.(?P<entry>{_ENTRY})|(?P<first>{_ENTRY})_(?P<of>\w+)"
    r"|bodies\.(?P<key>\w+)|(?P<tool>[a-z][a-z-]*):(?P<on>[A-Z]+\d*))(?!\w)"
)


def in_words(name: "re.Match[str]") -> str:
    """'upper arm: mass' of a `NAME`."""
    entry = name["entry"] or name["first"]
    if name["tool"]:
        return f"{name['tool']}: {body_in_words(name['on'])}"
    return body_in_words(body_of(name)) + (f": {_ENTRIES[entry]}" if entry else "")


def body_of(name: "re.Match[str]") -> str:
    """U of a `NAME`."""
    return name["body"] or name["of"] or name["key"] or name["on"]


def is_short(name: str) -> bool:
    """Whether a word is a body's short name, which needs explaining."""
    return body_in_words(name) != name


def bodies_in(cells: Iterable[str]) -> tuple[str, ...]:
    """Short names of bodies in the cells of a table, each once: alone, in a list, in names."""
    found: dict[str, None] = {}
    for cell in cells:
        parts = cell.split(", ")
        if all(is_short(part) for part in parts):
            found |= dict.fromkeys(parts)
        found |= dict.fromkeys(body_of(name) for name in NAME.finditer(cell))
    return tuple(name for name in found if is_short(name))
