"""Bodies of a draft: simple solids of the given mass, with the entries that torques determine."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from deltaid.studio.drafting.questions import LINEAR, TELESCOPE, TURNING, platform_of, rounded

# Densities [kg/m³]: aluminium with holes; carbon-fibre struts with metal joints.
_METAL, _CARBON = 2700.0, 1800.0
_ARM, _STRUT = "[mcx, mcz, Sxx, Szz]", "[m, mcx, Sxx, Syy, Szz]"
_TUBE, _TOOL = "[m, mcz, Sxx, Syy, Szz]", "[m, mcx, mcy, Sxx, Syy]"


@dataclass(frozen=True)
class Drawn:
    """A body of the description.

    Attributes:
        name: of the body.
        comment: what it is.
        shape: its shape as YAML.
        free: entries that a fit may change.
        mass: key of the question that its mass comes from.
    """

    name: str
    comment: str
    shape: str
    free: str
    mass: str


def bodies(kind: str, a: Mapping[str, float]) -> list[Drawn]:
    """All bodies of a kind of robot, in the order of the parameters."""
    if kind in LINEAR:
        carriage = _metal_block("z", a["carriage_mass"])
        drawn = [Drawn("C", "carriage: slides along the rail", carriage, "[m]", "carriage_mass")]
    else:
        arm = _rod("x", a["arm"], a["arm_mass"], _METAL, a["arm"] / 2)
        drawn = [Drawn("U", "upper arm: turns about its y axis only", arm, _ARM, "arm_mass")]
    strut = _rod("x", a["strut"], a["strut_mass"], _CARBON, a["strut"] / 2)
    drawn.append(Drawn("S", "one strut of the parallelogram", strut, _STRUT, "strut_mass"))
    drawn += [
        Drawn(name, what, shape, free, "platform_mass")
        for name, what, shape, free in _platform(kind, a)
    ]
    if kind in TELESCOPE:
        half, length = a["telescope_mass"] / 2, tube(a)
        for name, which, middle in (("TU", "upper", -length / 2), ("TL", "lower", length / 2)):
            shape = _rod("z", length, half, _METAL, middle)
            drawn.append(Drawn(name, f"telescope, {which} tube", shape, _TUBE, "telescope_mass"))
    if kind in TURNING:
        size = _size(a["tool_mass"])
        tool = _rod("z", size, a["tool_mass"], _METAL, -size / 2)
        drawn.append(Drawn("EE", "tool: translates and turns about z", tool, _TOOL, "tool_mass"))
    return drawn


def _platform(kind: str, a: Mapping[str, float]) -> list[tuple[str, str, str, str]]:
    """Name, comment, shape and free entries of a platform's parts.

    They share the platform's mass in the proportions of existing machines.
    """
    mass = a["platform_mass"]
    match platform_of(kind):
        case "i4":
            what = "one of two half platforms, with its rack"
            return [("HP", what, _metal_block("y", mass / 2), "[m]")]
        case "h4":
            side, bar = _metal_block("y", mass / 4), _rod("x", 2 * a["bar"], mass / 2, _METAL)
            return [
                ("SB", "one of two side bars: translates only", side, "[m]"),
                ("MB", "middle bar: translates and turns about z", bar, "[m, Sxx, Syy]"),
            ]
        case "par4":
            main, rod = _metal_block("y", 3 * mass / 8), _rod("x", a["bar"], mass / 8, _METAL)
            return [
                ("MP", "one of two main parts: translates only", main, "[m]"),
                ("R", "one of two rods: translates and turns about z", rod, "[m, Sxx, Syy]"),
            ]
        case _:
            return [("P", "platform: translates only", _metal_block("z", mass), "[m]")]


def stroke(a: Mapping[str, float]) -> tuple[float, float]:
    """Shortest and longest telescope within the workspace, with a margin [m]."""
    near, far = abs(a["high"]), float(np.hypot(a["low"], a["radius"]))
    return float(np.floor(950 * near)) / 1e3, float(np.ceil(1050 * far)) / 1e3


def tube(a: Mapping[str, float]) -> float:
    """Length of either tube [m]; the tubes still overlap at the longest stroke."""
    return rounded(0.55 * stroke(a)[1], 3)


def _size(mass: float) -> float:
    """Length of a cylinder whose diameter equals its length [m]."""
    return rounded((4 * mass / (np.pi * _METAL)) ** (1 / 3), 3)


def _metal_block(axis: str, mass: float) -> str:
    return _rod(axis, _size(mass), mass, _METAL)


def _rod(axis: str, length: float, mass: float, density: float, middle: float = 0.0) -> str:
    """A solid cylinder centred on an axis, as thick as its mass requires."""
    radius = rounded(float(np.sqrt(mass / (np.pi * density * length))), 3)
    centre = ", ".join(repr(middle) if name == axis and middle else "0" for name in "xyz")
    return (
        f"{{shape: hollow_cylinder, axis: {axis}, length: {length!r}, outer_radius: {radius!r},\n"
        f"         centre: [{centre}], mass: {mass!r}}}"
    )
