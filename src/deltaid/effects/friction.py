"""Friction that viscous and Coulomb's do not describe: near rest, at speed, one way, by load, over
time; and that of drives whose description has none."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float
from numpy.polynomial import Legendre

from deltaid.effects.effect import Cause, DescribedEffect, Effect, torque_of
from deltaid.effects.joint import SHAPES, FrictionJoint, of_load, one_way, one_way_speed, over_speed
from deltaid.effects.point import Deviations, EffectCandidate, RigidFit, StagedEffect, TracePoint
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.estimation.information import active_columns
from deltaid.model.verdict import percent

_WAY, _LOAD = "friction that differs by direction", "friction that grows with the load"
# Time constants of warming up, as shares of the recording.
_WARM = (0.1, 0.25, 0.6)
# Standard deviations before any recording, of friction beside viscous and Coulomb's as shares of
# Coulomb's: over speed, by direction; and of how it changes over a recording, by the degree of the
# polynomial.
_CURVE, _ONE_WAY, _BENT = 0.15, 0.1, (0.1, 0.03)


class FrictionLaw(DescribedEffect):
    """Terms that a joint's friction law lacks, of one joint or of all."""

    kind = "friction-law"
    follows = "the speed"
    fix = "deltaid identify adds the term; or describe it"

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        joints, names = fit.joints, [joint.name for joint in fit.joints]
        if not joints:
            return
        coulomb = np.array([fit.size(f"coulomb.{name}") for name in names])
        shapes = [(joint, over_speed(joint, shape)) for shape, _ in SHAPES for joint in joints]
        by_shape = np.split(fit.rows.stack(fit.of_joints(shapes)), len(SHAPES), axis=1)
        for columns, (_, words) in zip(by_shape, SHAPES, strict=True):
            yield EffectCandidate(self.kind, "", (columns @ coulomb)[:, None], words)
            yield from self.of_each(names, columns, words)
        drives, count = fit.driven, len(fit.driven)
        if not drives:
            return
        shapes = [(joint, way) for way in (one_way, one_way_speed) for joint in drives]
        by_direction = fit.rows.stack(fit.of_joints(shapes))
        for i, joint in enumerate(drives):
            yield EffectCandidate(self.kind, joint.name, by_direction[:, [i, count + i]], _WAY)
        yield EffectCandidate(self.kind, "", by_direction[:, :count], _WAY)
        yield EffectCandidate(self.kind, "", by_direction, _WAY)
        loads = fit.rows.stack(fit.of_joints([(joint, of_load) for joint in drives]))
        yield from self.of_each([joint.name for joint in drives], loads, _LOAD)

    def why(self, cause: Cause) -> str:
        one_way = cause.first.words == _WAY
        other = "the torque channel has an offset" if one_way else "gears have play"
        return f"the described friction law has no term for it, or {other}"


class Drift(StagedEffect, DescribedEffect):
    """Friction that changes steadily or as in warming up, or an offset that does; in the contest a
    share of each joint's friction that grows along a recording, and bends."""

    kind = "drift"
    name = "friction-time"
    is_own = True
    likeliest = (
        "friction that falls while gears and grease warm up, or a torque channel that drifts"
    )
    fix = "move the robot until it is warm before recording, and record shorter"

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        time, joints = fit.motion.time, [joint.name for joint in fit.joints]
        share = (time - time[0]) / (time[-1] - time[0])
        courses = [("steadily", share - 0.5)]
        courses += [("as in warming up", np.exp(-share / constant)) for constant in _WARM]
        names = [(f"viscous.{joint}", f"coulomb.{joint}") for joint in joints]
        friction = [sum(fit.column(name) * fit.size(name) for name in pair) for pair in names]
        for words, course in courses:
            if friction:
                columns = np.stack([fit.rows.stack(column * course) for column in friction], axis=1)
                yield EffectCandidate(self.kind, "", columns.sum(axis=1)[:, None], words)
                yield from self.of_each(joints, columns, words)
            offset = fit.rows.per_drive(fit.motion.weights.T * course)
            for i, drive in enumerate(fit.drives):
                yield EffectCandidate(self.kind, drive, offset[:, [i]], words)

    def seen(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        changes = f"{percent(share)} of {torque_of(subject)} changes with time"
        return 100 * share, "%", f"{changes}, {cause.first.words}, and is not explained"

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        names, time = point.dynamics.layout.names, point.motion.time
        active, Y = active_columns(point.dynamics), point.trace.regressor()
        span, parts = [time[0], max(time[-1], time[0] + 1e-9)], list[np.ndarray]()
        for joint in point.joints:
            k = [names.index(f"{term}.{joint.name}") for term in ("viscous", "coulomb")]
            torque = Y[:, :, np.searchsorted(active, k)] @ np.abs(point.p[k])
            parts += [torque * Legendre.basis(n + 1, span)(time) for n in range(len(_BENT))]
        return np.stack(parts, axis=2) if parts else np.zeros((*point.model.shape, 0))

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        return np.tile(_BENT, len(point.joints))


class MissingFriction(Effect):
    """Viscous and Coulomb friction; a verdict on the description reports it."""

    kind = "friction-missing"

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        friction = fit.dynamics.robot.friction
        without = [i for i, drive in enumerate(fit.drives) if drive not in friction]
        if without:
            every = np.arange(fit.dof)
            signs = fit.trace.filtered(lambda w: np.sign(w.qd).T, every)
            speeds = fit.trace.filtered(lambda w: w.qd.T, every)
            columns = np.hstack(
                [fit.rows.per_drive(rates)[:, without] for rates in (signs, speeds)]
            )
            yield EffectCandidate(self.kind, "", columns, is_preferred=True)


class FrictionOverSpeed(StagedEffect):
    """Any curve over the speed of each joint."""

    name = "friction-curve"

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.of_joints(
            [(joint, over_speed(joint, shape)) for joint in point.joints for shape, _ in SHAPES]
        )

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        return _CURVE * np.repeat(_coulomb(point, point.joints), len(SHAPES))


class FrictionByDirection(StagedEffect):
    """What drives' friction has more one way than the other, constant and with the speed."""

    name = "friction-direction"

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        ways = (one_way, one_way_speed)
        return point.of_joints([(joint, way) for joint in point.driven for way in ways])

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        sizes = _ONE_WAY * _coulomb(point, point.driven)
        return np.repeat(sizes, 2) / np.ravel([[1.0, 2 * joint.fastest] for joint in point.driven])


class FrictionByLoad(StagedEffect):
    """A share of what a drive's gear carries."""

    name = "friction-load"
    deviation = 0.03

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.of_joints([(joint, of_load) for joint in point.driven])


def _coulomb(point: TracePoint, joints: Sequence[FrictionJoint]) -> Float[np.ndarray, " joints"]:
    """Coulomb's friction of joints, at least what the description says."""
    described = point.dynamics.robot.friction
    sizes = [
        max(abs(point.size(f"coulomb.{joint.name}")), described[joint.name].coulomb)
        for joint in joints
    ]
    return np.array(sizes, dtype=float)
