"""What takes part in the contest of causes: effects with unknown coefficients, among them those
that stages of their own correct, so that in the contest nothing else explains them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float
from numpy.polynomial import Legendre

from deltaid.effects.joint import SHAPES, FrictionJoint, of_load, one_way, one_way_speed, over_speed
from deltaid.effects.lag_columns import late, slope
from deltaid.effects.point import TracePoint
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.estimation.information import active_columns
from deltaid.model.corrections import Correction, Kind
from deltaid.recording.windows import SampleBlock
from deltaid.robot.description import RobotDescription

# What nobody described makes some such share of a drive's torque, before any recording [rms].
SIZE = 0.05
# Standard deviations before any recording, of friction beside viscous and Coulomb's as shares of
# Coulomb's: over speed, by direction; and of how it changes over a recording, by the degree of the
# polynomial.
_CURVE, _ONE_WAY, _WARM = 0.15, 0.1, (0.1, 0.03)
# What gears usually wind up by at a drive's largest torque, as a share of the drive's range.
_USUAL = 1e-3

Deviations = Float[np.ndarray, " coefficients"]


class UnknownEffect(ABC):
    """An effect in the contest."""

    name: str  # of the effect
    # standard deviation of each coefficient before any recording, where it is the same for all; 0
    # if not
    deviation: ClassVar[float] = 0.0
    # kind, unit, text: of the corrections of each subject, whose unit is that of the drive's
    # coordinate if not given; no text where other stages say what was corrected
    kind: ClassVar[Kind]
    unit: ClassVar[str] = ""
    text: ClassVar[str] = ""
    # whether it is named and corrected where rows need it; else it only keeps others from
    # explaining what it may be, and stages of their own correct it
    is_candidate: ClassVar[bool] = True
    is_positive: ClassVar[bool] = False  # whether its coefficients are at least zero by physics
    # whether parts are made and mounted within a few times its deviation
    is_of_parts: ClassVar[bool] = True
    is_own: ClassVar[bool] = False  # whether each recording has its own
    # what its coefficients are applied to exactly: readings of the drives, the robot, or nothing
    # where they stay columns of a fit or stages of their own estimate them
    corrects: ClassVar[Literal["readings", "robot", ""]] = ""
    # whether the fit estimates it anew, as parameters of the robot
    is_fitted: ClassVar[bool] = False
    # size of all coefficients together above which the description is wrong, or something else
    # looks like it: that is said and not corrected
    limit: ClassVar[float] = np.inf

    @abstractmethod
    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        """Slopes of the torques by its coefficients."""

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        """Standard deviations of its coefficients before any recording; where nothing is known
        those that make `SIZE` of the drives' largest torques."""
        if self.deviation:
            return np.full(columns.shape[2], self.deviation)
        own = np.sqrt(np.mean((columns / point.largest[:, None, None]) ** 2, axis=(0, 1)))
        return SIZE / np.maximum(own, np.finfo(float).tiny ** 0.5)

    def stated(self, robot: RobotDescription) -> Deviations:
        """Standard deviations that parts may have besides, as a description states them; one zero
        where it has none."""
        return np.zeros(1)

    def is_possible(self, values: Deviations) -> bool:
        """Whether physics allows such coefficients; others stand for another cause."""
        return True

    def possible(self, values: Deviations) -> Deviations:
        """Coefficients as physics allows them."""
        return np.maximum(values, 0.0) if self.is_positive else values

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        """What was corrected, for coefficients and half widths of their 95 % intervals."""
        if not self.text:
            return ()
        scale = 100.0 if self.unit == "%" else 1.0
        sizes = (scale * np.stack([values, half], axis=1)).tolist()
        return tuple(
            Correction(kind=self.kind, subject=subject, value=value, low=value - wide,
                       high=value + wide, unit=self.unit or robot.units(subject).coordinate,
                       text=self.text)
            for subject, (value, wide) in zip(self.subjects(robot), sizes, strict=True)
        )  # fmt: skip

    def subjects(self, robot: RobotDescription) -> Sequence[str]:
        """Whose coefficients these are: the drives', if not said otherwise."""
        return robot.drives

    def doubt(self, values: Deviations) -> str:
        """A sentence on what is beyond the limit: what torques look like, the likeliest cause, and
        what to do."""
        return ""


class Added(UnknownEffect):
    """An effect whose columns are an addition to the fit."""

    def __init__(self, name: str, addition: Addition) -> None:
        self.name, self.addition = name, addition

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.added(self.addition)


class FrictionOverSpeed(UnknownEffect):
    """Any curve over the speed of each joint."""

    name = "friction-curve"
    is_candidate = False

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.of_joints(
            [(joint, over_speed(joint, shape)) for joint in point.joints for shape, _ in SHAPES]
        )

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        return _CURVE * np.repeat(_coulomb(point, point.joints), len(SHAPES))


class FrictionByDirection(UnknownEffect):
    """What drives' friction has more one way than the other, constant and with the speed."""

    name = "friction-direction"
    is_candidate = False

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        ways = (one_way, one_way_speed)
        return point.of_joints([(joint, way) for joint in point.driven for way in ways])

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        sizes = _ONE_WAY * _coulomb(point, point.driven)
        return np.repeat(sizes, 2) / np.ravel([[1.0, 2 * joint.fastest] for joint in point.driven])


class FrictionByLoad(UnknownEffect):
    """A share of what a drive's gear carries."""

    name = "friction-load"
    is_candidate = False
    deviation = 0.03

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.of_joints([(joint, of_load) for joint in point.driven])


class FrictionOverTime(UnknownEffect):
    """A share of each joint's friction that grows along a recording, and bends."""

    name = "friction-time"
    is_candidate = False
    is_own = True

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        names, time = point.dynamics.layout.names, point.motion.time
        active, Y = active_columns(point.dynamics), point.trace.regressor()
        span, parts = [time[0], max(time[-1], time[0] + 1e-9)], list[np.ndarray]()
        for joint in point.joints:
            k = [names.index(f"{term}.{joint.name}") for term in ("viscous", "coulomb")]
            torque = Y[:, :, np.searchsorted(active, k)] @ np.abs(point.p[k])
            parts += [torque * Legendre.basis(n + 1, span)(time) for n in range(len(_WARM))]
        return np.stack(parts, axis=2) if parts else np.zeros((*point.model.shape, 0))

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        return np.tile(_WARM, len(point.joints))


class RemainingLag(UnknownEffect):
    """What remains of each drive's lag [s]."""

    name = "lag"
    is_candidate = False
    is_own = True
    deviation = 3e-4

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return late(point.trace, point.p)


class WindUp(UnknownEffect):
    """q = q_m − s τ_g: gears that wind up under what they carry, s [rad/(N m) or m/N]."""

    name = "compliance"
    is_candidate = False
    is_positive = True

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        dof, rate = point.dof, point.trace.low_pass.rate

        def carried(w: SampleBlock) -> Float[np.ndarray, "channels samples"]:
            """τ_g and two derivatives by time."""
            level = point.dynamics.carried(w.z, w.qd, w.qdd, point.p).T
            first = rate * slope(level)
            return np.vstack([level, first, rate * slope(first)])

        filtered = point.trace.filtered(carried, np.tile(np.arange(dof), 3), 2)
        turns = [-part.T for part in np.split(filtered, 3)]
        return point.weighted([
            point.slopes.of_motion(*(turn * unit for turn in turns)) for unit in np.eye(dof)
        ])  # fmt: skip

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        """As gears usually wind up at the largest torque of each drive."""
        return _USUAL * np.ptp(point.q, axis=0) / point.largest


BESIDE: tuple[UnknownEffect, ...] = (
    FrictionOverSpeed(),
    FrictionByDirection(),
    FrictionByLoad(),
    FrictionOverTime(),
    RemainingLag(),
    WindUp(),
)


def _coulomb(point: TracePoint, joints: Sequence[FrictionJoint]) -> Float[np.ndarray, " joints"]:
    """Coulomb's friction of joints, at least what the description says."""
    described = point.dynamics.robot.friction
    sizes = [
        max(abs(point.size(f"coulomb.{joint.name}")), described[joint.name].coulomb)
        for joint in joints
    ]
    return np.array(sizes, dtype=float)
