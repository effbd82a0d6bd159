"""Bodies of a draft: simple solids of the given mass, with the entries that torques determine."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deltaid.studio.drafting.questions import (
    ALL,
    BAR,
    H4,
    LINEAR,
    ROTARY,
    SLIDE,
    TELESCOPE,
    TURNING,
    Answers,
    rounded,
)

# Densities [kg/m³]: aluminium with holes; carbon-fibre struts with metal joints.
_METAL, _CARBON = 2700.0, 1800.0
_ARM, _STRUT = "[mcx, mcz, Sxx, Szz]", "[m, mcx, Sxx, Syy, Szz]"
_TUBE, _TOOL = "[m, mcz, Sxx, Syy, Szz]", "[m, mcx, mcy, Sxx, Syy]"


def stroke(a: Answers) -> tuple[float, float]:
    """Shortest and longest telescope within the workspace, with a margin [m]."""
    near, far = abs(a["high"]), float(np.hypot(a["low"], a["radius"]))
    return float(np.floor(950 * near)) / 1e3, float(np.ceil(1050 * far)) / 1e3


def _tube(a: Answers) -> float:
    """Length of either tube [m]; the tubes still overlap at the longest stroke."""
    return rounded(0.55 * stroke(a)[1], 3)


@dataclass(frozen=True)
class Solid:
    """A body of the description: a solid cylinder along an axis, as thick as its mass requires.

    Attributes:
        name: of the body.
        comment: what it is.
        of: kinds of robots that have it.
        mass: key of the question that its mass comes from.
        free: entries that a fit may change, as YAML.
        axis: of the cylinder.
        length: of the cylinder [m]; by default its diameter.
        share: of the mass in the answer; parts of a platform share it as in existing machines.
        density: of the cylinder [kg/m³].
        middle: position of its centre along the axis, as a share of the length.
    """

    name: str
    comment: str
    of: frozenset[str]
    mass: str
    free: str
    axis: str
    length: Callable[[Answers], float] | None = None
    share: float = 1.0
    density: float = _METAL
    middle: float = 0.0

    def shape(self, a: Answers) -> str:
        """The cylinder as YAML."""
        mass = self.share * a[self.mass]
        # A cylinder whose diameter equals its length has the volume π length³ / 4.
        compact = rounded((4 * mass / (np.pi * self.density)) ** (1 / 3), 3)
        length = self.length(a) if self.length else compact
        radius = rounded(float(np.sqrt(mass / (np.pi * self.density * length))), 3)
        middle = repr(self.middle * length) if self.middle else "0"
        centre = ", ".join(middle if name == self.axis else "0" for name in "xyz")
        return (
            f"{{shape: hollow_cylinder, axis: {self.axis}, length: {length!r}, "
            f"outer_radius: {radius!r},\n         centre: [{centre}], mass: {mass!r}}}"
        )


# All bodies, in the order of the parameters.
_SOLIDS = (
    Solid("C", "carriage: slides along the rail", LINEAR, "carriage_mass", "[m]", "z"),
    Solid("U", "upper arm: turns about its y axis only", ROTARY, "arm_mass", _ARM, "x",
          lambda a: a["arm"], middle=0.5),
    Solid("S", "one strut of the parallelogram", ALL, "strut_mass", _STRUT, "x",
          lambda a: a["strut"], density=_CARBON, middle=0.5),
    Solid("HP", "one of two half platforms, with its rack", SLIDE, "platform_mass", "[m]", "y",
          share=1 / 2),
    Solid("SB", "one of two side bars: translates only", H4, "platform_mass", "[m]", "y",
          share=1 / 4),
    Solid("MB", "middle bar: translates and turns about z", H4, "platform_mass",
          "[m, Sxx, Syy]", "x", lambda a: 2 * a["bar"], share=1 / 2),
    Solid("MP", "one of two main parts: translates only", BAR - H4, "platform_mass", "[m]", "y",
          share=3 / 8),
    Solid("R", "one of two rods: translates and turns about z", BAR - H4, "platform_mass",
          "[m, Sxx, Syy]", "x", lambda a: a["bar"], share=1 / 8),
    Solid("P", "platform: translates only", ALL - BAR - SLIDE, "platform_mass", "[m]", "z"),
    Solid("TU", "telescope, upper tube", TELESCOPE, "telescope_mass", _TUBE, "z", _tube,
          share=1 / 2, middle=-0.5),
    Solid("TL", "telescope, lower tube", TELESCOPE, "telescope_mass", _TUBE, "z", _tube,
          share=1 / 2, middle=0.5),
    Solid("EE", "tool: translates and turns about z", TURNING, "tool_mass", _TOOL, "z",
          middle=-0.5),
)  # fmt: skip


def bodies(kind: str) -> list[Solid]:
    """All bodies of a kind of robot, in the order of the parameters."""
    return [solid for solid in _SOLIDS if kind in solid.of]
