"""Whether measured values and sensors of a description fit the robot: bodies, struts, drives."""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, get_args

from deltaid.robot.body import Body
from deltaid.robot.measured import Axis, Measured
from deltaid.robot.quantities import Vector
from deltaid.robot.sensors import BaseWrench, JointTorque, StrutForce

if TYPE_CHECKING:
    from deltaid.robot.description import RobotDescription

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,39}")
# Default names of a log's other columns, and of a load.
_OF_LOGS = re.compile(r"t|time|load|(?:q|qd|qdd|tau)[0-9]*")


def require_sensors_that_fit(robot: "RobotDescription") -> None:
    """Refuse measured values of what the robot does not have, and sensors that cannot be there.

    Raises:
        ValueError: with the key.
    """
    for name, body in robot.bodies.items():
        _check_spread(name, body)
        for k, measured in enumerate(body.measured):
            _check_value(f"bodies.{name}.measured[{k + 1}]", measured, {name: body})
    for k, measured in enumerate(robot.measured):
        where = f"measured[{k + 1}]"
        names = [placed.body for placed in measured.placed]
        if not names:
            raise ValueError(f"{where}.of names no body")
        for name in names:
            _known(f"{where}.of", "body", name, robot.body_names)
        _check_value(where, measured, {name: robot.bodies[name] for name in names})
    for name, sensor in robot.sensors.items():
        _check_name(robot, name)
        if isinstance(sensor, BaseWrench):
            _check_turns(robot, name, sensor)
        elif isinstance(sensor, StrutForce):
            if robot.limbs is not None:
                _known(f"sensors.{name}.strut", "strut", sensor.strut, tuple(_struts(robot)))
        else:
            assert isinstance(sensor, JointTorque)
            _known(f"sensors.{name}.drive", "drive", sensor.drive, robot.drives)


def _check_spread(name: str, body: Body) -> None:
    """A body that is known has no spread."""
    if not body.free and body.spread is not None:
        raise ValueError(
            f"bodies.{name}.spread is given, but free: [] says that the body is known; leave one "
            "of them out"
        )


def _check_value(where: str, measured: Measured, bodies: Mapping[str, Body]) -> None:
    """What was measured must be free to follow."""
    if all(not body.free for body in bodies.values()):
        known = f"{'is' if len(bodies) == 1 else 'are'} known (free: [])"
        raise ValueError(
            f"{where} is of {' and '.join(bodies)}, which {known}, so it would change nothing; "
            "put the value into the prior, or leave free out"
        )
    if measured.quantity not in ("first_moment", "centre") or not measured.value or len(bodies) > 1:
        return
    ((name, body),) = bodies.items()
    at = getattr(measured, "placed", ())
    if any(any(placed.turned_deg) for placed in at):
        return
    entries = [f"mc{axis}" for axis in _along(measured.axis)]
    held = [entry for entry in entries if entry not in body.free]
    if held:
        raise ValueError(
            f"{where} is along {', '.join(_along(measured.axis))}, but bodies.{name}.free "
            f"excludes {' and '.join(held)}, which says that it is zero; name it there"
        )


def _along(axis: Axis | Vector | None) -> list[str]:
    """Axes of the link frame that a direction has a part along."""
    if axis is None or isinstance(axis, str):
        return [axis] if axis else []
    return [letter for letter, part in zip(get_args(Axis), axis, strict=True) if part]


def _check_name(robot: "RobotDescription", name: str) -> None:
    """Names stand in headers, mappings and parameters."""
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"sensors has the name '{name[:50]}': begin with a letter, then letters, digits, _ and "
            "-, 40 at most"
        )
    taken = {"a body": robot.body_names, "a joint": robot.joints}
    for what, names in taken.items():
        if name in names:
            raise ValueError(f"sensors.{name} is called as {what} is; give it another name")
    if _OF_LOGS.fullmatch(name):
        raise ValueError(
            f"sensors.{name} is called as another column of a log, or as a load, is; give it "
            "another name"
        )


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
    for drive, turn in turns.items():
        if drive:
            _known(where, "drive", drive, robot.drives)
        if turn == 0:
            raise ValueError(
                f"{f'{where}.{drive}'.rstrip('.')} is 0, but a motor turns with its drive; give "
                "the ratio of its gear, 1 for a direct drive, or leave it out"
            )


def _struts(robot: "RobotDescription") -> Iterator[str]:
    """What a gauge may be on: a strut, or both of a limb."""
    for i, limb in enumerate(robot.limb_geometry):
        yield f"strut{i + 1}"
        if limb.struts == 2:
            yield from (f"strut{i + 1}a", f"strut{i + 1}b")


def _known(where: str, what: str, name: str, names: Iterable[str]) -> None:
    names = tuple(names)
    if name in names:
        return
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise ValueError(
        f"{where} names an unknown {what} '{name[:40]}'; choose from {', '.join(names)}{hint}"
    )
