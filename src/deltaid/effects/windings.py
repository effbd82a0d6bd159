"""Gears that wind up: the torque that they carry, the links' motion behind them, rows along this
motion with lags and free friction, and compliances with their words."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.dynamics.dynamics import Parameters
from deltaid.dynamics.parameters import parameter_layout
from deltaid.effects.joint import SHAPES
from deltaid.effects.lag_columns import late
from deltaid.effects.point import Deviations, StagedEffect, TracePoint
from deltaid.estimation.drive_rows import (
    STRETCHES,
    ColumnsOfDrives,
    OfDrives,
    TraceRows,
    of_own_drives,
)
from deltaid.estimation.scatter import quantile
from deltaid.estimation.traces import Trace
from deltaid.levels import CERTAIN
from deltaid.model.corrections import Correction
from deltaid.recording.filter import design_low_pass
from deltaid.recording.repairs import Gears, convolved
from deltaid.recording.spectrum import HIGHEST
from deltaid.recording.windows import SampleBlock
from deltaid.robot.description import RobotDescription

# Cut-off of the low-pass over the torque that gears carry, as a multiple of that over rows.
_WIDER = 2.5
# Cut-off of a search for compliances and of their columns, as a share of the fit's.
BAND = 0.5
# The torque that a gear carries counts as known from this share of its motor's own torque.
_LOADED = 0.2
# Numbers of a drive's free friction columns: over speed, with load, with time, by direction.
_CAUSES = (len(SHAPES), 1, 2, 2)
_FREE = sum(_CAUSES)
# Usual windup of gears at a drive's largest torque, as a share of the drive's range.
USUAL = 1e-3
# Largest windup of a gear, by the same share: beyond it the linearisation is meaningless.
SOFTEST = 256 * USUAL
# What a stiffness at the joint is in other units, for rotary and linear drives.
UNITS_OF_STIFFNESS = {
    False: "give it in N m/rad at the joint; 1 N m/arcmin is 3438 N m/rad",
    True: "give it in N/m at the rail; 1 N/µm is 1e6 N/m",
}
# A compliance is reported to look like a lag from this correlation.
_ALIKE = 0.9

Compliance = Float[np.ndarray, " dof"]
Groups = Float[np.ndarray, "dof groups"]
Sizes = Float[np.ndarray, " groups"]


def motors_of(
    robot: RobotDescription,
    p: Parameters,
    cutoff: float,
    rate: float,
    compliance: Sequence[float] = (),
) -> Gears:
    """Gears whose motors have the friction and rotors of p, stiff or of given compliances.

    Their low-pass is wide enough not to change rows behind a low-pass of the cut-off [Hz] at the
    rate [1/s].
    """
    names = (parameter.name for parameter in parameter_layout(robot).parameters)
    named = dict(zip(names, p.tolist(), strict=True))

    def both_ways(kind: str) -> tuple[float, ...]:
        """Mean over both directions: half the difference is the same torque either way, constant
        but for viscous friction, and winds a gear up nearly steadily."""
        forth = [named.get(f"{kind}.{drive}", 0.0) for drive in robot.drives]
        back = [named.get(f"{kind}_back.{d}", x) for d, x in zip(robot.drives, forth, strict=True)]
        return tuple(np.mean([forth, back], axis=0).tolist())

    viscous, coulomb, rotor = map(both_ways, ("viscous", "coulomb", "rotor"))
    soft = tuple(compliance) or (0.0,) * len(robot.drives)
    return Gears(soft, viscous, coulomb, rotor, min(_WIDER * cutoff, HIGHEST * rate))


@dataclass(frozen=True, eq=False)
class Windings:
    """A trace of the motors' motion, with the torque τ_g that gears carry along it."""

    trace: Trace  # without the ends where τ_g is not known
    motors: Gears  # with their friction and rotors
    # of each stretch τ_g and its first and second derivative by time
    carried: tuple[Float[np.ndarray, "3 _ dof"], ...]

    @classmethod
    def measured(cls, trace: Trace, motors: Gears) -> "Windings":
        """With τ_g by the measured torques."""
        return cls._along(trace, motors, lambda w: w.tau + w.carried - motors.of_motor(w.qd, w.qdd))

    @classmethod
    def modelled(cls, trace: Trace, motors: Gears, p: Parameters) -> "Windings":
        """With τ_g by the model's torques for p."""
        return cls._along(trace, motors, lambda w: trace.carried(w, p))

    @classmethod
    def _along(
        cls, trace: Trace, motors: Gears, torque: Callable[[SampleBlock], np.ndarray]
    ) -> "Windings":
        """With `torque` and its derivatives as τ_g, without the ends that filters need."""
        low_pass = motors.low_pass(trace.low_pass.rate)
        taps = (low_pass.level, low_pass.first, low_pass.second)
        along = map(torque, trace.stretches)
        carried = [np.array([convolved(tap, tau) for tap in taps]) for tau in along]
        return cls._cut(trace, motors, carried, low_pass.margin)

    @classmethod
    def _cut(
        cls, trace: Trace, motors: Gears, carried: Sequence[np.ndarray], lost: int
    ) -> "Windings":
        """Cut `lost` samples off both ends of each stretch, and drop stretches that end up too
        short for the trace's filter; `carried` is cut already."""
        cut = [
            (w.part(slice(lost, -lost)), c) for w, c in zip(trace.stretches, carried, strict=True)
        ]
        kept = [(w, c) for w, c in cut if replace(trace, stretches=(w,)).is_long(0)]
        stretches, carried = zip(*kept, strict=True) if kept else ((), ())
        return cls(replace(trace, stretches=stretches), motors, tuple(carried))

    def inner(self, times: int) -> "Windings":
        """The same without the ends that this many more passes of the filter need."""
        lost = times * self.motors.low_pass(self.trace.low_pass.rate).margin
        inner = [carried[:, lost:-lost] for carried in self.carried]
        return self._cut(self.trace, self.motors, inner, lost)

    @property
    def loaded(self) -> Bool[np.ndarray, " dof"]:
        """Which gears carry enough beside their motors' own torques for τ_g to be known."""
        carried = np.concatenate([stretch[0] for stretch in self.carried])
        of_motors = [self.motors.of_motor(w.qd, w.qdd) for w in self.trace.stretches]
        return carried.std(axis=0) > _LOADED * np.concatenate(of_motors).std(axis=0)

    def turned(self, compliance: Compliance) -> Trace:
        """The trace of the links' motion behind gears of this compliance."""
        kinematics, stretches = self.trace.dynamics.kinematics, list[SampleBlock]()
        if not np.any(compliance):
            return self.trace
        burden = self.trace.recording.burden(kinematics.robot)
        for w, carried in zip(self.trace.stretches, self.carried, strict=True):
            turn = compliance * carried
            z, _ = kinematics.forward_unchecked(kinematics.inverse(w.z) - turn[0])
            motion = z, w.qd - turn[1], w.qdd - turn[2]
            held = burden(w.time, *motion, w.extra) if burden else w.carried
            tau = w.tau + w.carried - held - self.motors.less(w.qd, w.qdd, turn[1], turn[2])
            stretches.append(SampleBlock(w.time, *motion, tau, w.weights, w.extra, held))
        return replace(self.trace, stretches=tuple(stretches))

    def slopes(self, s: Compliance, steps: Groups, p: Parameters) -> ColumnsOfDrives:
        """Slopes of predicted less measured torques over each size, by differences between
        compliances s and s + step."""
        turned = [self.turned(s + step) for step in (0 * s, *steps.T)]
        before, *after = (trace.model(p) - trace.torques() for trace in turned)
        return np.stack([error - before for error in after], axis=2) / steps.max(axis=0)


def fitted(rows: TraceRows, traces: Sequence[Trace]) -> tuple[list[OfDrives], Parameters]:
    """Residuals of each trace's rows beside lags and free friction, and p of the robot beside lags
    alone: beside free friction, viscous and Coulomb's are hardly identifiable."""
    parts = [rows.of_trace(trace) for trace in traces]
    p = rows.robot_parameters(parts)
    for k, trace in enumerate(traces):
        parts[k] = parts[k].with_columns(late(trace, p))
    freed = [
        part.with_columns(free_friction(trace, trace.load))
        for part, trace in zip(parts, traces, strict=True)
    ]
    x = rows.problem(freed).x
    return [part.tau - part.A @ x for part in freed], rows.robot_parameters(parts)


def free_friction(trace: Trace, p: Parameters) -> ColumnsOfDrives:
    """Columns of each drive's friction beside viscous and Coulomb's: a free curve over speed, one
    that grows with the torque its gear carries by p, with time, and by direction."""
    fastest = np.max([np.abs(w.qd).max(axis=0) for w in trace.stretches], axis=0)
    fastest = np.where(fastest > 0, fastest, 1.0)  # any, of a drive that rests all the time
    first, last = trace.stretches[0].time[0], trace.stretches[-1].time[-1]

    def shapes(w: SampleBlock) -> np.ndarray:
        v, carried = w.qd / fastest, trace.carried(w, p)
        sign, later = np.sign(v), ((w.time - first) / (last - first))[:, None]
        sizes = [shape(np.abs(v)) for shape, _ in SHAPES] + [np.abs(carried), later, later**2]
        return np.hstack([*(sign * size for size in sizes), np.ones_like(v), np.abs(v)]).T

    dof = trace.dynamics.dof
    out = trace.filtered(shapes, np.tile(np.arange(dof), _FREE))
    return of_own_drives(out.reshape(_FREE, dof, -1).transpose(1, 2, 0))


def friction_causes(dof: int) -> tuple[Int[np.ndarray, " columns"], ...]:
    """Numbers of the columns of `free_friction` over speed, load, time and direction."""
    first = np.arange(dof)[:, None] * _FREE
    parts = np.split(np.arange(_FREE), np.cumsum(_CAUSES)[:-1])
    return tuple((first + part).ravel() for part in parts)


@dataclass(frozen=True, eq=False)
class Windup:
    """Compliances of all gears; drives of one group share an estimated size."""

    values: Compliance  # s of every drive [rad/(N m) or m/N]
    groups: Groups  # 1 where a drive belongs to a group, else 0
    # sizes, covariance: of the groups
    sizes: Sizes
    covariance: Float[np.ndarray, "groups groups"]
    like_lag: Sizes  # largest correlation of each size with a lag of its drives, between 0 and 1
    p: Parameters  # of the robot, fitted with these compliances

    @property
    def deviation(self) -> Sizes:
        return np.sqrt(np.diag(self.covariance))

    @property
    def significant(self) -> Bool[np.ndarray, " groups"]:
        """Which sizes are beyond chance."""
        return self.sizes > CERTAIN * self.deviation

    def agrees(self, values: Compliance) -> bool:
        """Whether other compliances differ from these by no more than may be chance."""
        wide = CERTAIN * (self.groups @ self.deviation)
        return bool(np.all(np.abs(values - self.values) <= wide))

    def estimated(self, deviation: Compliance) -> "Windup":
        """The same with the standard deviation of each drive's compliance as the contest estimated
        it; 0 where it is stated."""
        drives = np.flatnonzero((self.values > 0) & (deviation > 0))
        own = np.diag(deviation[drives] ** 2)
        groups, unlike = np.eye(len(self.values))[:, drives], np.zeros(len(drives))
        return replace(
            self, groups=groups, sizes=self.values[drives], covariance=own, like_lag=unlike
        )

    def corrections(self, robot: RobotDescription) -> list[Correction]:
        corrections = list[Correction]()
        wide = float(quantile(np.array([STRETCHES - 1.0]))[0])
        for i in np.flatnonzero(self.values):
            s, drive = float(self.values[i]), robot.drives[i]
            unit, inverse = ("m/N", "N/m") if robot.is_linear(drive) else ("rad/(N m)", "N m/rad")
            evidence, low, high = ", as stated", None, None
            for k in np.flatnonzero(self.groups[i]).tolist():
                half = wide * float(self.deviation[k])
                evidence, low, high = self._evidence(k), s - half, s + half
            text = (
                f"its gear winds up under torque, stiffness {1 / s:.3g} {inverse}{evidence}; "
                "positions are converted to the link side"
            )
            corrections.append(
                Correction(kind="compliance", subject=drive, value=s, low=low, high=high, unit=unit,
                           text=text)
            )  # fmt: skip
        return corrections

    def _evidence(self, k: int) -> str:
        text = f", {self.sizes[k] / self.deviation[k]:.0f} standard deviations with a free lag"
        if self.groups[:, k].sum() > 1:
            text += ", one for all limbs"
        if self.like_lag[k] > _ALIKE:
            text += "; this motion hardly separates it from a lag of the torques "
            text += f"(correlation {self.like_lag[k]:.2f})"
        return text


class WindUp(StagedEffect):
    """q = q_m − s τ_g: gears that wind up under what they carry, s [rad/(N m) or m/N]."""

    name = "compliance"
    is_positive = True

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        """Links turn by −s τ_g, motors as recorded.

        Behind compliant gears, links move by measured torques. Their noise grows with each
        derivative of τ_g and is that of the rows, so columns that contain it bias s towards zero.
        """
        trace, dof = point.trace, point.dof
        low_pass = design_low_pass(BAND * trace.low_pass.cutoff, trace.low_pass.rate, single=True)
        taps, margin = (low_pass.level, low_pass.first, low_pass.second), low_pass.margin

        def turned(w: SampleBlock) -> Float[np.ndarray, "channels samples"]:
            """−τ_g and two derivatives by time; beyond the ends τ_g goes on as before them."""
            ends = ((margin, margin), (0, 0))
            wound = np.pad(trace.carried(w, point.p), ends, "reflect", reflect_type="odd")
            return -np.hstack([convolved(tap, wound) for tap in taps]).T

        filtered = trace.filtered(turned, np.tile(np.arange(dof), 3), margin)
        turn, faster, rise = np.split(filtered.T, 3, axis=1)
        motors = motors_of(trace.dynamics.robot, point.p, trace.low_pass.cutoff, low_pass.rate)
        # Motors have no part in it; the direction of their friction does not change.
        of_motors = np.array(motors.viscous) * faster + np.array(motors.rotor) * rise
        slopes = point.slopes.of_motion
        return point.weighted([
            slopes(turn * unit, faster * unit, rise * unit) - (of_motors * unit).T
            for unit in np.eye(dof)
        ])  # fmt: skip

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        """As gears usually wind up at the largest torque of each drive."""
        return USUAL * np.ptp(point.q, axis=0) / point.largest
