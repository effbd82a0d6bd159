"""A description as answers to the questions, to start another one from it."""

from collections.abc import Iterator

import numpy as np

from deltaid.errors import DescriptionError
from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import H4Platform, I4Platform, Par4Platform
from deltaid.robot.workspace import Cylinder
from deltaid.studio.drafting.kinds import has_telescope, is_linear, limbs_of, platform_of
from deltaid.studio.drafting.questions import asked


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
    found = dict(_numbers(robot, kind))
    return {
        question.key: float(f"{found[question.key]:.12g}")
        for question in asked(kind)
        if question.key in found
    }


def _numbers(robot: RobotDescription, kind: str) -> Iterator[tuple[str, float]]:
    limb = robot.limb_geometry[0]
    yield "arm", limb.upper_arm
    yield "strut", limb.strut
    yield "base_radius", float(np.linalg.norm(limb.base))
    yield "platform_radius", float(np.linalg.norm(limb.attachment))
    yield "tilt", _first(robot.limbs.tilt_deg) if robot.limbs else 0.0
    if limb.spacing is not None:
        yield "spacing", limb.spacing
    if robot.strut_swing_deg is not None:
        yield "swing", robot.strut_swing_deg
    yield from _masses(robot, kind)
    yield from _drive(robot, kind)
    yield from _tool(robot, kind)
    if isinstance(robot.workspace, Cylinder):
        yield "radius", robot.workspace.radius
        yield "low", robot.workspace.z[0]
        yield "high", robot.workspace.z[1]
    yield "top_speed", robot.platform_speed
    yield "top_acceleration", robot.platform_acceleration


def _first(value: float | tuple[float, ...]) -> float:
    return value[0] if isinstance(value, tuple) else value


def _masses(robot: RobotDescription, kind: str) -> Iterator[tuple[str, float]]:
    mass = {name: float(body.prior_parameters()[0]) for name, body in robot.bodies.items()}
    driven, strut = robot.limb_bodies(0)
    yield "carriage_mass" if is_linear(kind) else "arm_mass", mass[driven]
    yield "strut_mass", mass[strut]
    parts = {
        "rigid": {"P": 1}, "h4": {"SB": 2, "MB": 1}, "i4": {"HP": 2}, "par4": {"MP": 2, "R": 2},
    }  # fmt: skip
    yield "platform_mass", sum(n * mass[b] for b, n in parts[platform_of(kind)].items())
    if "EE" in mass:
        yield "tool_mass", mass["EE"]
    if has_telescope(kind):
        yield "telescope_mass", mass["TU"] + mass["TL"]


def _drive(robot: RobotDescription, kind: str) -> Iterator[tuple[str, float]]:
    """Of the first drive, behind its gear."""
    rail = is_linear(kind)
    yield "gear", 1.0
    limits = robot.drive_limits.get("drive1")
    if limits is not None:
        if limits.range is not None:
            ends = limits.position if rail else limits.angle_deg
            names = ("rail_low", "rail_high") if rail else ("angle_low", "angle_high")
            yield from zip(names, ends or (), strict=False)
        speed = limits.speed if rail else limits.speed_deg_s
        if speed is not None:
            yield "rail_speed" if rail else "speed", speed
        if limits.effort is not None:
            yield "rail_force" if rail else "torque", limits.effort
    if "drive1" in robot.rotor_inertia:
        yield "rotor_mass" if rail else "rotor", robot.rotor_inertia["drive1"]
    law = robot.friction.get("drive1")
    if law is not None:
        yield "rail_coulomb" if rail else "coulomb", law.coulomb
        yield "rail_viscous" if rail else "viscous", law.viscous


def _tool(robot: RobotDescription, kind: str) -> Iterator[tuple[str, float]]:
    platform = robot.platform
    if isinstance(platform, H4Platform | Par4Platform):
        yield "bar", platform.half_length if isinstance(platform, H4Platform) else platform.length
        yield "ratio", abs(platform.ratio)
    if isinstance(platform, I4Platform):
        yield "pinion", 0.5 / abs(platform.ratio)
    if isinstance(platform, H4Platform | Par4Platform | I4Platform):
        yield "tool_turn", max(abs(angle) for angle in platform.angle_deg)
        yield "tool_speed", platform.speed_deg_s
    name = f"drive{limbs_of(kind) + 1}"
    limits = robot.drive_limits.get(name)
    if has_telescope(kind) and limits is not None:
        if limits.speed_deg_s is not None:
            yield "tool_speed", limits.speed_deg_s
        if limits.torque is not None:
            yield "tool_torque", limits.torque
        if name in robot.rotor_inertia:
            yield "tool_rotor", robot.rotor_inertia[name]
