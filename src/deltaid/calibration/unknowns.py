"""Numbers of a robot's geometry that may differ from its description.

A rotary limb has eight: where its base joint stands against its joint of the platform (3; both
enter the closed loops by their difference only), the direction of its motor axis (2), upper arm,
zero, strut. A limb on a rail has seven: place across the rail (2), direction of the rail (2), zero,
scale of the drive, strut. H4 and Par4 have the length of their middle as well. With struts apart,
so that the platform may tilt, a limb has five more and the tool three.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from deltaid.errors import DescriptionError, unknown
from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import H4Platform, Par4Platform, RigidPlatform

# What parts of a printer or a prototype are off where nobody states it, one standard deviation:
# a millimetre, a milliradian, a thousandth of a belt's pitch.
LENGTH, ANGLE, SCALE = 1e-3, 1e-3, 1e-3

Unit = Literal["m", "rad", ""]
ROTARY: dict[str, Unit] = {
    "base_out": "m", "base_across": "m", "base_up": "m", "azimuth": "rad", "tilt": "rad",
    "upper_arm": "m", "zero": "rad", "strut": "m",
}  # fmt: skip
LINEAR: dict[str, Unit] = {
    "rail_out": "m", "rail_across": "m", "lean_out": "rad", "lean_across": "rad",
    "zero": "m", "scale": "", "strut": "m",
}  # fmt: skip
# Of a limb with struts apart: the second strut less the first; what their distance at the elbow
# exceeds that at the platform by, along x, y, z of the limb's frame; their distance.
APART: dict[str, Unit] = {
    "strut_difference": "m", "pair_out": "m", "pair_across": "m", "pair_up": "m", "spacing": "m",
}  # fmt: skip
TOOL: dict[str, Unit] = {"tool_x": "m", "tool_y": "m", "tool_z": "m"}
# The kind of length of the description whose tolerance each has.
_TOLERANCE = {"base": "base_radius", "rail": "base_radius", "upper": "upper_arm"}
WORDS = {
    "base_out": "base radius", "base_across": "base sideways", "base_up": "base height",
    "azimuth": "axis azimuth", "tilt": "axis tilt", "upper_arm": "upper arm",
    "zero": "zero", "strut": "strut", "rail_out": "rail radius", "rail_across": "rail sideways",
    "lean_out": "rail lean out", "lean_across": "rail lean aside", "scale": "drive scale",
    "strut_difference": "strut difference", "pair_out": "strut pair, out",
    "pair_across": "strut pair, across", "pair_up": "strut pair, up", "spacing": "strut spacing",
    "half": "platform half", "tool_x": "tool x", "tool_y": "tool y",
    "tool_z": "tool z",
}  # fmt: skip


@dataclass(frozen=True)
class Number:
    """One number of the geometry, by how much it exceeds the described one.

    Attributes:
        kind: such as 'strut'.
        limb: that it is of, from 0; −1 for the platform's and the tool's.
        unit: m, rad, or none for a share.
        spread: standard deviation before any measurement.
    """

    kind: str
    limb: int
    unit: Unit
    spread: float

    @property
    def name(self) -> str:
        """Such as 'limb1.strut' or 'platform.half'."""
        if self.limb >= 0:
            return f"limb{self.limb + 1}.{self.kind}"
        return self.kind if self.kind in TOOL else f"platform.{self.kind}"


@dataclass(frozen=True, eq=False)
class TorqueRows:
    """What recordings say of a robot's numbers, whatever all else is.

    Attributes:
        source: files, for messages.
        A, b: A θ = b in units of the noise.
        grown: how many times larger the noise is than the recordings show.
        doubts: what checks of the recordings doubt.
    """

    source: str
    A: Float[np.ndarray, "rows numbers"]
    b: Float[np.ndarray, " rows"]
    grown: float = 1.0
    doubts: tuple[str, ...] = ()

    def with_noise(self, more: float) -> "TorqueRows":
        """The same with so many times the noise."""
        return replace(self, A=self.A / more, b=self.b / more, grown=self.grown * more)


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Numbers of a robot, and the free variables behind them.

        θ = G u,    u ~ N(0, 1) before any measurement

    Attributes:
        numbers: θ, all of the robot's.
        G: takes free variables to θ; numbers that are held have rows of zeros, shared ones alike
            rows.
        apart: whether both struts of a limb are modelled.
        torques: what recordings say of the numbers, if there are any.
    """

    numbers: tuple[Number, ...]
    G: Float[np.ndarray, "numbers free"]
    apart: bool
    torques: TorqueRows | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers."""
        return tuple(number.name for number in self.numbers)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Of the numbers, each once."""
        return tuple(dict.fromkeys(number.kind for number in self.numbers))

    def by_limb(self, values: Sequence[Any]) -> list[dict[str, Any]]:
        """Values of all numbers, by kind, limb after limb, and at last of platform and tool."""
        limbs = (*range(1 + max(number.limb for number in self.numbers)), -1)
        pairs = list(zip(self.numbers, values, strict=True))
        return [{x.kind: value for x, value in pairs if x.limb == limb} for limb in limbs]

    def of_kind(self, kind: str) -> list[int]:
        """Places of the numbers of a kind, limb by limb."""
        return [k for k, number in enumerate(self.numbers) if number.kind == kind]


def unknowns(
    robot: RobotDescription,
    *,
    apart: bool = False,
    length: float | None = None,
    angle: float | None = None,
    shared: Sequence[str] = (),
    held: Sequence[str] = (),
) -> Unknowns:
    """The numbers of a robot's geometry with what is known of them before.

    Args:
        robot: a Delta-like robot of limbs.
        apart: whether the two struts of each limb differ and the platform tilts.
        length: standard deviation of lengths before [m]; where None the description's tolerance
            if its file states one, else a millimetre.
        angle: the same of angles [rad].
        shared: kinds that are alike in all limbs, such as strut.
        held: kinds or names that are as described.

    Raises:
        DescriptionError: the robot has a mechanism of its own, or no pairs of struts to tell apart.
        UnknownNameError: a name to share or to hold is none of its numbers.
    """
    limbs = robot.limbs
    if limbs is None:
        raise DescriptionError(
            "has a mechanism of its own, whose lengths no calibration knows",
            where=robot.name,
            cure="describe it by limbs and platform",
        )
    if apart and (
        limbs.strut_spacing is None
        or limbs.count != 3
        or not isinstance(robot.platform, RigidPlatform)
    ):
        raise DescriptionError(
            "struts apart need three limbs, a rigid platform and strut_spacing",
            where=f"{robot.name}, limbs",
            cure="give limbs.strut_spacing, or calibrate with equal struts",
        )
    per_limb: dict[str, Unit] = ROTARY if limbs.drive == "rotary" else LINEAR
    per_limb = per_limb | APART if apart else per_limb
    listed: list[tuple[str, int, Unit]] = [
        (kind, i, unit) for i in range(limbs.count) for kind, unit in per_limb.items()
    ]
    if isinstance(robot.platform, H4Platform | Par4Platform):
        listed.append(("half", -1, "m"))
    if apart:
        listed.extend((kind, -1, unit) for kind, unit in TOOL.items())
    numbers = tuple(
        Number(kind, i, unit, _spread(robot, kind, i, unit, length, angle))
        for kind, i, unit in listed
    )
    return Unknowns(numbers, _free(numbers, shared, held, robot.name), apart)


def _spread(
    robot: RobotDescription,
    kind: str,
    limb: int,
    unit: Unit,
    length: float | None,
    angle: float | None,
) -> float:
    """Standard deviation before: given, stated by the description's file, or usual."""
    known = robot.tolerances
    stated = known.model_fields_set if "tolerances" in robot.model_fields_set else set[str]()
    if kind == "scale":
        return SCALE
    if kind == "zero" and "homing" in stated and (length if unit == "m" else angle) is None:
        return known.of_drive(robot.drives[limb])
    if unit == "rad":
        return ANGLE if angle is None else angle
    if length is None and "lengths" in stated:
        return known.of_length(_TOLERANCE.get(kind.partition("_")[0], kind.partition("_")[0]))
    return LENGTH if length is None else length


def _free(
    numbers: Sequence[Number], shared: Sequence[str], held: Sequence[str], where: str
) -> Float[np.ndarray, "numbers free"]:
    kinds = [number.kind for number in numbers]
    for names, known in ((shared, kinds), (held, [*kinds, *(n.name for n in numbers)])):
        for name in names:
            if name not in known:
                raise unknown(name, dict.fromkeys(known), "number", where)
    columns: dict[str, np.ndarray] = {}
    for k, number in enumerate(numbers):
        if number.kind in held or number.name in held or number.spread == 0:
            continue
        key = number.kind if number.kind in shared else number.name
        columns.setdefault(key, np.zeros(len(numbers)))[k] = number.spread
    if not columns:
        raise DescriptionError("nothing is left to estimate", where=where, cure="hold less")
    return np.column_stack(list(columns.values()))
