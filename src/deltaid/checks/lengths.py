"""Lengths of a description that are no metres: millimetres taken for metres, and the reverse.

Works on the plain data of a description, because most robots in millimetres are larger than any
description may be, and so are refused when their file is loaded.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from deltaid.model.verdict import Fault, Grade, Proposal, Verdict

# m. The largest Deltas have arms and struts of some 4 m together, the smallest of 20 mm.
_GIANT, _DWARF = 10.0, 0.005
# No part of a robot is so many times as long as a limb, none that counts so many times shorter.
_OUT_OF_SCALE, _SMALL = 4.0, 250.0
_UNIT = Fault("millimetres", "m")

# Keys of lengths, by the part of the description that holds them.
_LIMBS = (
    "base_radius", "platform_radius", "base_points", "platform_points", "upper_arm", "strut",
    "strut_spacing",
)  # fmt: skip
_OTHERS = {
    "platform": ("half_length", "length", "tool"),
    "telescope": ("base_joint", "platform_joint", "stroke"),
    "workspace": ("radius", "x", "y", "z", "top"),
}
_SHAPE = ("length", "outer_radius", "inner_radius", "centre")

Length = tuple[str, float]  # path and number


def checked_lengths(data: dict[str, Any]) -> Verdict:
    """The verdict on all lengths of a description.

    Limbs too long for any robot are in millimetres, too short ones are off the other way. Their
    corrected size judges all lengths: limbs one by one, each other part as one unit.
    """
    limbs, groups = _lengths(data.get("limbs"), _LIMBS, "limbs"), list(_groups(data))
    arms = [length for length in limbs if length[0].startswith("limbs.upper_arm")]
    struts = [length for length in limbs if length[0].partition("[")[0] == "limbs.strut"]
    space = _lengths(data.get("workspace"), _OTHERS["workspace"], "workspace")
    # A mechanism of the user's own names no limbs.
    size = _longest(arms) + _longest(struts) or _longest(space)
    small = size < _DWARF
    factor, unit = (1e3, "divided by 1000 once too often") if small else (1e-3, "in millimetres")
    size *= factor if small or size > _GIANT else 1.0
    groups = [group for group in groups if _longest(group) > 0] + [[length] for length in limbs]
    low, high = (size / _SMALL, np.inf) if small else (0.0, _OUT_OF_SCALE * size)
    wrong = [length for group in groups if not low <= _longest(group) <= high for length in group]
    if not wrong:
        return _UNIT.good(f"limbs of {size:.3g} m; all lengths go with it", size)
    path, value = max(wrong, key=lambda length: abs(length[1]))
    others = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
    changes = tuple((place, float(f"{value * factor:.12g}")) for place, value in wrong if value)
    return _UNIT.poor(
        f"{path} is {value:g} m{others}, where limbs of about {size:.3g} m are likely",
        path.partition(".")[0],
        abs(value),
        grade=Grade.WRONG,
        cause=f"lengths {unit}; those of a description are in metres",
        cure=f"multiply these lengths by {factor:g}",
        proposals=(Proposal("robot", changes),),
    )


def _longest(group: Iterable[Length]) -> float:
    return max((abs(value) for _, value in group), default=0.0)


def _groups(data: dict[str, Any]) -> Iterator[list[Length]]:
    """Lengths beside the limbs', those of one part together."""
    for part, keys in _OTHERS.items():
        yield _lengths(data.get(part), keys, part)
    for name, body in (data.get("bodies") or {}).items():
        prior = body.get("prior") if isinstance(body, dict) else None
        for k, shape in enumerate(prior if isinstance(prior, list | tuple) else ()):
            yield _lengths(shape, _SHAPE, f"bodies.{name}.prior[{k}]")
    for drive, limits in (data.get("drive_limits") or {}).items():
        yield _lengths(limits, ("position",), f"drive_limits.{drive}")


def _lengths(part: Any, keys: tuple[str, ...], path: str) -> list[Length]:
    """All numbers under some keys of a part of a description, if it is one."""
    held = part if isinstance(part, dict) else {}
    return [length for key in keys for length in _numbers(held.get(key), f"{path}.{key}")]


def _numbers(value: object, path: str) -> Iterator[Length]:
    """A number, or all numbers of a list or a point."""
    if isinstance(value, list | tuple):
        for k, entry in enumerate(value):
            yield from _numbers(entry, f"{path}[{k}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, float(value)
