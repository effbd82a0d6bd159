"""Effects that stages of their own correct, so that in the contest nothing else explains them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.polynomial import Legendre

from deltaid.effects.joint import SHAPES, Joint, of_load, one_way, one_way_speed, over_speed
from deltaid.effects.lag_columns import late, slope
from deltaid.effects.point import Point
from deltaid.effects.unknown import Deviations, Unknown
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.estimation.information import active_columns
from deltaid.recording.windows import Samples

# Standard deviations before any recording, of friction beside viscous and Coulomb's as shares of
# Coulomb's: over speed, by direction; and of how it changes over a recording, by the degree of the
# polynomial.
_CURVE, _ONE_WAY, _WARM = 0.15, 0.1, (0.1, 0.03)


class FrictionOverSpeed(Unknown):
    """Any curve over the speed of each joint."""

    name = "friction-curve"
    is_candidate = False

    def columns(self, point: Point) -> ColumnsOfDrives:
        return point.of_joints(
            [(joint, over_speed(joint, shape)) for joint in point.joints for shape, _ in SHAPES]
        )

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return _CURVE * np.repeat(_coulomb(point, point.joints), len(SHAPES))


class FrictionByDirection(Unknown):
    """What drives' friction has more one way than the other, constant and with the speed."""

    name = "friction-direction"
    is_candidate = False

    def columns(self, point: Point) -> ColumnsOfDrives:
        ways = (one_way, one_way_speed)
        return point.of_joints([(joint, way) for joint in point.driven for way in ways])

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        sizes = _ONE_WAY * _coulomb(point, point.driven)
        return np.repeat(sizes, 2) / np.ravel([[1.0, 2 * joint.fastest] for joint in point.driven])


class FrictionByLoad(Unknown):
    """A share of what a drive's gear carries."""

    name = "friction-load"
    is_candidate = False
    deviation = 0.03

    def columns(self, point: Point) -> ColumnsOfDrives:
        return point.of_joints([(joint, of_load) for joint in point.driven])


class FrictionOverTime(Unknown):
    """A share of each joint's friction that grows along a recording, and bends."""

    name = "friction-time"
    is_candidate = False
    is_own = True

    def columns(self, point: Point) -> ColumnsOfDrives:
        names, time = point.dynamics.layout.names, point.motion.time
        active, Y = active_columns(point.dynamics), point.trace.regressor()
        span, parts = [time[0], max(time[-1], time[0] + 1e-9)], list[np.ndarray]()
        for joint in point.joints:
            k = [names.index(f"{term}.{joint.name}") for term in ("viscous", "coulomb")]
            torque = Y[:, :, np.searchsorted(active, k)] @ np.abs(point.p[k])
            parts += [torque * Legendre.basis(n + 1, span)(time) for n in range(len(_WARM))]
        return np.stack(parts, axis=2) if parts else np.zeros((*point.model.shape, 0))

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return np.tile(_WARM, len(point.joints))


class Lag(Unknown):
    """What remains of each drive's lag [s]."""

    name = "lag"
    is_candidate = False
    is_own = True
    deviation = 3e-4

    def columns(self, point: Point) -> ColumnsOfDrives:
        return late(point.trace, point.p)


class WindUp(Unknown):
    """q = q_m − s τ_g: gears that wind up under what they carry, s [rad/(N m) or m/N]."""

    name = "compliance"
    is_candidate = False
    is_positive = True
    deviation = 3e-5

    def columns(self, point: Point) -> ColumnsOfDrives:
        dof, rate = point.dof, point.trace.low_pass.rate

        def carried(w: Samples) -> Float[np.ndarray, "channels samples"]:
            """τ_g and two derivatives by time."""
            level = point.dynamics.carried(w.z, w.qd, w.qdd, point.p).T
            first = rate * slope(level)
            return np.vstack([level, first, rate * slope(first)])

        filtered = point.trace.filtered(carried, np.tile(np.arange(dof), 3), 2)
        turns = [-part.T for part in np.split(filtered, 3)]
        return point.weighted([
            point.slopes.of_motion(*(turn * own for turn in turns)) for own in np.eye(dof)
        ])  # fmt: skip


BESIDE: tuple[Unknown, ...] = (
    FrictionOverSpeed(),
    FrictionByDirection(),
    FrictionByLoad(),
    FrictionOverTime(),
    Lag(),
    WindUp(),
)


def _coulomb(point: Point, joints: Sequence[Joint]) -> Float[np.ndarray, " joints"]:
    """Coulomb's friction of joints, at least what the description says."""
    described = point.dynamics.robot.friction
    sizes = [
        max(abs(point.size(f"coulomb.{joint.name}")), described[joint.name].coulomb)
        for joint in joints
    ]
    return np.array(sizes, dtype=float)
