"""Friction that viscous and Coulomb's do not describe: near rest, at speed, one way, by load."""

from collections.abc import Callable, Iterable

import numpy as np

from deltaid.effects.cause import Cause
from deltaid.effects.effect import DescribedEffect, torque_of
from deltaid.effects.joint import SHAPES, Joint, Shape, Speeds, of_load, one_way, one_way_speed
from deltaid.effects.rigid_fit import Candidate, RigidFit
from deltaid.model.words import percent

_WAY, _LOAD = "friction that differs by direction", "friction that grows with the load"


class FrictionLaw(DescribedEffect):
    """Terms that a joint's friction law lacks, of one joint or of all."""

    kind = "friction-law"

    def candidates(self, fit: RigidFit) -> Iterable[Candidate]:
        if not fit.joints:
            return
        yield from self._by_speed(fit)
        drives = [joint for joint in fit.joints if joint.drive is not None]
        if not drives:
            return
        shapes = [(joint, shape) for shape in (one_way, one_way_speed) for joint in drives]
        by_direction = fit.joint_columns(shapes)
        loads = fit.joint_columns([(joint, of_load) for joint in drives])
        count = len(drives)
        for i, joint in enumerate(drives):
            yield Candidate(self.kind, joint.name, by_direction[:, [i, count + i]], _WAY)
            yield Candidate(self.kind, joint.name, loads[:, [i]], _LOAD)
        yield Candidate(self.kind, "", by_direction[:, :count], _WAY)
        yield Candidate(self.kind, "", by_direction, _WAY)
        yield Candidate(self.kind, "", loads, _LOAD)

    def _by_speed(self, fit: RigidFit) -> Iterable[Candidate]:
        coulomb = np.array([fit.size(f"coulomb.{joint.name}") for joint in fit.joints])
        shapes = [(joint, _of_share(joint, shape)) for shape, _ in SHAPES for joint in fit.joints]
        by_shape = np.split(fit.joint_columns(shapes), len(SHAPES), axis=1)
        for columns, (_, words) in zip(by_shape, SHAPES, strict=True):
            yield Candidate(self.kind, "", (columns @ coulomb)[:, None], words)
            yield Candidate(self.kind, "", columns, words)
            for i, joint in enumerate(fit.joints):
                yield Candidate(self.kind, joint.name, columns[:, [i]], words)

    def seen(self, cause: Cause, subject: str, share: float) -> tuple[float, str, str]:
        follows = f"{percent(share)} of {torque_of(subject)} follows the speed"
        return 100 * share, "%", f"{follows} and is not explained: {cause.first.words}"

    def why(self, cause: Cause) -> str:
        other = (
            "the torque channel has an offset" if cause.first.words == _WAY else "gears have play"
        )
        return f"the described friction law has no term for it, or {other}"

    def cure(self, cause: Cause) -> str:
        del cause
        return "deltaid identify adds the term; or describe it"


def _of_share(joint: Joint, shape: Callable[[Speeds], Speeds]) -> Shape:
    return lambda v, C, load: C * shape(v / joint.fastest)
