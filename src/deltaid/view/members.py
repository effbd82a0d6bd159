"""How the bodies of a robot are drawn: one name, colour and width each, in all pictures."""

import re
from dataclasses import dataclass

from deltaid.view import style


@dataclass(frozen=True)
class Member:
    """What a body is called in a legend, its colour, and its width in pixels."""

    label: str
    color: str
    width: int


_KNOWN = {
    "base": Member("base", style.PRIOR, 5),
    "U": Member("upper arms", style.SERIES[0], 8),
    "C": Member("carriages", style.SERIES[0], 8),
    "S": Member("struts", style.SERIES[5], 3),
    "P": Member("platform", style.SERIES[3], 6),
    "SB": Member("side bars", style.SERIES[3], 6),
    "MB": Member("middle bar", style.SERIES[2], 6),
    "MP": Member("main parts", style.SERIES[3], 6),
    "R": Member("rods", style.SERIES[2], 6),
    "HP": Member("half platforms", style.SERIES[3], 6),
    "TU": Member("upper bar", style.SERIES[2], 5),
    "TL": Member("lower bar", style.SERIES[4], 5),
    "EE": Member("end effector", style.SERIES[1], 5),
}
_NUMBERED = re.compile(r"([USC])(\d+)")
_ONE = {"U": "upper arm", "C": "carriage", "S": "strut"}


def members(bodies: tuple[str, ...]) -> dict[str, Member]:
    """Each body's member: those of a limb of its own by its number, foreign ones by their name."""
    return {body: _member(body, i) for i, body in enumerate(bodies)}


def _member(body: str, i: int) -> Member:
    if body in _KNOWN:
        return _KNOWN[body]
    if of_limb := _NUMBERED.fullmatch(body):
        like = _KNOWN[of_limb[1]]
        return Member(f"{_ONE[of_limb[1]]} {of_limb[2]}", like.color, like.width)
    return Member(body, style.SERIES[i % len(style.SERIES)], 5)
