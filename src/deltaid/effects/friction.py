"""Friction beside viscous and Coulomb's: near rest, at high speed, by direction, by load."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from deltaid.effects.effect import Cause, DescribedEffect
from deltaid.effects.joint import (
    BY_DIRECTION,
    ONE_WAY,
    SHAPES,
    of_load,
    one_way,
    one_way_speed,
    over_speed,
)
from deltaid.effects.point import Deviations, EffectCandidate, RigidFit, StagedEffect, TracePoint
from deltaid.estimation.drive_rows import ColumnsOfDrives

_WAY, _LOAD = "friction that differs by direction", "friction that grows with the load"
# Prior standard deviation of friction over speed, as a share of Coulomb's.
_CURVE = 0.15


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


class FrictionOverSpeed(StagedEffect):
    """Friction of each joint as a free curve over its speed."""

    name = "friction-curve"

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.of_joints(
            [(joint, over_speed(joint, shape)) for joint in point.joints for shape, _ in SHAPES]
        )

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        return _CURVE * np.repeat(point.coulomb(point.joints), len(SHAPES))


class FrictionByDirection(StagedEffect):
    """Friction of drives that differs by direction: a constant and a part that grows with speed."""

    name = BY_DIRECTION

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        ways = (one_way, one_way_speed)
        return point.of_joints([(joint, way) for joint in point.driven for way in ways])

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        sizes = ONE_WAY * point.coulomb(point.driven)
        return np.repeat(sizes, 2) / np.ravel([[1.0, 2 * joint.fastest] for joint in point.driven])


class FrictionByLoad(StagedEffect):
    """Friction of drives as a share of the torque that their gears carry: without the rotors, and
    with them, for torques without friction determine only the sum of a rotor and what its gear
    moves."""

    name = "friction-load"
    deviation = 0.03

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        rotors = {f"rotor.{joint.name}": joint for joint in point.driven}
        with_rotors = [
            replace(rotors[name], moved=point.size(name))
            for name in point.dynamics.layout.names if name in rotors
        ]  # fmt: skip
        return point.of_joints([(joint, of_load) for joint in (*point.driven, *with_rotors)])
