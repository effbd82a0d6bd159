"""Checks that the parts of a description agree, and that its limbs reach the workspace."""

import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from deltaid.errors import nearest
from deltaid.robot.body import Body
from deltaid.robot.limits import Box
from deltaid.robot.measured import Measured
from deltaid.robot.part import require_one
from deltaid.robot.platform import RigidPlatform
from deltaid.robot.sensors import BaseWrench, JointTorque, StrutForce
from deltaid.robot.tolerances import LENGTHS

if TYPE_CHECKING:
    from deltaid.robot.description import RobotDescription


def require_parts_that_fit(robot: "RobotDescription") -> None:
    """Refuse parts that contradict each other, or that refer to something the robot lacks.

    Raises:
        ValueError: names the key.
    """
    _check_drives(robot)
    _check_workspace(robot)
    _require_exactly("bodies", robot.bodies, robot.body_names)
    for key, given, known in (
        ("friction", robot.friction, robot.joints),
        ("springs", robot.springs, robot.joints),
        ("rotor_inertia", robot.rotor_inertia, robot.drives),
        ("drive_limits", robot.drive_limits, robot.drives),
        ("gear_stiffness", robot.gear_stiffness, robot.drives),
        ("tolerances.lengths", robot.tolerances.lengths, LENGTHS),
        ("tolerances.homing", robot.tolerances.homing, robot.drives),
    ):
        if isinstance(given, dict):
            _require_known(key, given, known)
    for joint, spring in robot.springs.items():
        wrong = "rest_deg" if robot.is_linear(joint) else "rest"
        if getattr(spring, wrong) is not None:
            kind = "slides" if robot.is_linear(joint) else "turns"
            raise ValueError(f"springs.{joint} has {wrong}, but the joint {kind}")
    for joint, law in robot.friction.items():
        if law.load is not None and joint not in robot.drives:
            raise ValueError(f"friction.{joint} has a load term, which only drives can have")
    _check_measured(robot)
    _check_sensors(robot)


def _check_workspace(robot: "RobotDescription") -> None:
    moves = {"xyz"[axis] for axis in robot.task.axes}
    if isinstance(robot.workspace, Box):
        for axis in "xyz":
            if (getattr(robot.workspace, axis) is not None) != (axis in moves):
                says = "lacks" if axis in moves else "has"
                does = "moves" if axis in moves else "does not move"
                raise ValueError(f"workspace {says} {axis}, along which this robot {does}")
    elif len(moves) < 3:
        raise ValueError(
            f"workspace is a {robot.workspace.shape}, but this robot moves only along "
            f"{' and '.join(sorted(moves)) or 'no axis'}; give a box of these axes"
        )


def _check_drives(robot: "RobotDescription") -> None:
    require_one(robot, "limbs", "mechanism")
    if robot.limbs is not None:
        wanted = 3 if isinstance(robot.platform, RigidPlatform) else 4
        if robot.limbs.count != wanted:
            raise ValueError(
                f"limbs.azimuth_deg has {robot.limbs.count} limbs, but a platform of kind "
                f"{robot.platform.kind} needs {wanted}"
            )
        if robot.telescope is not None and wanted == 4:
            raise ValueError(
                "telescope is given, but the platform turns its tool itself; leave one of them out"
            )
        if not any(robot.gravity):
            raise ValueError("gravity is zero; give the vector in the world frame, in m/s²")
    elif robot.telescope is not None or robot.platform != RigidPlatform():
        raise ValueError("mechanism is in place of limbs, platform and telescope")
    for drive, limits in robot.drive_limits.items():
        foreign = limits.foreign(linear=robot.is_linear(drive))
        if foreign:
            kind = "linear" if robot.is_linear(drive) else "rotary"
            raise ValueError(f"drive_limits.{drive} has {foreign[0]}, but the drive is {kind}")


def _require_exactly(key: str, given: dict[str, Body], wanted: tuple[str, ...]) -> None:
    missing = [name for name in wanted if name not in given]
    extra = [name for name in given if name not in wanted]
    faults = {"lacks": missing, "has unknown": extra}
    parts = [f"{what} {', '.join(names)}" for what, names in faults.items() if names]
    if parts:
        raise ValueError(f"{key} {' and '.join(parts)}; this robot has {', '.join(wanted)}")


def _require_known(key: str, given: Iterable[str], known: tuple[str, ...]) -> None:
    if unknown := [name for name in given if name not in known]:
        text = f"{key} has unknown {', '.join(unknown)}; choose from {', '.join(known)}"
        hint = nearest(unknown[0], known).strip()
        raise ValueError(f"{text}; {hint}" if hint else text)


def open_limb(robot: "RobotDescription") -> str:
    """Reason why a limb cannot reach the middle of the workspace; empty if all limbs can.

    In the plane across its motor axis, a rotary limb reaches from |L − l| to L + l, with the arm's
    length L and the strut's projected length l; a linear limb reaches one strut's length from its
    rail.
    """
    if robot.limbs is None:  # a user-defined mechanism is checked when it is built
        return ""
    home = robot.home
    for i, limb in enumerate(robot.limb_geometry):
        held = home[:3] + limb.attachment
        if not isinstance(robot.platform, RigidPlatform):
            sign = 1.0 if robot.platform.on_first(i) else -1.0
            held = held + sign * robot.platform.half(home[3])
        shortest, longest = limb.fitting_struts(held)
        if not shortest < limb.strut < longest:
            side = "at least" if limb.strut <= shortest else "at most"
            bound = shortest if limb.strut <= shortest else longest
            middle = ", ".join(f"{x:.4g}" for x in home[:3])
            return (
                f"limb {i + 1} cannot reach the middle of the workspace, ({middle}) m, with a "
                f"strut of {limb.strut:g} m; it takes {side} {bound:.4g} m"
            )
    return ""


_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,39}")
# Default names of the other columns of a log, and of a load.
_OF_LOGS = re.compile(r"t|time|load|(?:q|qd|qdd|tau)[0-9]*")


def _check_measured(robot: "RobotDescription") -> None:
    for name, body in robot.bodies.items():
        if not body.free and body.spread is not None:
            raise ValueError(
                f"bodies.{name}.spread is given, but free: [] says that the body is known; leave "
                "one of them out"
            )
        for k, measured in enumerate(body.measured):
            _check_value(f"bodies.{name}.measured[{k + 1}]", measured, {name: body})
    for k, measured in enumerate(robot.measured):
        where = f"measured[{k + 1}]"
        names = [placed.body for placed in measured.placed]
        if not names:
            raise ValueError(f"{where}.of names no body")
        _require_known(f"{where}.of", names, robot.body_names)
        _check_value(where, measured, {name: robot.bodies[name] for name in names})


def _check_sensors(robot: "RobotDescription") -> None:
    for name, sensor in robot.sensors.items():
        _check_name(robot, name)
        if isinstance(sensor, BaseWrench):
            _check_turns(robot, name, sensor)
        elif isinstance(sensor, StrutForce):
            sides = ("", "a", "b") if robot.limbs and robot.limbs.struts_per_limb == 2 else ("",)
            count = len(robot.limb_geometry)
            struts = tuple(f"strut{i + 1}{side}" for i in range(count) for side in sides)
            if struts:
                _require_known(f"sensors.{name}.strut", [sensor.strut], struts)
        else:
            assert isinstance(sensor, JointTorque)
            _require_known(f"sensors.{name}.drive", [sensor.drive], robot.drives)


def _check_value(where: str, measured: Measured, bodies: Mapping[str, Body]) -> None:
    """Refuse a measured value that depends only on entries that are not free."""
    if all(not body.free for body in bodies.values()):
        known = f"{'is' if len(bodies) == 1 else 'are'} known (free: [])"
        raise ValueError(
            f"{where} is of {' and '.join(bodies)}, which {known}, so it would change nothing; "
            "put the value into the prior, or leave free out"
        )
    if measured.quantity not in ("first_moment", "centre") or not measured.value or len(bodies) > 1:
        return
    ((name, body),) = bodies.items()
    if any(any(placed.turned_deg) for placed in getattr(measured, "placed", ())):
        return
    axis = measured.axis or (0.0, 0.0, 0.0)  # a letter, or a direction
    parts = [letter == axis for letter in "xyz"] if isinstance(axis, str) else axis
    along = [letter for letter, part in zip("xyz", parts, strict=True) if part]
    held = [f"mc{axis}" for axis in along if f"mc{axis}" not in body.free]
    if held:
        raise ValueError(
            f"{where} is along {', '.join(along)}, but bodies.{name}.free "
            f"excludes {' and '.join(held)}, which says that it is zero; name it there"
        )


def _check_name(robot: "RobotDescription", name: str) -> None:
    """Refuse a sensor's name that headers cannot hold or that something else has."""
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"sensors has the name '{name[:50]}': begin with a letter, then letters, digits, _ and "
            "-, 40 at most"
        )
    for what, is_taken in (
        ("a body", name in robot.body_names),
        ("a joint", name in robot.joints),
        ("another column of a log, or as a load,", _OF_LOGS.fullmatch(name)),
    ):
        if is_taken:
            raise ValueError(f"sensors.{name} is called as {what} is; give it another name")


def _check_turns(robot: "RobotDescription", name: str, sensor: BaseWrench) -> None:
    given, where = sensor.motor_turns, f"sensors.{name}.motor_turns"
    if given is None:
        return
    if not robot.rotor_inertia:
        raise ValueError(
            f"{where} is given, but no drive has a rotor_inertia that would turn; give that, or "
            "leave motor_turns out"
        )
    turns = given if isinstance(given, dict) else {"": given}
    _require_known(where, turns if isinstance(given, dict) else (), robot.drives)
    for drive, turn in turns.items():
        if turn == 0:
            raise ValueError(
                f"{f'{where}.{drive}'.rstrip('.')} is 0, but a motor turns with its drive; give "
                "the ratio of its gear, 1 for a direct drive, or leave it out"
            )
