"""Errors of the description: zeros, gear ratios, lengths, tilt of the base, symmetry of bodies."""

from collections.abc import Sequence
from typing import get_args

import numpy as np
from jaxtyping import Int

from deltaid.dynamics.geometry import across
from deltaid.effects.mounting import by_limb
from deltaid.effects.point import SIZE, Deviations, TracePoint, UnknownEffect
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.estimation.information import active_columns
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.model.corrections import Correction
from deltaid.robot.body import Entry
from deltaid.robot.description import RobotDescription
from deltaid.robot.mounting import remounted
from deltaid.robot.tolerances import BY_EYE

# Lengths of a limb that may be off, and the number of each among the symbols of a limb's lengths.
_OF_LIMB = {"platform_radius": 0, "upper_arm": 1, "strut": 2}


class Zeros(UnknownEffect):
    """q = q_m + q_0: true positions less recorded ones [rad or m]."""

    name = corrected_as = "zero"
    text = "zero offset: the true position is the recorded one plus this"
    corrects = "readings"
    deviation = 4e-3

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.weighted([point.slopes.of_zero(i) for i in range(point.dof)])

    def stated(self, robot: RobotDescription) -> Deviations:
        return np.array([robot.tolerances.of_drive(drive) for drive in robot.drives])


class GearRatios(UnknownEffect):
    """q = (1 + r) q_m: true motion over recorded one, less 1."""

    name = corrected_as = "gear-ratio"
    unit, text = "%", "gear ratio error: the drive moves this share more than recorded"
    corrects = "readings"
    deviation = 4e-3

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        w, slopes = point.motion, point.slopes
        each = np.eye(point.dof)
        return point.weighted([
            slopes.of_motion(point.q * unit, w.qd * unit, w.qdd * unit) for unit in each
        ])  # fmt: skip


class Tilt(UnknownEffect):
    """Turns of gravity about two axes across it [rad]; a tilt beyond the limit is visible by eye,
    and no error of mounting."""

    name = corrected_as = "tilt"
    corrects = "robot"
    deviation = 1e-2
    limit = BY_EYE

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        slopes = point.slopes
        return point.weighted([slopes.of_gravity(axis) for axis in across(slopes.gravity)])

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
            f"torques match a base tilt of {np.linalg.norm(values):.2g} rad, more than mounting "
            "explains, so nothing is corrected. Likeliest something pulls at the robot, or gravity "
            "is not as described; check hoses, springs and gravity"
        )


class Lengths(UnknownEffect):
    """True lengths of limbs less described ones [m]."""

    name = corrected_as = "length"
    unit, text = "m", "it is this much longer than described"
    corrects = "robot"
    deviation = 5e-4

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        lengths = lengths_of(point.dynamics.robot)
        return point.weighted([point.slopes.of_length(number) for _, _, number in lengths])

    def stated(self, robot: RobotDescription) -> Deviations:
        return np.array([robot.tolerances.of_length(name) for name, _, _ in lengths_of(robot)])

    def subjects(self, robot: RobotDescription) -> Sequence[str]:
        return [f"{name} of limb {i + 1}" for name, i, _ in lengths_of(robot)]


def lengths_of(robot: RobotDescription) -> tuple[tuple[str, int, int], ...]:
    """Lengths of limbs that the description states: name, limb, number of its symbol."""
    limbs = robot.limbs
    if limbs is None:
        return ()
    named = [name for name in _OF_LIMB if getattr(limbs, name) is not None]
    return tuple((name, i, 3 * i + _OF_LIMB[name]) for name in named for i in range(limbs.count))


def reshaped(
    robot: RobotDescription,
    longer: Sequence[float] = (),
    mounted: Sequence[float] = (),
    turned: Sequence[float] = (),
) -> RobotDescription:
    """The robot with the lengths of `lengths_of` changed [m], limbs mounted otherwise by the
    numbers of `Mounting`, and gravity turned about the axes of `Tilt` [rad]."""
    changed: dict[str, object] = {}
    if any(turned):
        g = np.array(robot.gravity)
        changed["gravity"] = tuple((g + np.cross(np.array(turned) @ across(g), g)).tolist())
    if any(longer) and robot.limbs is not None:
        limbs: dict[str, tuple[float, ...]] = {}
        for (name, i, _), more in zip(lengths_of(robot), longer, strict=True):
            given = getattr(robot.limbs, name)
            described = given[i] if isinstance(given, tuple) else given
            limbs[name] = (*limbs.get(name, ()), described + more)
        robot = robot.model_copy(update={"limbs": robot.limbs.model_copy(update=limbs)})
    if any(mounted) and robot.limbs is not None:
        elsewhere = remounted(robot.limbs, by_limb(robot, mounted))
        robot = robot.model_copy(update={"limbs": robot.limbs.model_copy(update=elsewhere)})
    return robot.model_copy(update=changed)


class Structure(UnknownEffect):
    """First moments and products of inertia that a description sets to zero [kg m, kg m²].

    A centre that is off by a share of a body's length ℓ changes them by this share of m ℓ; an axis
    that is turned by as many radians, by this share of m ℓ².
    """

    name = corrected_as = "structure"
    is_fitted = True

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        reduction, left_out = excluded_entries(point)
        return point.regressor @ reduction.A[active_columns(point.dynamics)][:, left_out]

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        reduction, left_out = excluded_entries(point)
        return SIZE * reduction.scale[left_out]

    def opened(self, robot: RobotDescription) -> RobotDescription:
        return opened(robot)

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        text = (
            "bodies are less symmetric than their descriptions say: entries that `free` excludes "
            "are estimated too"
        )
        return (Correction(kind="structure", text=text),)


def opened(robot: RobotDescription) -> RobotDescription:
    """The robot with all ten entries free of each body that has free ones."""
    bodies = {
        name: body.model_copy(update={"free": get_args(Entry)}) if body.free else body
        for name, body in robot.bodies.items()
    }
    return robot.model_copy(update={"bodies": bodies})


def excluded_entries(point: TracePoint) -> tuple[Reduction, Int[np.ndarray, " entries"]]:
    """The reduction with all entries free, and the numbers of those the description excludes."""
    active, robot = active_columns(point.dynamics), point.dynamics.robot
    full, own = build_reduction(opened(robot), active), build_reduction(robot, active)
    off_diagonal = ("mc", "Sxy", "Syz", "Sxz")
    return full, np.flatnonzero([
        variable.name not in own.names and variable.symbol.startswith(off_diagonal)
        for variable in full.variables
    ])  # fmt: skip
