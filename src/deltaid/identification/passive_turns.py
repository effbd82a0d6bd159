"""Exclusion of rows near reversals of passive joints with friction.

Friction of a passive joint steps where the joint reverses. On a robot that differs from its
description it reverses elsewhere: a zero that is off by 7 mrad turns the platform of a Par4 by 0.26
rad. The step, up to a sixth of the largest torque, has no slope by such an error.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from jaxtyping import Float

from deltaid.effects.geometry import reshaped
from deltaid.estimation.scatter import NORMAL
from deltaid.estimation.traces import Trace
from deltaid.identification.setup import ContestOutcome
from deltaid.mechanism.kinematics import Kinematics, Samples
from deltaid.recording.windows import SampleBlock

# Of each passive joint with friction [rad/s or m/s].
OfPassive = Float[np.ndarray, " passive"]


def speed_errors(traces: Sequence[Trace], outcome: ContestOutcome) -> OfPassive:
    """95 % bounds of the errors of passive joints' speeds, if as large as their changes by the
    zeros, gear ratios, lengths and mounting of an outcome; zero for a joint that is slower half of
    the time, for few rows would remain.

    Args:
        traces: recordings as described.

    Raises:
        KinematicsError: the corrected robot could not be in the recorded poses.
    """
    described = traces[0].dynamics.kinematics
    shapes = [outcome.coefficients(name) for name in ("length", "mounting")]
    corrected = Kinematics(reshaped(outcome.described, *shapes))
    zero, ratio = (np.array(outcome.coefficients(name) or 0.0) for name in ("zero", "gear-ratio"))
    changes, speeds = list[np.ndarray](), list[np.ndarray]()
    for part in chain.from_iterable(trace.stretches for trace in traces):
        z = corrected.forward(described.inverse(part.z) * (1.0 + ratio) + zero)
        speeds.append(_speeds(described, part.z, part.qd))
        changes.append(_speeds(corrected, z, part.qd * (1.0 + ratio)) - speeds[-1])
    errors = NORMAL * np.sqrt(np.mean(np.vstack(changes) ** 2, axis=0))
    return np.where(errors < np.median(np.abs(np.vstack(speeds)), axis=0), errors, 0.0)


def without_turns(trace: Trace, errors: OfPassive) -> Trace:
    """A trace without rows of drives that a passive joint acts on which may turn either way."""
    if not errors.any():
        return trace
    kinematics = trace.dynamics.kinematics
    moved_by = kinematics.passive_friction.moved_by

    def sure(part: SampleBlock) -> SampleBlock:
        may_turn = np.abs(_speeds(kinematics, part.z, part.qd)) < errors
        return replace(part, weights=np.where(may_turn @ moved_by, 0.0, part.weights))

    return replace(trace, stretches=tuple(sure(part) for part in trace.stretches))


def _speeds(
    kinematics: Kinematics, z: Samples, qd: Samples
) -> Float[np.ndarray, "samples passive"]:
    return kinematics.passive_friction.rates(z, qd, np.zeros_like(qd)).speed
