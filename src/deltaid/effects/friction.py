"""Friction that viscous and Coulomb's do not describe: near rest, at speed, one way, by load."""

from collections.abc import Iterable

import numpy as np

from deltaid.effects.effect import Cause, DescribedEffect
from deltaid.effects.joint import SHAPES, of_load, one_way, one_way_speed, over_speed
from deltaid.effects.point import EffectCandidate, RigidFit

_WAY, _LOAD = "friction that differs by direction", "friction that grows with the load"


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
