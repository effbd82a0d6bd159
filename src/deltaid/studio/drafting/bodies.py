"""Bodies of a draft: simple solids of the right mass, with the entries that torques can tell."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from deltaid.studio.drafting.guesses import rounded
from deltaid.studio.drafting.kinds import has_telescope, is_linear, platform_of

# kg/m³: aluminium with holes; struts of carbon fibre with joints of metal.
_METAL, _CARBON = 2700.0, 1800.0
_ARM, _STRUT = "[mcx, mcz, Sxx, Szz]", "[m, mcx, Sxx, Syy, Szz]"
_TUBE, _TOOL = "[m, mcz, Sxx, Syy, Szz]", "[m, mcx, mcy, Sxx, Syy]"


@dataclass(frozen=True)
class Drawn:
    """A body as it is written.

    Attributes:
        name: of the body.
        comment: what it is.
        shape: one shape of YAML.
        free: entries that may change.
        mass: key of the question that its mass is from.
    """

    name: str
    comment: str
    shape: str
    free: str
    mass: str


def bodies(kind: str, a: Mapping[str, float]) -> list[Drawn]:
    """All bodies of a kind of robot, in the order of the parameters."""
    return [_driven(kind, a), _strut(a), *_platform(kind, a), *_telescope(kind, a)]


def _driven(kind: str, a: Mapping[str, float]) -> Drawn:
    if is_linear(kind):
        shape = _lump("z", a["carriage_mass"])
        return Drawn("C", "carriage: slides along the rail", shape, "[m]", "carriage_mass")
    shape = _rod("x", a["arm"], a["arm_mass"], _METAL, a["arm"] / 2)
    return Drawn("U", "upper arm: turns about its y axis only", shape, _ARM, "arm_mass")


def _strut(a: Mapping[str, float]) -> Drawn:
    shape = _rod("x", a["strut"], a["strut_mass"], _CARBON, a["strut"] / 2)
    return Drawn("S", "one strut of the parallelogram", shape, _STRUT, "strut_mass")


def _platform(kind: str, a: Mapping[str, float]) -> list[Drawn]:
    """A platform's mass is shared among its parts as in machines of its kind."""
    mass, key = a["platform_mass"], "platform_mass"
    tool = [] if platform_of(kind) == "rigid" else [_tool(a)]
    if platform_of(kind) == "rigid":
        tool = [_tool(a)] if has_telescope(kind) else []
        own = [Drawn("P", "platform: translates only", _lump("z", mass), "[m]", key)]
        # The tool comes after the telescope's tubes.
        return own if has_telescope(kind) else own + tool
    if platform_of(kind) == "i4":
        half = _lump("y", mass / 2)
        return [Drawn("HP", "one of two half platforms, with its rack", half, "[m]", key), *tool]
    if platform_of(kind) == "h4":
        middle = _rod("x", 2 * a["bar"], mass / 2, _METAL)
        return [
            Drawn("SB", "one of two side bars: translates only", _lump("y", mass / 4), "[m]", key),
            Drawn("MB", "middle bar: translates and turns about z", middle, "[m, Sxx, Syy]", key),
            *tool,
        ]
    rod = _rod("x", a["bar"], mass / 8, _METAL)
    main = _lump("y", 3 * mass / 8)
    return [
        Drawn("MP", "one of two main parts: translates only", main, "[m]", key),
        Drawn("R", "one of two rods: translates and turns about z", rod, "[m, Sxx, Syy]", key),
        *tool,
    ]


def _telescope(kind: str, a: Mapping[str, float]) -> list[Drawn]:
    if not has_telescope(kind):
        return []
    half, length = a["telescope_mass"] / 2, tube(a)
    upper = _rod("z", length, half, _METAL, -length / 2)
    lower = _rod("z", length, half, _METAL, length / 2)
    return [
        Drawn("TU", "telescope, upper tube", upper, _TUBE, "telescope_mass"),
        Drawn("TL", "telescope, lower tube", lower, _TUBE, "telescope_mass"),
        _tool(a),
    ]


def stroke(a: Mapping[str, float]) -> tuple[float, float]:
    """Shortest and longest telescope that the workspace takes, with a little to spare [m]."""
    near, far = abs(a["high"]), float(np.hypot(a["low"], a["radius"]))
    return float(np.floor(950 * near)) / 1e3, float(np.ceil(1050 * far)) / 1e3


def tube(a: Mapping[str, float]) -> float:
    """Length of either tube: they overlap at the longest stroke [m]."""
    return rounded(0.55 * stroke(a)[1], 3)


def _tool(a: Mapping[str, float]) -> Drawn:
    size = _size(a["tool_mass"])
    shape = _rod("z", size, a["tool_mass"], _METAL, -size / 2)
    return Drawn("EE", "tool: translates and turns about z", shape, _TOOL, "tool_mass")


def _size(mass: float) -> float:
    """Length of a cylinder as wide as it is long [m]."""
    return rounded((4 * mass / (np.pi * _METAL)) ** (1 / 3), 3)


def _lump(axis: str, mass: float) -> str:
    return _rod(axis, _size(mass), mass, _METAL)


def _rod(axis: str, length: float, mass: float, density: float, middle: float = 0.0) -> str:
    """A solid cylinder along an axis, its middle on it too, as thick as its mass makes it."""
    radius = rounded(float(np.sqrt(mass / (np.pi * density * length))), 3)
    centre = ", ".join(repr(middle) if name == axis and middle else "0" for name in "xyz")
    return (
        f"{{shape: hollow_cylinder, axis: {axis}, length: {length!r}, outer_radius: {radius!r},\n"
        f"         centre: [{centre}], mass: {mass!r}}}"
    )
