"""Questions about a new robot, in order, with their default answers.

Imports nothing slow, because `deltaid new` builds its help from this module.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from deltaid.errors import DeltaidError
from deltaid.levels import GRAVITY

Answers = Mapping[str, float]
Group = Literal["lengths", "masses", "motors", "tool", "friction", "workspace"]
# Units in pint's notation, and as people write them.
_WORDS = {
    "": "", "m": "m", "kg": "kg", "degree": "°", "degree/s": "°/s", "m/s": "m/s", "m/s**2": "m/s²",
    "kg*m**2": "kg m²", "N*m": "N m", "N": "N", "N*m*s/rad": "N m s/rad", "N*s/m": "N s/m",
}  # fmt: skip


KINDS: dict[str, str] = {
    "delta": "Delta with three arms on motors, 3 axes",
    "delta-4": "Delta with three arms and a telescope bar that turns the tool, 4 axes",
    "h4": "H4: four arms, two side bars on a middle bar that turns, 4 axes",
    "i4": "I4: four arms, two half platforms on a slide, 4 axes",
    "par4": "Par4 (Quattro): four arms, a platform of four bars, 4 axes",
    "linear-delta": "Delta with three carriages on rails, 3 axes",
    "h4-linear": "H4 on rails, 4 axes",
    "i4-linear": "I4 on rails, 4 axes",
    "par4-linear": "Par4 on rails, 4 axes",
}


def platform_of(kind: str) -> str:
    """Kind of platform: rigid, h4, i4 or par4."""
    head = kind.split("-")[0]
    return head if head in ("h4", "i4", "par4") else "rigid"


def limbs_of(kind: str) -> int:
    """Number of limbs, three or four."""
    return 3 if platform_of(kind) == "rigid" else 4


ALL = frozenset(KINDS)
# Kinds with carriages on rails, and kinds with arms on motors.
LINEAR = frozenset(kind for kind in KINDS if "linear" in kind)
ROTARY = ALL - LINEAR
# Kinds with a turning tool, by their platform or by a telescopic bar.
ARTICULATED = frozenset(kind for kind in KINDS if platform_of(kind) != "rigid")
TELESCOPE = frozenset({"delta-4"})
TURNING = ARTICULATED | TELESCOPE
# Kinds with a bar that turns within the platform, and with two sliding half platforms.
BAR = frozenset(kind for kind in KINDS if platform_of(kind) in ("h4", "par4"))
SLIDE = ARTICULATED - BAR
# Kinds with all limbs on circles of base and platform, and the other ones.
ROUND = frozenset(kind for kind in KINDS if platform_of(kind) != "h4")
H4 = ALL - ROUND


@dataclass(frozen=True)
class Question:
    """A question for a number.

    Attributes:
        key: its name among the answers; with dashes, the name of its option.
        text: the quantity in words.
        unit: in pint's notation; empty for a plain number.
        low, high: range of possible values.
        how: where to find the number.
        of: kinds of robots that have it.
        assumed: default from kind and earlier answers; None if there is none.
        group: of questions that are asked together.
    """

    key: str
    text: str
    unit: str
    low: int | float
    high: int | float
    how: str
    of: frozenset[str]
    assumed: Callable[[str, Answers], float] | None
    group: Group

    @property
    def option(self) -> str:
        """Its option on the command line."""
        return "--" + self.key.replace("_", "-")

    @property
    def shown_unit(self) -> str:
        """Its unit as people write it."""
        return _WORDS[self.unit]

    @property
    def label(self) -> str:
        """Its text with the unit."""
        return f"{self.text} [{self.shown_unit}]" if self.unit else self.text

    def require(self, value: float, where: str = "") -> float:
        """The value, if it is in the possible range; `where` is its name in messages, by default
        the option.

        Raises:
            DeltaidError: it is outside.
        """
        if not self.low <= value <= self.high:
            unit, small = f" {self.shown_unit}".rstrip(), {"m": "mm", "kg": "g"}.get(self.unit)
            fits = small and self.low <= value / 1000 <= self.high
            raise DeltaidError(
                f"{value:g}{unit} is outside {self.low:g} … {self.high:g}{unit}: {self.text}",
                where=where or self.option,
                cure=f"is it {value:g} {small}? write the unit" if fits else "",
            )
        return value


# Platform acceleration that assumed motors reach [m/s²], and their strength as a multiple of what
# one limb needs for it.
_ACCELERATION, _MORE = 40.0, 2.0
_UPWARDS = _MORE * (GRAVITY + _ACCELERATION)
# Density of the heaviest part: its mass over the cube of arm and strut [kg/m³], a tenth of a solid
# block's.
_HEAVIEST = 15.0
# Largest assumed speed and acceleration of a platform [m/s, m/s²].
_FASTEST, _HARDEST = 5.0, 60.0


def rounded(value: float, digits: int = 2) -> float:
    """A number with this many significant digits: few of an assumption; with 12 of them a product
    has no rounding errors in its last bits, and 0.4 times 3 is 1.2."""
    return float(f"{value:.{digits}g}")


def lifted(kind: str, a: Answers) -> float:
    """Mass that one drive moves: its share of platform, tool and telescope, and its struts [kg]."""
    shared = sum(a.get(key, 0.0) for key in ("platform_mass", "tool_mass", "telescope_mass"))
    return shared / limbs_of(kind) + 2 * a["strut_mass"]


def _mass(a: Answers, typical: float) -> float:
    size = a["strut"] + a.get("arm", 0.0)
    return rounded(min(typical, _HEAVIEST * size**3))


def _top_speed(kind: str, a: Answers) -> float:
    """Half of the speed of the driven ends at the drives' top speed [m/s]."""
    if kind in LINEAR:
        return rounded(min(_FASTEST, 0.5 * a["rail_speed"]))
    return rounded(min(_FASTEST, 0.5 * math.radians(a["speed"]) / a["gear"] * a["arm"]))


def _top_acceleration(kind: str, a: Answers) -> float:
    """Half of one motor's acceleration beyond gravity, because motors work together [m/s²]."""
    if kind in LINEAR:
        most = a["rail_force"] / (lifted(kind, a) + a["carriage_mass"] + a["rotor_mass"])
    else:
        inertia = a["rotor"] * a["gear"] ** 2 / a["arm"]
        most = a["torque"] * a["gear"] / (_moment(kind, a) + inertia)
    return rounded(min(max(0.5 * (most - GRAVITY), 1.0), _HARDEST))


def _moment(kind: str, a: Answers) -> float:
    return (lifted(kind, a) + 0.4 * a["arm_mass"]) * a["arm"]


def _constant(value: float) -> Callable[[str, Answers], float]:
    return lambda kind, a: value


_CALIPER = "drawing, or a caliper between the centres of the joints"
_SCALE = "a kitchen scale, or CAD"
_SHEET = "data sheet"
_TRY = "push it by hand, or leave it: a recording determines it"
_FOUND = "what these lengths and ends reach"

QUESTIONS: tuple[Question, ...] = (
    Question("arm", "length of the arms, from motor axis to elbow", "m", 0.01, 5, _CALIPER,
             ROTARY, None, "lengths"),
    Question("strut", "length of the struts, between their joints", "m", 0.02, 10, _CALIPER, ALL,
             None, "lengths"),
    Question("base_radius", "from the middle of the base to a motor axis, or to a rail's zero",
             "m", 1e-3, 5, "drawing, or half of the largest distance", ALL, None, "lengths"),
    Question("platform_radius", "from the middle of the platform to the struts' joints", "m", 1e-3,
             2, _CALIPER, ROUND, None, "lengths"),
    Question("tilt", "lean of the rails; 0 upright, 90 flat, negative if lower ends lean "
             "inwards", "degree", -90, 90, "drawing, or a phone's spirit level", LINEAR,
             _constant(0.0), "lengths"),
    Question("bar", "platform's turning bar: middle to end (H4), length of a rod (Par4)", "m",
             0.002, 1, _CALIPER, BAR,
             lambda kind, a: rounded(a["strut"] / (8 if platform_of(kind) == "h4" else 7)),
             "lengths"),
    Question("spacing", "distance of the two struts of a limb", "m", 0.001, 2, _CALIPER, ALL,
             lambda kind, a: rounded(0.1 * a["strut"]), "lengths"),
    Question("swing", "largest angle of the ball joints between strut and the plane of the arm",
             "degree", 5, 85, _SHEET + " of the joints", ALL, _constant(40.0), "lengths"),
    Question("angle_low", "lowest angle of the arms, upwards from horizontal", "degree", -180, 90,
             "swing it by hand to its stop", ROTARY, _constant(-50.0), "lengths"),
    Question("angle_high", "highest angle of the arms, downwards from horizontal", "degree", -90,
             180, "swing it by hand to its stop", ROTARY, _constant(90.0), "lengths"),
    Question("rail_low", "upper end of a carriage's travel, from the rail's zero", "m", -20, 20,
             "measure from stop to stop", LINEAR, _constant(0.0), "lengths"),
    Question("rail_high", "lower end of a carriage's travel, from the rail's zero", "m", -20, 20,
             "measure from stop to stop", LINEAR,
             lambda kind, a: rounded(a["strut"] + a["rail_low"]), "lengths"),
    Question("arm_mass", "mass of one arm, with the elbow's joints", "kg", 1e-3, 500, _SCALE,
             ROTARY, lambda kind, a: _mass(a, 1.5 * a["arm"]), "masses"),
    Question("carriage_mass", "mass of one carriage", "kg", 1e-3, 2000, _SCALE, LINEAR,
             lambda kind, a: _mass(a, 2.0 * a["strut"]), "masses"),
    Question("strut_mass", "mass of one strut of the two, with its joints", "kg", 1e-4, 200, _SCALE,
             ALL, lambda kind, a: _mass(a, 0.15 * a["strut"]), "masses"),
    Question("platform_mass", "mass of the platform, with all that does not turn", "kg", 1e-3, 500,
             _SCALE, ALL, lambda kind, a: _mass(a, 0.8 * a["strut"]), "masses"),
    Question("tool_mass", "mass of the tool, and what turns with it", "kg", 1e-3, 500, _SCALE,
             TURNING, lambda kind, a: _mass(a, 0.3 * a["strut"]), "masses"),
    Question("telescope_mass", "mass of the telescope's two tubes together", "kg", 1e-3, 500,
             _SCALE, TELESCOPE, lambda kind, a: _mass(a, a["strut"]), "masses"),
    Question("gear", "gear ratio of the motors; 1 if what follows is behind the gear", "", 0.01,
             1000, _SHEET, ROTARY, _constant(1.0), "motors"),
    Question("torque", "largest torque of a motor, before its gear", "N*m", 1e-5, 1e6,
             _SHEET + ": peak torque", ROTARY,
             # Lifts and accelerates the arm, and the load at the elbow.
             lambda kind, a: rounded(_UPWARDS * _moment(kind, a) / a["gear"]), "motors"),
    Question("rail_force", "largest force that drives a carriage", "N", 1e-3, 1e6,
             _SHEET + ": torque times 2π, by the lead of a spindle or the travel of a belt a turn",
             LINEAR,
             lambda kind, a: rounded(_UPWARDS * (lifted(kind, a) + a["carriage_mass"])), "motors"),
    Question("speed", "largest speed of a motor, before its gear", "degree/s", 1, 1e6, _SHEET,
             ROTARY, lambda kind, a: rounded(600.0 * a["gear"]), "motors"),
    Question("rail_speed", "largest speed of a carriage", "m/s", 1e-3, 100, _SHEET, LINEAR,
             _constant(3.0), "motors"),
    Question("rotor", "inertia of a motor's rotor and what turns with it, before the gear",
             "kg*m**2", 1e-12, 1e4, _SHEET, ROTARY,
             # A third of the load's inertia about the arm's axis, at the motor.
             lambda kind, a: rounded(0.3 * lifted(kind, a) * (a["arm"] / a["gear"]) ** 2),
             "motors"),
    Question("rotor_mass", "inertia of motor, spindle or belt, as a mass at the carriage", "kg",
             1e-6, 1e4, _SHEET + ": inertia times (2π / lead)²", LINEAR,
             lambda kind, a: rounded(0.5 * a["carriage_mass"]), "motors"),
    Question("ratio", "turns of the tool for a turn of the platform's bar", "", 0.1, 100,
             "count the teeth", BAR, _constant(4.0), "tool"),
    Question("pinion", "radius of the pinion between the two racks", "m", 1e-3, 1, _CALIPER,
             SLIDE,
             # Keeps the platform smaller than the circle of its limbs.
             lambda kind, a: rounded(0.018 * a["strut"]), "tool"),
    Question("tool_turn", "how far the tool turns, either way", "degree", 1, 7200, _SHEET,
             ARTICULATED, lambda kind, a: 45.0 * a["ratio"] if "ratio" in a else 180.0, "tool"),
    Question("tool_speed", "largest speed of the tool's turn", "degree/s", 1, 1e5, _SHEET, TURNING,
             _constant(1500.0), "tool"),
    Question("tool_torque", "largest torque of the tool's motor, behind its gear", "N*m", 1e-4, 1e5,
             _SHEET, TELESCOPE,
             lambda kind, a: rounded(2.0 * GRAVITY * a["tool_mass"] * a["strut"]), "tool"),
    Question("tool_rotor", "inertia of the tool's motor, behind its gear", "kg*m**2", 1e-12, 1e3,
             _SHEET + ": rotor times the square of the gear ratio", TELESCOPE,
             lambda kind, a: rounded(2e-4 * a["tool_torque"]), "tool"),
    Question("coulomb", "torque that a motor needs to turn at all, behind its gear", "N*m", 1e-6,
             1e5, _TRY, ROTARY,
             lambda kind, a: rounded(0.03 * a["torque"] * a["gear"]), "friction"),
    Question("viscous", "torque more for each rad/s, behind the gear", "N*m*s/rad", 1e-6, 1e5, _TRY,
             ROTARY, lambda kind, a: rounded(a["coulomb"] / 3), "friction"),
    Question("rail_coulomb", "force that a carriage needs to move at all", "N", 1e-5, 1e6, _TRY,
             LINEAR, lambda kind, a: rounded(0.05 * a["rail_force"]), "friction"),
    Question("rail_viscous", "force more for each m/s", "N*s/m", 1e-5, 1e6, _TRY, LINEAR,
             lambda kind, a: rounded(a["rail_coulomb"]), "friction"),
    Question("radius", "radius of the workspace, a cylinder", "m", 1e-3, 20, _FOUND, ALL,
             lambda kind, a: a["reach_radius"], "workspace"),
    Question("low", "lowest height of the platform point, below the base negative", "m", -50, 50,
             _FOUND, ALL, lambda kind, a: a["reach_low"], "workspace"),
    Question("high", "highest height of the platform point", "m", -50, 50, _FOUND, ALL,
             lambda kind, a: a["reach_high"], "workspace"),
    Question("top_speed", "largest speed of the platform", "m/s", 1e-3, 100, _SHEET, ALL,
             _top_speed, "workspace"),
    Question("top_acceleration", "largest acceleration of the platform", "m/s**2", 1e-2, 2000,
             _SHEET, ALL, _top_acceleration, "workspace"),
)  # fmt: skip
GROUPS: tuple[Group, ...] = ("lengths", "masses", "motors", "tool", "friction", "workspace")


def questions_of(kind: str) -> list[Question]:
    """Questions about a kind of robot, in order."""
    return [question for question in QUESTIONS if kind in question.of]


def answered(kind: str, answers: Mapping[str, str]) -> dict[str, str]:
    """Answers to the questions of a kind by their keys, without empty ones."""
    texts = {question.key: answers.get(question.key, "").strip() for question in questions_of(kind)}
    return {key: text for key, text in texts.items() if text}
