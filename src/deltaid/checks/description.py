"""Checks of a description: units of lengths and of gravity, missing friction and limits.

Units of lengths are judged from the plain data of the file: most robots in millimetres are larger
than any description may be, so loading their file fails.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from deltaid.checks.evidence import WRONG_SCALE
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.model.verdict import Fault, Grade, Proposal, Verdict, listed
from deltaid.recording.proposed_mapping import MOST_METRES
from deltaid.robot.description import GRAVITY, RobotDescription
from deltaid.robot.yaml_edit import place_in_words

# Start values of unmeasured friction: Coulomb friction as a share of the gravity torque, and the
# speed [rad/s or m/s] at which viscous friction equals it.
_SHARE, _SPEED = 0.1, {False: 3.0, True: 0.5}
_DEFAULTS = {"platform_speed": "m/s", "platform_acceleration": "m/s²"}
_FRICTION = Fault(
    "friction",
    "drives",
    "missing from the description; a fit then puts that friction into masses and inertias",
    "describe it; its size is only a start, as the recording decides it",
)
_LIMITS = Fault(
    "limits",
    "limits",
    "missing from the description",
    "give what the machine may do before `deltaid excite` plans a motion: it goes to the limits "
    "that it knows; identification does not depend on them",
)
# Least length of arm and strut together [m]: the smallest Deltas have some 20 mm.
_DWARF = 0.005
# Largest ratio of a limb's length to another length of the robot.
_SMALL = 250.0
# Least number that is a length in millimetres: no part of a robot is shorter.
_MILLIMETRE = 1.0
_METRES = Fault("length-unit", "m")
# Sizes of a gravity that is given in g, not in m/s²: no place on a planet or moon has them.
_IN_G = (0.9, 1.1)

# Keys of lengths, by part of the description.
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

    Limbs too long for any robot are in millimetres, too short ones were divided by 1000 once too
    often. Their corrected size is the scale for all lengths: limbs one by one, other parts as a
    whole.
    """
    limbs, groups = _lengths(data.get("limbs"), _LIMBS, "limbs"), list(_groups(data))
    arms = [length for length in limbs if length[0].startswith("limbs.upper_arm")]
    struts = [length for length in limbs if length[0].partition("[")[0] == "limbs.strut"]
    # A user's own mechanism has no limbs.
    space = _lengths(data.get("workspace"), _OTHERS["workspace"], "workspace")
    size = _longest(arms) + _longest(struts) or _longest(space)
    small, large = size < _DWARF, size > MOST_METRES
    factor, unit = (1e3, "divided by 1000 once too often") if small else (1e-3, "in millimetres")
    size *= factor if small or large else 1.0
    least = 0.0 if small or large else _MILLIMETRE  # limbs in metres: most numbers are
    groups = [group for group in groups if _longest(group) > 0] + [[length] for length in limbs]
    low, high = (size / _SMALL, np.inf) if small else (0.0, WRONG_SCALE * size)
    wrong = [
        length for group in groups if not low <= _longest(group) <= high
        for length in group if abs(length[1]) >= least
    ]  # fmt: skip
    if not wrong:
        return _METRES.good(f"limbs of {size:.3g} m; all lengths go with it", size)
    path, value = max(wrong, key=lambda length: abs(length[1]))
    others = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
    changes = tuple((place, float(f"{value * factor:.12g}")) for place, value in wrong if value)
    return _METRES.judged(
        f"{place_in_words(path)} is {value:g} m{others}, where limbs of about {size:.3g} m are "
        "likely",
        path.partition(".")[0],
        abs(value),
        grade=Grade.WRONG,
        cause=f"lengths {unit}; those of a description are in metres",
        cure=f"multiply these lengths by {factor:g}",
        proposals=(Proposal("robot", changes),),
    )


def checked_gravity(robot: RobotDescription) -> Iterator[Verdict]:
    """A verdict on gravity that is given in g."""
    if _IN_G[0] < (size := float(np.linalg.norm(robot.gravity))) < _IN_G[1]:
        gravity = [float(f"{GRAVITY * g:.12g}") for g in robot.gravity]
        yield Verdict(
            "gravity",
            Grade.WRONG,
            f"gravity is {size:.3g} m/s², and {GRAVITY} m/s² on Earth",
            cause="it is given in g; that of a description is in m/s²",
            cure=f"multiply it by {GRAVITY}",
            proposals=(Proposal("robot", (("gravity", gravity),)),),
            number=size,
            unit="m/s²",
        )


def _longest(group: Iterable[Length]) -> float:
    return max((abs(value) for _, value in group), default=0.0)


def _groups(data: dict[str, Any]) -> Iterator[list[Length]]:
    """Lengths of all parts except limbs, a list for each part."""
    for part, keys in _OTHERS.items():
        yield _lengths(data.get(part), keys, part)
    for name, body in _mapping(data.get("bodies")).items():
        prior = _mapping(body).get("prior")
        for k, shape in enumerate(prior if isinstance(prior, list | tuple) else ()):
            yield _lengths(shape, _SHAPE, f"bodies.{name}.prior[{k}]")
    for drive, limits in _mapping(data.get("drive_limits")).items():
        yield _lengths(limits, ("position",), f"drive_limits.{drive}")


def _lengths(part: Any, keys: tuple[str, ...], path: str) -> list[Length]:
    return [length for key in keys for length in _numbers(_mapping(part).get(key), f"{path}.{key}")]


def _mapping(part: Any) -> dict[str, Any]:
    """A part of an unchecked description as a mapping; empty if it is none."""
    return part if isinstance(part, dict) else {}


def _numbers(value: object, path: str) -> Iterator[Length]:
    if isinstance(value, list | tuple):
        for k, entry in enumerate(value):
            yield from _numbers(entry, f"{path}[{k}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, float(value)


def checked_friction(robot: RobotDescription) -> Verdict:
    """Verdict on drives without a friction law."""
    missing = [drive for drive in robot.drives if drive not in robot.friction]
    if not missing:
        return _FRICTION.good(f"described of {listed(robot.friction_joints)}")
    changes = tuple(
        (f"friction.{drive}.{key}", value)
        for drive in missing
        for key, value in _law(robot, drive).items()
    )
    return _FRICTION.judged(
        f"no friction is described of {listed(missing)}",
        listed(missing),
        float(len(missing)),
        proposals=(Proposal("robot", changes),),
    )


def _law(robot: RobotDescription, drive: str) -> dict[str, float]:
    """Friction of a drive of the same kind; otherwise from the gravity torque."""
    slides = robot.is_linear(drive)
    for other in robot.drives:
        same_kind = robot.is_linear(other) == slides and (other == "drive4") == (drive == "drive4")
        if other in robot.friction and (same_kind or robot.platform_turns):
            law = robot.friction[other]
            return {"viscous": law.viscous, "coulomb": law.coulomb}
    dynamics = compiled(robot)
    home, still = dynamics.kinematics.home[None], np.zeros((1, dynamics.dof))
    torque = np.abs(dynamics.torque(home, still, still, prior_parameters(robot))[0]).max()
    coulomb = float(f"{_SHARE * torque:.2g}") or 0.1
    return {"viscous": float(f"{coulomb / _SPEED[slides]:.2g}"), "coulomb": coulomb}


def checked_limits(robot: RobotDescription) -> Verdict:
    """Verdict on missing limits, and on defaults that apply instead."""
    defaults, limits = [k for k in _DEFAULTS if k not in robot.model_fields_set], robot.drive_limits
    seen = [f"{k} is not given: {getattr(robot, k):g} {_DEFAULTS[k]} acts" for k in defaults]
    free = [drive for drive in robot.drives if drive not in limits or not limits[drive].effort]
    if free:
        efforts = {robot.units(drive).effort for drive in free}
        seen.append(f"no {' or '.join(sorted(efforts))} limit of {listed(free)}")
    if not seen:
        return _LIMITS.good(
            f"platform {robot.platform_speed:g} m/s, {robot.platform_acceleration:g} m/s²; effort "
            "of all drives"
        )
    subject = listed(defaults + ["drive_limits"] * bool(free))
    return _LIMITS.judged("; ".join(seen), subject, float(len(seen)))
