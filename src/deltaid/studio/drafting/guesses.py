"""What is assumed of a robot that nobody has measured, from what is known of it.

Imports nothing that is slow: the help of `deltaid new` is made of the questions that use it.
"""

import math
from collections.abc import Mapping

from deltaid.studio.drafting.kinds import is_linear, limbs_of, platform_of

# [m/s²].
GRAVITY = 9.81
# Acceleration of the platform that assumed motors are strong enough for [m/s²], and how much
# stronger they are than one limb alone would need.
_ACCELERATION, _MORE = 40.0, 2.0
# Mass of a part over the cube of arm and strut [kg/m³], at most: a tenth of a solid block's.
_HEAVIEST = 15.0
# Largest speed and acceleration that are assumed of a platform [m/s, m/s²].
_FASTEST, _HARDEST = 5.0, 60.0


def rounded(value: float, digits: int = 2) -> float:
    """A number that does not pretend to be known."""
    return float(f"{value:.{digits}g}")


def lifted(kind: str, a: Mapping[str, float]) -> float:
    """Mass that one drive moves: its share of platform, tool and telescope, and its struts [kg]."""
    shared = sum(a.get(key, 0.0) for key in ("platform_mass", "tool_mass", "telescope_mass"))
    return shared / limbs_of(kind) + 2 * a["strut_mass"]


def mass(kind: str, a: Mapping[str, float], typical: float) -> float:
    """A mass that a robot of this size may have [kg]."""
    size = a["strut"] + a.get("arm", 0.0)
    return rounded(min(typical, _HEAVIEST * size**3))


def bar(kind: str, a: Mapping[str, float]) -> float:
    """Length of an articulated platform's bar [m]."""
    return rounded(a["strut"] / (8 if platform_of(kind) == "h4" else 7))


def torque(kind: str, a: Mapping[str, float]) -> float:
    """Of a motor before its gear: arm and load at the elbow, lifted and accelerated [N m]."""
    return rounded(_MORE * _moment(kind, a) * (GRAVITY + _ACCELERATION) / a["gear"])


def force(kind: str, a: Mapping[str, float]) -> float:
    """Of a carriage [N]."""
    mass = lifted(kind, a) + a["carriage_mass"]
    return rounded(_MORE * mass * (GRAVITY + _ACCELERATION))


def rotor(kind: str, a: Mapping[str, float]) -> float:
    """Before the gear: a third of what the load is, seen from the arm [kg m²]."""
    return rounded(0.3 * lifted(kind, a) * (a["arm"] / a["gear"]) ** 2)


def pinion(kind: str, a: Mapping[str, float]) -> float:
    """Of an I4: its platform stays smaller than its limbs' circle [m]."""
    return rounded(0.018 * a["strut"])


def tool_torque(kind: str, a: Mapping[str, float]) -> float:
    """Of a telescope's motor [N m]."""
    return rounded(2.0 * GRAVITY * a["tool_mass"] * a["strut"])


def top_speed(kind: str, a: Mapping[str, float]) -> float:
    """Half of what the drives' ends reach [m/s]."""
    if is_linear(kind):
        return rounded(min(_FASTEST, 0.5 * a["rail_speed"]))
    return rounded(min(_FASTEST, 0.5 * math.radians(a["speed"]) / a["gear"] * a["arm"]))


def top_acceleration(kind: str, a: Mapping[str, float]) -> float:
    """What the motors have above gravity, halved as they work together [m/s²]."""
    if is_linear(kind):
        mass = lifted(kind, a) + a["carriage_mass"] + a["rotor_mass"]
        most = a["rail_force"] / mass
    else:
        inertia = a["rotor"] * a["gear"] ** 2 / a["arm"]
        most = a["torque"] * a["gear"] / (_moment(kind, a) + inertia)
    return rounded(min(max(0.5 * (most - GRAVITY), 1.0), _HARDEST))


def _moment(kind: str, a: Mapping[str, float]) -> float:
    """Mass times lever about the motor's axis [kg m]."""
    return (lifted(kind, a) + 0.4 * a["arm_mass"]) * a["arm"]
