"""Zeros, gear ratios, lengths and a tilt of the base that are not as described."""

from collections.abc import Sequence

import numpy as np

from deltaid.dynamics.geometry import across
from deltaid.effects.point import Point
from deltaid.effects.unknown import Deviations, Unknown
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.model.corrections import Correction, Kind
from deltaid.robot.description import RobotDescription

# Standard deviations before any recording: of zeros and a tilt [rad; m for a rail], gear ratios,
# and lengths [m].
_ZERO, _TILT, _RATIO, _LENGTH = 4e-3, 1e-2, 4e-3, 5e-4
# A base that leans more [rad] is seen by eye, and is no error of mounting.
_LEANS = 0.05
# Lengths of a limb that may be off, and the place of each among a limb's symbols of growth.
_OF_LIMB = {"platform_radius": 0, "upper_arm": 1, "strut": 2}


class Zeros(Unknown):
    """q = q_m + q_0: what drives' positions are more than recorded [rad or m]."""

    name = "zero"
    is_geometry = True
    corrects = "readings"

    def columns(self, point: Point) -> ColumnsOfDrives:
        return point.weighted([point.slopes.of_zero(i) for i in range(point.dof)])

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return np.full(point.dof, _ZERO)

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        text = "its zero is off: positions are this much more than recorded"
        units = [robot.units(drive).coordinate for drive in robot.drives]
        return of_each_drive("zero", robot, values, half, units, text)


class Ratios(Unknown):
    """q = (1 + r) q_m: the share that drives' motions are more than recorded."""

    name = "gear-ratio"
    is_geometry = True
    corrects = "readings"

    def columns(self, point: Point) -> ColumnsOfDrives:
        q, w, each = point.q, point.w, np.eye(point.dof)
        motions = [(q * own, w.qd * own, w.qdd * own) for own in each]
        return point.weighted([point.slopes.of_motion(*motion) for motion in motions])

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return np.full(point.dof, _RATIO)

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        text = "its gear ratio is off: it moves this share more than recorded"
        units = ["%"] * len(values)
        return of_each_drive("gear-ratio", robot, 100 * values, 100 * half, units, text)


class Tilt(Unknown):
    """Turns of gravity about two axes across it [rad]."""

    name = "tilt"
    is_geometry = True
    corrects = "robot"
    limit = _LEANS

    def columns(self, point: Point) -> ColumnsOfDrives:
        slopes = point.slopes
        return point.weighted([slopes.of_gravity(axis) for axis in across(slopes.gravity)])

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return np.full(columns.shape[2], _TILT)

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        axis = values @ across(np.array(robot.gravity))
        angle = float(np.linalg.norm(values))
        way = ", ".join(f"{share:.2f}" for share in axis / max(angle, 1e-300))
        text = f"the base is not level: it is turned about ({way}) against what is described"
        return (
            Correction(kind="tilt", value=angle, low=max(angle - max(half), 0.0),
                       high=angle + max(half), unit="rad", text=text),
        )  # fmt: skip

    def doubt(self, values: Deviations) -> str:
        return (
            f"torques look like those of a base that is tilted by {np.linalg.norm(values):.2g} "
            "rad, more than mounting explains, and nothing is corrected. Likeliest something pulls "
            "at the robot, or gravity is not as described; look at hoses and springs, and check "
            "gravity"
        )


class Lengths(Unknown):
    """What lengths of limbs are more than described [m]."""

    name = "length"
    is_geometry = True
    corrects = "robot"

    def columns(self, point: Point) -> ColumnsOfDrives:
        lengths = lengths_of(point.dynamics.robot)
        return point.weighted([point.slopes.of_length(number) for _, _, number in lengths])

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return np.full(columns.shape[2], _LENGTH)

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        text = "it is this much longer than described"
        rows = zip(lengths_of(robot), values.tolist(), half.tolist(), strict=True)
        return tuple(
            Correction(kind="length", subject=f"{name} of limb {i + 1}", value=more,
                       low=more - wide, high=more + wide, unit="m", text=text)
            for (name, i, _), more, wide in rows
        )  # fmt: skip


def of_each_drive(
    kind: Kind,
    robot: RobotDescription,
    values: Deviations,
    half: Deviations,
    units: Sequence[str],
    text: str,
) -> tuple[Correction, ...]:
    """A correction for each drive."""
    rows = zip(robot.drives, values.tolist(), half.tolist(), units, strict=True)
    return tuple(
        Correction(kind=kind, subject=drive, value=value, low=value - wide, high=value + wide,
                   unit=unit, text=text)
        for drive, value, wide, unit in rows
    )  # fmt: skip


def lengths_of(robot: RobotDescription) -> tuple[tuple[str, int, int], ...]:
    """Lengths of limbs that are numbers of the description: name, limb, number of its symbol."""
    limbs = robot.limbs
    if limbs is None:
        return ()
    named = [name for name in _OF_LIMB if getattr(limbs, name) is not None]
    return tuple((name, i, 3 * i + _OF_LIMB[name]) for name in named for i in range(limbs.count))


def reshaped(
    robot: RobotDescription, longer: Sequence[float], turned: Sequence[float]
) -> RobotDescription:
    """The robot with lengths of `lengths_of` that are so much longer [m], its base turned by angles
    about the axes of `Tilt` [rad]."""
    changed: dict[str, object] = {}
    if any(turned):
        g = np.array(robot.gravity)
        changed["gravity"] = tuple((g + np.cross(np.array(turned) @ across(g), g)).tolist())
    if any(longer) and robot.limbs is not None:
        lengths: dict[str, list[float]] = {}
        for (name, i, _), more in zip(lengths_of(robot), longer, strict=True):
            given = getattr(robot.limbs, name)
            described = given[i] if isinstance(given, tuple) else given
            lengths.setdefault(name, []).append(described + more)
        limbs = {name: tuple(values) for name, values in lengths.items()}
        changed["limbs"] = robot.limbs.model_copy(update=limbs)
    return robot.model_copy(update=changed)
