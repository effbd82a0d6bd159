"""A description as answers to the questions, to start another one from it."""

import numpy as np

from deltaid.errors import DescriptionError
from deltaid.robot.description import RobotDescription
from deltaid.robot.limits import Cylinder
from deltaid.robot.platform import H4Platform, I4Platform, Par4Platform
from deltaid.studio.drafting.kinds import has_telescope, limbs_of, platform_of
from deltaid.studio.drafting.questions import asked

# Answers by the keys of their questions; None for what a description does not say.
_Numbers = dict[str, float | None]


def kind_of(robot: RobotDescription) -> str:
    """Its kind, a key of `KINDS`.

    Raises:
        DescriptionError: it is none of them.
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


def answers(robot: RobotDescription) -> dict[str, float]:
    """What it has of the numbers that a robot of its kind is asked for.

    Raises:
        DescriptionError: it is of no kind that can be asked for.
    """
    kind = kind_of(robot)
    found = _lengths(robot) | _masses(robot, kind) | _drive(robot) | _tool(robot, kind)
    numbers = {question.key: found.get(question.key) for question in asked(kind)}
    return {key: float(f"{value:.12g}") for key, value in numbers.items() if value is not None}


def _lengths(robot: RobotDescription) -> _Numbers:
    limb, space = robot.limb_geometry[0], robot.workspace
    tilt = robot.limbs.tilt_deg if robot.limbs else 0.0
    found: _Numbers = {
        "arm": limb.upper_arm,
        "strut": limb.strut,
        "base_radius": float(np.linalg.norm(limb.base)),
        "platform_radius": float(np.linalg.norm(limb.attachment)),
        "tilt": tilt[0] if isinstance(tilt, tuple) else tilt,
        "spacing": limb.spacing,
        "swing": robot.strut_swing_deg,
        "top_speed": robot.platform_speed,
        "top_acceleration": robot.platform_acceleration,
    }
    if isinstance(space, Cylinder):
        found |= {"radius": space.radius, "low": space.z[0], "high": space.z[1]}
    return found


def _masses(robot: RobotDescription, kind: str) -> _Numbers:
    mass = {name: float(body.prior_parameters()[0]) for name, body in robot.bodies.items()}
    driven, strut = robot.limb_bodies(0)
    parts = {
        "rigid": {"P": 1}, "h4": {"SB": 2, "MB": 1}, "i4": {"HP": 2}, "par4": {"MP": 2, "R": 2},
    }  # fmt: skip
    return {
        "carriage_mass": mass[driven],
        "arm_mass": mass[driven],
        "strut_mass": mass[strut],
        "platform_mass": sum(n * mass[b] for b, n in parts[platform_of(kind)].items()),
        "tool_mass": mass.get("EE"),
        "telescope_mass": mass["TU"] + mass["TL"] if has_telescope(kind) else None,
    }


def _drive(robot: RobotDescription) -> _Numbers:
    """Of the first drive, behind its gear; arms and carriages are asked for other ones of them."""
    inertia, law = robot.rotor_inertia.get("drive1"), robot.friction.get("drive1")
    found: _Numbers = {"gear": 1.0, "rotor": inertia, "rotor_mass": inertia}
    if law is not None:
        found |= {"coulomb": law.coulomb, "rail_coulomb": law.coulomb}
        found |= {"viscous": law.viscous, "rail_viscous": law.viscous}
    limits = robot.drive_limits.get("drive1")
    if limits is not None:
        found |= zip(("rail_low", "rail_high"), limits.position or (), strict=False)
        found |= zip(("angle_low", "angle_high"), limits.angle_deg or (), strict=False)
        found |= {"rail_speed": limits.speed, "speed": limits.speed_deg_s}
        found |= {"rail_force": limits.effort, "torque": limits.effort}
    return found


def _tool(robot: RobotDescription, kind: str) -> _Numbers:
    platform, found = robot.platform, _Numbers()
    if isinstance(platform, H4Platform | Par4Platform):
        found["bar"] = platform.half_length if isinstance(platform, H4Platform) else platform.length
        found["ratio"] = abs(platform.ratio)
    if isinstance(platform, I4Platform):
        found["pinion"] = 0.5 / abs(platform.ratio)
    if isinstance(platform, H4Platform | Par4Platform | I4Platform):
        found["tool_turn"] = max(abs(angle) for angle in platform.angle_deg)
        found["tool_speed"] = platform.speed_deg_s
    name = f"drive{limbs_of(kind) + 1}"
    limits = robot.drive_limits.get(name)
    if has_telescope(kind) and limits is not None:
        found |= {"tool_speed": limits.speed_deg_s, "tool_torque": limits.torque}
        found["tool_rotor"] = robot.rotor_inertia.get(name)
    return found
