"""What a new robot is asked for, in order, each with what is assumed when nobody knows it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from deltaid.errors import DeltaidError

Kind = Literal[
    "delta", "delta-4", "h4", "i4", "par4", "linear-delta", "h4-linear", "i4-linear", "par4-linear"
]
KINDS: dict[str, str] = {
    "delta": "Delta with three arms on motors, 3 axes",
    "delta-4": "the same with a telescope bar that turns the tool, 4 axes",
    "h4": "H4: four arms, side bars on a middle bar, 4 axes",
    "i4": "I4: four arms, two half platforms on a slide, 4 axes",
    "par4": "Par4 (Quattro): four arms, a platform of four bars, 4 axes",
    "linear-delta": "Delta with three carriages on rails, 3 axes",
    "h4-linear": "H4 on rails",
    "i4-linear": "I4 on rails",
    "par4-linear": "Par4 on rails",
}
Answers = Mapping[str, float]
_GRAVITY = 9.81
# Acceleration that assumed motors are strong enough for [m/s²].
ACCELERATION = 40.0


def is_linear(kind: str) -> bool:
    """Whether carriages drive it."""
    return "linear" in kind


def platform_of(kind: str) -> str:
    """Kind of platform: rigid, h4, i4 or par4."""
    head = kind.split("-")[0]
    return head if head in ("h4", "i4", "par4") else "rigid"


def limbs_of(kind: str) -> int:
    """Three or four."""
    return 3 if platform_of(kind) == "rigid" else 4


def turns(kind: str) -> bool:
    """Whether it turns a tool."""
    return kind == "delta-4" or platform_of(kind) != "rigid"


@dataclass(frozen=True)
class Question:
    """One number.

    Attributes:
        key: its name among the answers, and of its option with dashes.
        text: what it is.
        unit: as pint writes it; empty for a plain number.
        low, high: what a machine may have.
        how: how to find it out.
        of: whether a kind of robot has it.
        assumed: from kind and what was answered before; None where nobody can guess it.
    """

    key: str
    text: str
    unit: str
    low: float
    high: float
    how: str
    of: Callable[[str], bool]
    assumed: Callable[[str, Answers], float] | None = None

    def require(self, value: float) -> float:
        """The value, if a machine can have it.

        Raises:
            DeltaidError: it cannot be.
        """
        if not self.low <= value <= self.high:
            unit = self.unit.replace("**2", "²").replace("*", " ")
            raise DeltaidError(
                f"{self.text}: {value:g} {unit} cannot be; it lies between {self.low:g} and "
                f"{self.high:g} {unit}"
            )
        return value


def _all(_: str) -> bool:
    return True


def _rotary(kind: str) -> bool:
    return not is_linear(kind)


def _linked(kind: str) -> bool:
    return platform_of(kind) in ("h4", "par4")


def _round(value: float, digits: int = 2) -> float:
    return float(f"{value:.{digits}g}")


def moved(kind: str, a: Answers) -> float:
    """Mass that one drive lifts: its share of platform and tool, and its struts [kg]."""
    platform = a["platform_mass"] + a.get("tool_mass", 0.0)
    return platform / limbs_of(kind) + 2 * a["strut_mass"]


def _torque(kind: str, a: Answers) -> float:
    mass = moved(kind, a)
    if is_linear(kind):
        return _round(2 * (mass + a["carriage_mass"]) * (_GRAVITY + ACCELERATION))
    inertia = mass * a["arm"] + 0.4 * a["arm_mass"] * a["arm"]
    return _round(2 * inertia * (_GRAVITY + ACCELERATION))


_CALIPER = "drawing, or a caliper between the centres of the joints"
_SCALE = "a kitchen scale, or CAD"
GEOMETRY = ("arm", "strut", "base_radius", "platform_radius")

QUESTIONS: tuple[Question, ...] = (
    Question("arm", "arm, from motor axis to elbow", "m", 0.01, 5, _CALIPER, _rotary),
    Question("strut", "strut, between its joints", "m", 0.02, 10, _CALIPER, _all),
    Question("base_radius", "from the middle of the base to a motor axis, or to a rail's zero",
             "m", 0, 5, "drawing, or half of the largest distance", _all),
    Question("platform_radius", "from the middle of the platform to the struts' joints", "m", 0, 2,
             _CALIPER, lambda k: platform_of(k) != "h4"),
    Question("tilt", "lean of the rails, lower end outwards; 0 upright, 90 flat", "degree", -90,
             90, "drawing, or a phone's spirit level", is_linear, lambda k, a: 0.0),
    Question("travel", "travel of a carriage", "m", 0.01, 20, "data sheet, or measure from stop to "
             "stop", is_linear, lambda k, a: _round(a["strut"])),
    Question("link", "length of the platform's turning bar: middle to end (H4), rod (Par4)", "m",
             0.005, 1, _CALIPER, _linked, lambda k, a: _round(a["strut"] / (10 if k[0] == "h" else 7))),
    Question("spacing", "distance of the two struts of a limb", "m", 0.001, 2, _CALIPER, _all,
             lambda k, a: _round(0.1 * a["strut"])),
    Question("arm_mass", "mass of one arm", "kg", 1e-3, 500, _SCALE + "; with the elbow's joints",
             _rotary, lambda k, a: _round(1.5 * a["arm"])),
    Question("carriage_mass", "mass of one carriage with what moves of its motor", "kg", 1e-3, 2000,
             _SCALE, is_linear, lambda k, a: 2.0),
    Question("strut_mass", "mass of one strut of the two, with its joints", "kg", 1e-4, 200, _SCALE,
             _all, lambda k, a: _round(0.04 + 0.1 * a["strut"])),
    Question("platform_mass", "mass of the platform with all that does not turn", "kg", 1e-3, 500,
             _SCALE, _all, lambda k, a: _round(max(0.1, 0.6 * a["strut"]))),
    Question("tool_mass", "mass of the tool and what turns with it", "kg", 1e-3, 500, _SCALE,
             turns, lambda k, a: _round(max(0.05, 0.2 * a["strut"]))),
    Question("torque", "largest torque of a motor behind its gear (of a rail: force)", "N*m", 1e-3,
             1e6, "data sheet: peak torque times gear ratio", _all, _torque),
    Question("speed", "largest speed of a motor behind its gear", "degree/s", 1, 1e5,
             "data sheet: speed divided by gear ratio", _rotary, lambda k, a: 600.0),
    Question("speed", "largest speed of a carriage", "m/s", 1e-3, 100, "data sheet", is_linear,
             lambda k, a: 3.0),
    Question("rotor", "inertia of rotor and gear, seen from the arm", "kg*m**2", 1e-9, 1e4,
             "data sheet: (rotor + gear) times the square of the gear ratio", _rotary,
             lambda k, a: _round(0.3 * moved(k, a) * a["arm"] ** 2)),
)  # fmt: skip


def asked(kind: str) -> list[Question]:
    """What a kind of robot is asked for."""
    return [question for question in QUESTIONS if question.of(kind)]


def unit_of(question: Question, kind: str) -> str:
    """A rail has forces."""
    return "N" if question.key == "torque" and is_linear(kind) else question.unit
