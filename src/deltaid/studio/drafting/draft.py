"""Drafts: a robot from a few numbers in a user's notation, each with its origin."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from deltaid.errors import DeltaidError, DescriptionError
from deltaid.robot.description import RobotDescription
from deltaid.robot.limits import Cylinder, DriveLimits
from deltaid.robot.platform import Par4Platform, RigidPlatform
from deltaid.studio.drafting.questions import (
    QUESTIONS,
    Question,
    platform_of,
    questions_of,
    rounded,
)
from deltaid.studio.folder import LONGEST

GIVEN, ASSUMED = "given", "assumed"
# The tool's drive is numbered after those of the three limbs.
_TOOL = "drive4"


@dataclass(frozen=True)
class Draft:
    """Input of a description.

    Attributes:
        kind: of robot, a key of `KINDS`.
        name, title: as in the description.
        values: numbers by the keys of the questions.
        origins: origin of each value: given, assumed, or the robot that it was taken from.
        offered: numbers of a robot to start from, which replace assumptions.
        source: that robot.
        reach: the workspace that the lengths allow, once it is computed: reach_radius, reach_low, …
    """

    kind: str
    name: str
    title: str
    values: Mapping[str, float] = field(default_factory=dict[str, float])
    origins: Mapping[str, str] = field(default_factory=dict[str, str])
    offered: Mapping[str, float] = field(default_factory=dict[str, float])
    source: str = ""
    reach: Mapping[str, float] = field(default_factory=dict[str, float])

    def answered(self, key: str, value: float, origin: str) -> "Draft":
        """The draft with one more answer."""
        values, origins = {**self.values, key: value}, {**self.origins, key: origin}
        return replace(self, values=values, origins=origins)

    def answered_in_words(
        self, texts: Mapping[str, str | None], named: Callable[[Question], str]
    ) -> "Draft":
        """The draft with answers in a user's notation.

        Args:
            texts: such as '235 mm' by the keys of the questions; None is no answer.
            named: name of a question in messages.

        Raises:
            DeltaidError: an answer is invalid, or this kind of robot lacks the question.
        """
        draft = self
        for question in QUESTIONS:
            text = texts.get(question.key)
            if text is None:
                continue
            if self.kind not in question.of:
                raise DeltaidError(
                    f"{self.kind} has none ({question.text})",
                    where=f"{named(question)} {text}",
                    cure="leave it out, or choose another --kind",
                )
            draft = draft.answered(
                question.key, read_answer(question, text, named(question)), GIVEN
            )
        return draft

    def offer(self, question: Question) -> tuple[float, str] | None:
        """Offered or assumed value with its origin; None if neither exists."""
        if question.key in self.offered:
            return self.offered[question.key], f"from {self.source}"
        if question.assumed is None:
            return None
        guess = question.assumed(self.kind, {**self.values, **self.reach})
        return min(max(guess, question.low), question.high), ASSUMED

    def completed(self) -> "Draft":
        """The draft with offered or assumed values of all missing numbers.

        Raises:
            DeltaidError: a number without a default is missing.
        """
        self.require_known()
        draft = self
        for question in questions_of(self.kind):
            if question.key not in draft.values and (offer := draft.offer(question)) is not None:
                draft = draft.answered(question.key, *offer)
        return draft

    def require_known(self) -> None:
        """Refuse a draft that lacks a number without a default.

        Raises:
            DeltaidError: a number is missing; with the options that give it.
        """
        missing = [
            question.option
            for question in questions_of(self.kind)
            if question.assumed is None and question.key not in {**self.values, **self.offered}
        ]
        if missing:
            raise DeltaidError(
                f"a {self.kind} needs {', '.join(missing)}: nobody can guess "
                f"{'it' if len(missing) == 1 else 'them'}",
                where=f"--kind {self.kind}",
                cure="give them as options such as --strut 235mm, or run the command in a "
                "terminal, where it asks; --from NAME starts from a robot of the catalogue",
            )


# A number, then names of units with small powers, products and quotients; other text is never
# evaluated.
_GRAMMAR = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,2})?)\s*([A-Za-zµμ°²³^*/·\d\s]*)")
# Examples of numbers with units, for messages.
_EXAMPLES = {
    "m": "200 mm or 0.2 (m)",
    "kg": "800 g or 0.8 (kg)",
    "degree": "30° or 30 (degrees)",
    "degree/s": "400 rpm or 2400 (degrees/s)",
    "m/s": "2.5 m/s or 2.5",
    "kg*m**2": "12 kg cm² or 0.0012 (kg m²)",
    "N*m": "80 N m or 80",
    "N": "600 N or 600",
}


def read_answer(question: Question, text: str, where: str) -> float:
    """The number of an answer; `where` is its name in messages.

    Raises:
        DeltaidError: it is no number with a suitable unit, or is outside the possible range.
    """
    return question.require(quantity(text, question.unit, where), where)


def quantity(text: str, unit: str, where: str = "the answer") -> float:
    """A number in `unit`, which is also the unit of a plain number. `where` is its name in
    messages.

    Raises:
        DeltaidError: it is no number, or its unit is unsuitable.
    """
    import pint

    text, example = text.strip(), _EXAMPLES.get(unit, f"a number in {unit}")
    match = _GRAMMAR.fullmatch(text) if len(text) <= LONGEST else None
    if match is None:
        comma = ", with a point and no comma" if "," in text else ""
        raise DeltaidError(
            f"{text[:LONGEST]!r} is not a number{comma}", where=where, cure=f"write {example}"
        )
    number, words = float(match[1]), match[2].strip()
    if not words:
        return number
    for sign, name in (("°", "degree"), ("·", "*"), ("²", "**2"), ("³", "**3"), ("^", "**")):
        words = words.replace(sign, name)
    words = re.sub(r"(?<=[A-Za-z])([23])\b", r"**\1", words)  # cm2, typed without ²
    # Spaces between names are products.
    words = re.sub(r"(?<=[A-Za-zµμ\d])\s+(?=[A-Za-zµμ])", "*", words)
    try:
        value = _registry().Quantity(number, _registry().parse_units(words)).m_as(unit)
        return rounded(float(value), 12)  # without the conversion's rounding
    except (pint.PintError, ValueError, TypeError, AttributeError):
        raise DeltaidError(
            f"{match[2].strip()!r} is no unit for this",
            where=where,
            cure=f"write {example}",
        ) from None


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


def kind_of(robot: RobotDescription) -> str:
    """Kind of a robot, a key of `KINDS`.

    Raises:
        DescriptionError: it is of another kind.
    """
    if robot.limbs is None:
        raise DescriptionError(
            "has a mechanism of its own, which no questions are asked for",
            where=robot.name,
            cure="`deltaid robots` lists those to start from",
        )
    linear = robot.limbs.drive == "linear"
    if robot.platform.kind != "rigid":
        return f"{robot.platform.kind}{'-linear' if linear else ''}"
    if robot.telescope is not None:
        return "delta-4"
    return "linear-delta" if linear else "delta"


# Bodies of each platform with their numbers.
_PARTS = {
    "rigid": {"P": 1}, "h4": {"SB": 2, "MB": 1}, "i4": {"HP": 2}, "par4": {"MP": 2, "R": 2},
}  # fmt: skip


def answers(robot: RobotDescription) -> dict[str, float]:
    """Answers to the questions of its kind that describe a robot.

    Motors are those of the first drive, related to the joint, so their gear is 1; arms and
    carriages have different questions about them.

    Raises:
        DescriptionError: there are no questions for the robot's kind.
    """
    kind, limb, platform = kind_of(robot), robot.limb_geometry[0], robot.platform
    tilt = robot.limbs.tilt_deg if robot.limbs else 0.0
    mass = {name: float(body.prior_parameters()[0]) for name, body in robot.bodies.items()}
    driven, strut = robot.limb_bodies(0)
    inertia, law = robot.rotor_inertia.get("drive1"), robot.friction.get("drive1")
    limits, turning = (robot.drive_limits.get(name, DriveLimits()) for name in ("drive1", _TOOL))
    values: dict[str, float | None] = {
        "arm": limb.upper_arm,
        "strut": limb.strut,
        "base_radius": float(np.linalg.norm(limb.base)),
        "platform_radius": float(np.linalg.norm(limb.attachment)),
        "tilt": tilt[0] if isinstance(tilt, tuple) else tilt,
        "spacing": limb.spacing,
        "swing": robot.strut_swing_deg,
        "top_speed": robot.platform_speed,
        "top_acceleration": robot.platform_acceleration,
        "carriage_mass": mass[driven],
        "arm_mass": mass[driven],
        "strut_mass": mass[strut],
        "platform_mass": sum(n * mass[part] for part, n in _PARTS[platform_of(kind)].items()),
        "tool_mass": mass.get("EE"),
        "telescope_mass": mass.get("TU", 0.0) + mass.get("TL", 0.0),
        "gear": 1.0,
        "rotor": inertia,
        "rotor_mass": inertia,
        "coulomb": law and law.coulomb,
        "rail_coulomb": law and law.coulomb,
        "viscous": law and law.viscous,
        "rail_viscous": law and law.viscous,
        **dict(zip(("rail_low", "rail_high"), limits.position or (), strict=False)),
        **dict(zip(("angle_low", "angle_high"), limits.angle_deg or (), strict=False)),
        "rail_speed": limits.speed,
        "speed": limits.speed_deg_s,
        "rail_force": limits.effort,
        "torque": limits.effort,
        "tool_speed": turning.speed_deg_s,
        "tool_torque": turning.torque,
        "tool_rotor": robot.rotor_inertia.get(_TOOL),
    }
    if isinstance(robot.workspace, Cylinder):
        radius, (low, high) = robot.workspace.radius, robot.workspace.z
        values |= {"radius": radius, "low": low, "high": high}
    if not isinstance(platform, RigidPlatform):
        values |= {
            "bar": platform.length if isinstance(platform, Par4Platform) else platform.arm,
            "ratio": abs(platform.ratio),
            "pinion": 0.5 / abs(platform.ratio),
            "tool_turn": max(abs(angle) for angle in platform.angle_deg),
            "tool_speed": platform.speed_deg_s,
        }
    # The questions of its kind need only some of these values.
    numbers = {question.key: values.get(question.key) for question in questions_of(kind)}
    return {key: rounded(value, 12) for key, value in numbers.items() if value is not None}
