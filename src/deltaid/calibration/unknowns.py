"""Dimensions of a robot that calibration may change.

A rotary limb has eight: position of its base joint relative to its platform joint (3; only their
difference enters the closed loops), direction of its motor axis (2), upper arm, zero, strut. A limb
on a rail has seven: position across the rail (2), direction of the rail (2), zero, scale of the
drive, strut. H4 and Par4 also have the length of their middle. With separate struts, so that the
platform may tilt, a limb has five more and the tool three. A robot file holds some of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from deltaid.errors import DescriptionError, unknown
from deltaid.model.verdict import listed
from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import Limbs
from deltaid.robot.mounting import DRIVES, RAILS, Kinds, Unit, leans, remounted
from deltaid.robot.platform import H4Platform, Par4Platform, RigidPlatform
from deltaid.robot.tolerances import LENGTHS, Tolerances

# Default tolerances of a printer or prototype, one standard deviation: a millimetre, a milliradian,
# a thousandth of a belt's pitch.
TOLERANCE = 1e-3

# Unit and name of each kind.
ROTARY: Kinds = {
    **DRIVES, "upper_arm": ("m", "upper arm"), "zero": ("rad", "zero"), "strut": ("m", "strut")
}  # fmt: skip
LINEAR: Kinds = {
    **RAILS, "zero": ("m", "zero"), "scale": ("", "drive scale"), "strut": ("m", "strut")
}  # fmt: skip
# Numbers of a limb with two modelled struts: difference of their lengths; distance at the elbow
# minus distance at the platform along x, y, z of the limb's frame; their distance.
APART: Kinds = {
    "strut_difference": ("m", "strut difference"), "pair_out": ("m", "strut pair, out"),
    "pair_across": ("m", "strut pair, across"), "pair_up": ("m", "strut pair, up"),
    "spacing": ("m", "strut spacing"),
}  # fmt: skip
TOOL: Kinds = {f"tool_{axis}": ("m", f"tool {axis}") for axis in "xyz"}
_HALF: Kinds = {"half": ("m", "platform half")}
WORDS = {kind: words for kind, (_, words) in (ROTARY | LINEAR | APART | TOOL | _HALF).items()}
# Kind of length of the description that gives the tolerance, by the first word.
_TOLERANCE = {"base": "base_radius", "rail": "base_radius", "upper": "upper_arm",
              "half": "platform"}  # fmt: skip


@dataclass(frozen=True)
class Number:
    """A dimension's deviation from the description: its kind, its limb from 0 (−1 for platform and
    tool), its unit, and its prior standard deviation."""

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
    """Rows A θ = b of recordings on a robot's numbers, with all other causes profiled out, in units
    of a noise `grown` times the observed one; their files, and doubts of the checks."""

    source: str
    A: Float[np.ndarray, "rows numbers"]
    b: Float[np.ndarray, " rows"]
    grown: float = 1.0
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Numbers of a robot, and the free variables behind them.

        θ = G u,    u ~ N(0, 1) before any measurement

    Held numbers have rows of zeros in G, shared ones equal rows. `apart` is whether both struts of
    a limb are modelled, and `torques` are rows of recordings, if any.
    """

    numbers: tuple[Number, ...]
    G: Float[np.ndarray, "numbers free"]
    apart: bool
    torques: TorqueRows | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(number.name for number in self.numbers)

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(number.kind for number in self.numbers))

    def by_limb(self, values: Sequence[Any]) -> list[dict[str, Any]]:
        """Values of all numbers by kind, one dictionary a limb, then one for platform and tool."""
        limbs = (*range(1 + max(number.limb for number in self.numbers)), -1)
        pairs = list(zip(self.numbers, values, strict=True))
        return [{x.kind: value for x, value in pairs if x.limb == limb} for limb in limbs]

    def of_kind(self, kind: str) -> list[int]:
        """Indices of the numbers of a kind, limb by limb."""
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
    """Numbers of a robot's geometry with their priors, as for `calibrate`. Raises a
    DescriptionError where the robot has a mechanism of its own or no separate struts, an
    UnknownNameError for an unknown name to share or to hold."""
    limbs = _required_limbs(robot, apart)
    per_limb = (ROTARY if limbs.drive == "rotary" else LINEAR) | (APART if apart else {})
    once = _HALF if isinstance(robot.platform, H4Platform | Par4Platform) else {}
    once |= TOOL if apart else {}
    numbers = [
        Number(kind, i, unit, _spread(robot, kind, i, unit, length, angle))
        for i in (*range(limbs.count), -1)
        for kind, (unit, _) in (once if i < 0 else per_limb).items()
    ]
    kinds, names = [x.kind for x in numbers], [x.name for x in numbers]
    for asked, known in ((shared, kinds), (held, kinds + names)):
        for name in asked:
            if name not in known:
                raise unknown(name, dict.fromkeys(known), "number", robot.name)
    free = [x for x in numbers if x.spread and x.kind not in held and x.name not in held]
    keys = {x.name: x.kind if x.kind in shared else x.name for x in free}
    if not keys:
        raise DescriptionError("nothing is left to estimate", where=robot.name, cure="hold less")
    columns = dict.fromkeys(keys.values())
    return Unknowns(
        numbers=tuple(numbers),
        G=np.array(
            [[x.spread * (keys.get(x.name) == column) for column in columns] for x in numbers]
        ),
        apart=apart,
    )


def _required_limbs(robot: RobotDescription, apart: bool) -> Limbs:
    limbs = robot.limbs
    if limbs is None:
        raise DescriptionError(
            "has a mechanism of its own, whose lengths no calibration knows",
            where=robot.name,
            cure="describe it by limbs and platform",
        )
    pairs = limbs.strut_spacing is not None and limbs.count == 3
    if apart and not (pairs and isinstance(robot.platform, RigidPlatform)):
        raise DescriptionError(
            "struts apart need three limbs, a rigid platform and strut_spacing",
            where=f"{robot.name}, limbs",
            cure="give limbs.strut_spacing, or calibrate with equal struts",
        )
    return limbs


def _spread(
    robot: RobotDescription, kind: str, limb: int, unit: Unit,
    length: float | None, angle: float | None,
) -> float:  # fmt: skip
    """Prior standard deviation: given, stated by the description, or the default."""
    known, given = robot.tolerances, length if unit == "m" else angle
    stated = known.model_fields_set if "tolerances" in robot.model_fields_set else set[str]()
    if kind != "scale" and given is not None:
        return given
    if kind == "zero" and "homing" in stated:
        return known.of_drive(robot.drives[limb])
    if unit == "m" and "lengths" in stated:
        return known.of_length(_length_kind(kind))
    return TOLERANCE


def _length_kind(kind: str) -> str:
    first = kind.partition("_")[0]
    return _TOLERANCE.get(first, first)


def calibrated_robot(
    robot: RobotDescription,
    known: Unknowns,
    theta: Float[np.ndarray, " numbers"],
    std: Float[np.ndarray, " numbers"],
) -> tuple[RobotDescription, dict[str, float], dict[str, float], Bool[np.ndarray, " numbers"]]:
    """The robot with estimated numbers and their standard deviations as tolerances; zeros of rotary
    drives [rad] and scales of drives, which no key holds; which numbers the robot holds.

    Base joints take the difference between base and platform.
    """
    limbs, platform = robot.limbs, robot.platform
    assert limbs is not None  # `unknowns` refuses others
    *each, more = known.by_limb(theta.tolist())
    half, upright = more.get("half", 0.0), not leans(limbs.geometry()[0])
    unheld = (*APART, *TOOL, *(("lean_across",) if upright else ()))
    if isinstance(platform, H4Platform):
        platform = platform.changed(half_length=platform.half_length + half)
    elif isinstance(platform, Par4Platform):
        platform = platform.changed(length=platform.length + 2 * half)
    lacking = "zero" if limbs.drive == "rotary" else "scale"
    by_drive = {f"drive{i + 1}": numbers[lacking] for i, numbers in enumerate(each)}
    zeros, scales = (by_drive, {}) if lacking == "zero" else ({}, by_drive)
    said = f"; this file holds {none}" if (none := unwritten(zeros, scales)) else ""
    sources = {k: v for k, v in robot.sources.items() if not k.startswith("limbs.")}
    return (
        robot.changed(
            limbs=limbs.changed(**_changed(limbs, each)),
            platform=platform,
            tolerances=_tolerances(robot, known, std),
            sources=sources | {"limbs": f"deltaid calibrate{said}"},
        ),
        zeros,
        scales,
        np.array([x.kind not in unheld for x in known.numbers]),
    )


def unwritten(zeros: dict[str, float], scales: dict[str, float]) -> str:
    """Zeros of rotary drives or scales of rails in words, because a robot file does not hold them;
    empty where all are zero."""
    if any(zeros.values()):
        each = ", ".join(f"{drive} {-value:.6f}" for drive, value in zeros.items())
        return f"no zeros; as zero of each drive in a log's mapping, rad: {each}"
    if any(scales.values()):
        each = ", ".join(f"{drive} {value:+.6f}" for drive, value in scales.items())
        return f"no drive scales; shares that drives move more than recorded: {each}"
    return ""


def in_words(known: Unknowns, theta: Float[np.ndarray, " numbers"]) -> str:
    """Kinds of the numbers that are not zero, such as 'rail lean aside and struts apart'."""
    kinds = (known.numbers[k].kind for k in np.flatnonzero(theta))
    apart = dict.fromkeys((*APART, *TOOL), "struts apart")
    return listed([*dict.fromkeys((WORDS | apart)[kind] for kind in kinds)])


def _changed(limbs: Limbs, each: Sequence[dict[str, float]]) -> dict[str, object]:
    changed, geometry = remounted(limbs, each), limbs.geometry()
    for kind in ("strut", "upper_arm") if limbs.drive == "rotary" else ("strut",):
        changed[kind] = tuple(
            getattr(limb, kind) + x[kind] for limb, x in zip(geometry, each, strict=True)
        )
    return changed


def _tolerances(
    robot: RobotDescription, known: Unknowns, std: Float[np.ndarray, " numbers"]
) -> Tolerances:
    """The largest standard deviation of each kind of length, and of each drive's zero."""
    pairs, stated = list(zip(known.numbers, std.tolist(), strict=True)), robot.tolerances
    lengths = {
        name: max(
            (s for x, s in pairs if _length_kind(x.kind) == name), default=stated.of_length(name)
        )
        for name in LENGTHS
    }
    lengths["platform_radius"] = lengths["base_radius"]
    homing = {drive: stated.of_drive(drive) for drive in robot.drives}
    homing |= {f"drive{x.limb + 1}": s for x, s in pairs if x.kind == "zero"}
    return stated.changed(lengths=lengths, homing=homing)
