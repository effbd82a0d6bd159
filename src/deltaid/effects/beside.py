"""Effects that stages of their own correct, so that in the contest nothing else explains them."""

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Legendre

from deltaid.effects.joint import (
    SHAPES,
    Joint,
    Shape,
    Speeds,
    of_load,
    one_way,
    one_way_speed,
)
from deltaid.effects.lag_columns import slopes
from deltaid.effects.point import Point
from deltaid.effects.unknown import Deviations, Unknown
from deltaid.estimation.drive_rows import ColumnsOfDrives, of_own_drives
from deltaid.estimation.information import active_columns

# Standard deviations before any recording, of friction beside viscous and Coulomb's as shares of
# Coulomb's: over speed, by direction; as a share of what gears carry; and of how it changes over a
# recording, by the degree of the polynomial.
_CURVE, _ONE_WAY, _LOAD, _WARM = 0.15, 0.1, 0.03, (0.1, 0.03)
# Of what remains of lags [s], and of gears that wind up [rad/(N m) or m/N].
_LAG, _COMPLIANCE = 3e-4, 3e-5


class FrictionOverSpeed(Unknown):
    """Any curve over the speed of each joint."""

    name = "friction-curve"
    is_candidate = False

    def columns(self, point: Point) -> ColumnsOfDrives:
        return point.of_joints(
            [(joint, _of_share(joint, shape)) for joint in point.joints for shape, _ in SHAPES]
        )

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return _CURVE * np.repeat(_coulomb(point, point.joints), len(SHAPES))


class FrictionByDirection(Unknown):
    """What drives' friction has more one way than the other, constant and with the speed."""

    name = "friction-direction"
    is_candidate = False

    def columns(self, point: Point) -> ColumnsOfDrives:
        shapes = [(joint, way) for joint in _driven(point) for way in (one_way, one_way_speed)]
        return point.of_joints(shapes)

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        joints = _driven(point)
        sizes = _ONE_WAY * _coulomb(point, joints)
        return np.repeat(sizes, 2) / np.ravel([[1.0, 2 * joint.fastest] for joint in joints])


class FrictionByLoad(Unknown):
    """A share of what a drive's gear carries."""

    name = "friction-load"
    is_candidate = False

    def columns(self, point: Point) -> ColumnsOfDrives:
        shapes = [(joint, of_load) for joint in _driven(point)]
        return point.of_joints(shapes)

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return np.full(columns.shape[2], _LOAD)


class FrictionOverTime(Unknown):
    """A share of each joint's friction that grows along a recording, and bends."""

    name = "friction-time"
    is_candidate = False
    is_own = True

    def columns(self, point: Point) -> ColumnsOfDrives:
        names, time = point.dynamics.layout.names, point.w.time
        active, Y = active_columns(point.dynamics), point.trace.regressor()
        parts = list[np.ndarray]()
        for joint in point.joints:
            k = [names.index(f"{term}.{joint.name}") for term in ("viscous", "coulomb")]
            torque = Y[:, :, np.searchsorted(active, k)] @ np.abs(point.p[k])
            span = [time[0], max(time[-1], time[0] + 1e-9)]
            parts += [torque * Legendre.basis(n + 1, span)(time) for n in range(len(_WARM))]
        return np.stack(parts, axis=2) if parts else np.zeros((*point.model.shape, 0))

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return np.tile(_WARM, len(point.joints))


class Lag(Unknown):
    """What remains of each drive's lag [s]."""

    name = "lag"
    is_candidate = False
    is_own = True

    def columns(self, point: Point) -> ColumnsOfDrives:
        return of_own_drives(slopes(point.trace, point.p)[:, :, None])

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return np.full(point.dof, _LAG)


class WindUp(Unknown):
    """q = q_m − s τ_g: gears that wind up under what they carry, s [rad/(N m) or m/N]."""

    name = "compliance"
    is_candidate = False
    is_positive = True

    def columns(self, point: Point) -> ColumnsOfDrives:
        dynamics, trace, each = point.dynamics, point.trace, np.eye(point.dof)
        rate, drives = trace.low_pass.rate, np.arange(point.dof)
        carried = [
            trace.filtered(
                lambda w, n=n: _rates(dynamics.carried(w.z, w.qd, w.qdd, point.p).T, rate, n),
                drives, n,
            ).T
            for n in range(3)
        ]  # fmt: skip
        motions = [[-part * own for part in carried] for own in each]
        return point.weighted([point.slopes.of_motion(*motion) for motion in motions])

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        return np.full(point.dof, _COMPLIANCE)


BESIDE: tuple[Unknown, ...] = (
    FrictionOverSpeed(),
    FrictionByDirection(),
    FrictionByLoad(),
    FrictionOverTime(),
    Lag(),
    WindUp(),
)


def _rates(x: np.ndarray, rate: float, n: int) -> np.ndarray:
    """The n-th derivative by time."""
    for _ in range(n):
        x = np.gradient(x, axis=1) * rate
    return x


def _driven(point: Point) -> list[Joint]:
    return [joint for joint in point.joints if joint.drive is not None]


def _coulomb(point: Point, joints: list[Joint] | tuple[Joint, ...]) -> np.ndarray:
    """Coulomb's friction of joints, at least what the description says."""
    described = point.dynamics.robot.friction
    sizes = [
        max(point.coefficient("coulomb", joint), described[joint.name].coulomb) for joint in joints
    ]
    return np.array(sizes, dtype=float)


def _of_share(joint: Joint, shape: Callable[[Speeds], Speeds]) -> Shape:
    return lambda v, C, load: C * shape(v / joint.fastest)
