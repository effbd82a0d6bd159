"""Exclusion of rows near reversals of passive joints with friction.

Friction of a passive joint steps where the joint reverses. On a robot that differs from its
description it reverses elsewhere: a zero that is off by 7 mrad turns the platform of a Par4 by 0.26
rad. The step, up to a sixth of the largest torque, has no slope by such an error. Behind compliant
gears, noise of torques is noise of the links' speeds, and a tenth of a compliance as large an error
as such a zero: there only rows in which the joint is fast are certain.
"""

from collections.abc import Sequence
from itertools import chain

import numpy as np
from jaxtyping import Float

from deltaid.effects.geometry import reshaped
from deltaid.errors import KinematicsError
from deltaid.estimation.scatter import NORMAL
from deltaid.estimation.traces import Trace
from deltaid.identification.contest import Contest
from deltaid.identification.setup import Coefficients, ContestOutcome
from deltaid.mechanism.kinematics import Kinematics

# Effects that change speeds of passive joints.
_MOVES = ("zero", "gear-ratio", "length", "mounting")
# Draws of errors.
_DRAWS = 8

# Speed of each passive joint with friction [rad/s or m/s].
Speeds = Float[np.ndarray, "samples passive"]


def usual_speeds(traces: Sequence[Trace]) -> tuple[float, ...]:
    """Medians of the speeds of passive joints with friction."""
    speeds = _speeds(traces, traces[0].dynamics.kinematics, {})
    return tuple(np.median(np.abs(speeds), axis=0).tolist())


def speed_errors(
    traces: Sequence[Trace],
    last: Contest,
    after: ContestOutcome,
    before: dict[str, Coefficients],
    applied: dict[str, Coefficients],
) -> tuple[float, ...]:
    """Bounds of the errors of passive joints' speeds by errors of the zeros, gear ratios, lengths
    and mounting of an outcome; at most the usual speeds, so that rows remain. Empty where no joint
    has such errors.

    They are the largest change by coefficients that are not applied, and 95 % of what the last
    step and random errors of the coefficients change.

    Args:
        traces: recordings as described.
        last: the reduced sweep that the outcome `after` is of.
        before: coefficients of the sweep before.
        applied: coefficients by which recordings and robot are corrected.

    Raises:
        KinematicsError: the corrected robot could not be in the recorded poses.
    """
    dynamics = traces[0].dynamics
    named = [name for name in _MOVES if name in {*after.values, *before, *applied}]
    if not named:
        return ()

    def speeds(values: dict[str, Coefficients]) -> Speeds:
        shapes = [tuple(values.get(name, np.zeros(0)).tolist()) for name in ("length", "mounting")]
        corrected = Kinematics(reshaped(after.described, *shapes)) if any(shapes) else None
        return _speeds(traces, corrected or dynamics.kinematics, values)

    best = speeds(after.values)
    kept = [name for name in named if name in after.values and name in last.shrunk.candidates]
    try:
        scatter = [
            speeds(after.values | {name: after.values[name] + x for name, x in errors.items()})
            - best
            for errors in last.errors(kept, _DRAWS)
        ]
    except KinematicsError:  # errors so large that poses are out of reach
        return usual_speeds(traces)
    squares = [(speeds(before) - best) ** 2, sum(change**2 for change in scatter) / _DRAWS]
    random = NORMAL * np.sqrt(np.mean(sum(squares), axis=0))
    bounds = np.abs(speeds(applied) - best).max(axis=0) + random
    bounds = np.minimum(bounds, usual_speeds(traces))
    return tuple(bounds.tolist()) if bounds.any() else ()


def _speeds(
    traces: Sequence[Trace], corrected: Kinematics, values: dict[str, Coefficients]
) -> Speeds:
    """Speeds of a corrected robot behind corrected readings."""
    described = traces[0].dynamics.kinematics
    zero, ratio = (values.get(name, 0.0) for name in ("zero", "gear-ratio"))
    speeds = list[np.ndarray]()
    for part in chain.from_iterable(trace.stretches for trace in traces):
        z = corrected.forward(described.inverse(part.z) * (1.0 + ratio) + zero)
        qd = part.qd * (1.0 + ratio)
        speeds.append(corrected.passive_friction.rates(z, qd, np.zeros_like(qd)).speed)
    return np.vstack(speeds)
