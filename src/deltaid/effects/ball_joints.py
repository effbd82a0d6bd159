"""Friction of the ball joints at both ends of the struts, which a description lacks:

    τ = Y p + ∂/∂q̇ Σ_i ((c − d) |ω_e,i| + (c + d) |ω_p,i|)

with the rates ω_e,i and ω_p,i at which the struts of limb i turn on its arm or carriage and on the
platform. The friction of a joint turns against its rate, whatever the axis.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from deltaid.effects.along_motion import AlongMotion, InTask
from deltaid.effects.effect import DescribedEffect
from deltaid.effects.point import EffectCandidate, RigidFit, TracePoint
from deltaid.estimation.additions import Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.recording.masks.masks import RESTS


class BallJointFriction(AlongMotion):
    """c, d: mean moment of the joints at the ends of a limb's struts, and what the platform's are
    above it; with carriages, which do not turn, only c acts."""

    kind = "joint-friction"
    name = "joint-friction"
    symbols = ("moment", "difference")

    @property
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        rows = zip(self.symbols, self.deviation, strict=True)
        return [("struts", symbol, "N m", size) for symbol, size in rows]

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        drives = np.arange(self.dynamics.dof)
        return np.tile(drives, 2), np.repeat((0, 1), len(drives))

    def of_motion(self, z: InTask, qd: InTask, qdd: InTask) -> Values:
        strut = float(np.mean([limb.strut for limb in self.dynamics.robot.limb_geometry]))
        torques = self.dynamics.kinematics.ball_joints.torques(z, qd, RESTS * self.fastest / strut)
        on_arms, on_platform = torques.transpose(2, 1, 0)
        return np.concatenate([on_platform + on_arms, on_platform - on_arms])

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        text = "the ball joints at the ends of each limb's struts have friction"
        return (self.correction("struts", judged[0].value, judged[:1], "N m", text),)


class RubbingJoints(DescribedEffect):
    """The same in the residual of a study."""

    kind = "joint-friction"
    is_contested = True
    likeliest = "ball joints of the struts are dry, worn or pressed together too hard"
    fix = "clean the joints and check their springs; deltaid identify corrects it from a recording"
    follows = "the turns of the struts in their ball joints"

    def candidates(self, fit: RigidFit) -> Iterable[EffectCandidate]:
        for friction in of_ball_joints(fit):
            columns = fit.rows.stack(fit.added(friction))
            yield EffectCandidate(self.kind, "", columns, "friction of ball joints")


def of_ball_joints(point: TracePoint) -> tuple[BallJointFriction, ...]:
    """With a prior of 1 N m; none for a user-defined mechanism, whose joints are not known."""
    dynamics, prior = point.dynamics, (1.0,) * len(BallJointFriction.symbols)
    if not dynamics.kinematics.mechanism.limbs:
        return ()
    return (BallJointFriction(dynamics, (), prior, fastest=point.fastest_platform),)
