"""The lag of a torque as its steps tell it, which friction makes where a drive turns round.

A reversal at t_k shows in a torque that is δ late as a step at t_k + δ. With u = t_n − t_k and what
the model makes of the samples about it but for that step, what is left of them is

    r_n = o_k + J_k (α ½ sgn(u − δ) + β u) + noise of level σ,

J_k the model's step; α and β, the same for all reversals of a drive, and o_k are what a wrong
friction law would leave here. Given these,

    log L(δ) = Σ_k Σ_{u > δ} α J_k (r_n − o_k − β J_k u) / σ² + const

is a staircase whose stairs lie at other phases between two samples for each reversal, so δ is known
far better than to a sample, and to a part of what other rows tell. And nothing that varies smoothly
gets in: a wrong friction law, load or gain, which all look like a lag elsewhere, do not here. A fit
leaves these rows out, so what they tell is added to it as the prior of the lag.

Behind a first-order filter of time constant T, ½ sgn is ½ − exp(−(u − δ)/T) after the step, and the
lag is δ + T; that is tried where the samples next to reversals are farther from a step than others,
or show none. Where they still are, as where friction yields before it slips, nothing is told.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.estimation.additions import Addition
from deltaid.estimation.traces import Delay, Trace
from deltaid.identification.torque_steps import (
    Steps,
    behind_filter,
    is_abrupt,
    locally,
    located,
    misfit,
    sharp,
)
from deltaid.recording.windows import WINDOW, Samples

# Samples to either side of a reversal that are looked at beyond what may be lagged by; those nearer
# than the second number may not count because the joint turns round.
_AROUND, _MASKED = 8, 3
# A lag is looked for so far around the known one, and then around the one that is found [s].
_FAR, _NEAR = 0.012, 1.5e-3
# How far samples next to a step may be from the model, in steps.
_SHARP = 0.08
# Share of a sample by which torque and position of a row may be apart, whatever is recorded.
_APART = 0.1

Torques = Float[np.ndarray, "_ dof"]  # each stretch as long as it is


@dataclass(frozen=True, eq=False)
class Told:
    """Lags of the drives of one recording as their reversals tell them.

    Attributes:
        values: [s].
        deviation: their standard deviations; infinite where nothing is told [s].
        filtered: whether the steps went through a filter.
        doubtful: whether steps are seen, but none that friction and a filter explain.
    """

    values: Delay
    deviation: Delay
    filtered: Bool[np.ndarray, " dof"]
    doubtful: Bool[np.ndarray, " dof"]


def lags_of_reversals(
    trace: Trace, additions: Sequence[Addition], p: Parameters, known: Delay
) -> Told:
    """The lag of every drive by its reversals.

    Args:
        trace: a recording, reversals left out.
        additions: columns beside those of the robot.
        p: parameters of both, which go with the known lags.
        known: lags by the other rows [s].
    """
    period = 1.0 / trace.low_pass.rate
    still = np.zeros(len(known), dtype=bool)
    found = Told(known.copy(), np.full(len(known), np.inf), still, still.copy())
    modelled = [_modelled(trace, additions, p, one) for one in trace.stretches]
    for i, start in enumerate(known.tolist()):
        rough = _about_reversals(trace, modelled, i, start, _FAR + period)
        place = located(rough, start, _FAR + period)
        if place is None:
            continue
        steps = _about_reversals(trace, modelled, i, place[0], _NEAR + period)
        near = located(steps, place[0], _NEAR + period)
        if near is None:
            continue
        local = locally(steps, sharp(steps.after, near[0]))
        off = misfit(local, steps, near[0])
        at_once = off < _SHARP and is_abrupt(local, steps, near[0])
        if not at_once:
            near = behind_filter(steps, place[0], period)
            if near is None:
                found.doubtful[i] = True
                continue
        apart = period * max(_APART / np.sqrt(len(steps.jump)), off * at_once)
        found.values[i], found.deviation[i] = near[0], float(np.hypot(near[1], apart))
        found.filtered[i] = not at_once
    return found


def _modelled(
    trace: Trace, additions: Sequence[Addition], p: Parameters, stretch: Samples
) -> tuple[Torques, Torques]:
    """Torques of the model along a stretch, and what of them is friction of the drive itself."""
    dynamics = trace.dynamics
    drives, columns = trace.pattern(additions)
    parameters, names = dynamics.layout.parameters, dynamics.robot.drives
    own = np.array(
        [
            k < len(parameters)
            and parameters[k].kind == "friction"
            and parameters[k].owner == names[i]
            for i, k in zip(drives, columns, strict=True)
        ]
    )
    tau, friction = np.zeros_like(stretch.tau), np.zeros_like(stretch.tau)
    for first in range(0, len(stretch.time), WINDOW):
        part = slice(first, first + WINDOW)
        values = trace.entries(stretch.part(part), additions) * p[columns, None]
        for i in range(dynamics.dof):
            tau[part, i] = values[drives == i].sum(axis=0)
            friction[part, i] = values[(drives == i) & own].sum(axis=0)
    return tau, friction


def _about_reversals(
    trace: Trace,
    modelled: Sequence[tuple[Torques, Torques]],
    drive: int,
    known: float,
    reach: float,
) -> Steps:
    """What is seen of a drive near those of its reversals that lie well apart from others."""
    rate, parts = trace.low_pass.rate, list[Steps]()
    late, width = round(known * rate), int(np.ceil(reach * rate)) + _AROUND
    at = np.arange(-width + 1, width + 1)
    for stretch, (tau, friction) in zip(trace.stretches, modelled, strict=True):
        speed, counts = stretch.qd[:, drive], stretch.weights[:, drive] > 0
        before = np.flatnonzero(speed[:-1] * speed[1:] < 0)
        first, last = width + max(0, -late), len(speed) - 1 - width - max(0, late)
        sure = (before >= first) & (before <= last)
        sure &= np.diff(before, prepend=-np.inf) > 2 * width
        sure &= np.diff(before, append=np.inf) > 2 * width
        before = before[sure]
        rows = before[:, None] + at
        sure = np.ones(len(rows), dtype=bool)
        for by in (0, late):  # where the motion, and where the torque is read
            off = (at + by <= -_MASKED) | (at + by > _MASKED)
            sure &= np.all(counts[rows + by][:, off], axis=1)
        before, rows = before[sure], rows[sure]
        share = speed[before] / (speed[before] - speed[before + 1])
        jump = friction[before + 1, drive] - friction[before, drive]
        smooth = tau[rows, drive] - 0.5 * jump[:, None] * np.where(at > 0, 1.0, -1.0)
        if len(rows):  # the model at the instant of each torque
            smooth += np.gradient(smooth, axis=1) * (late - known * rate)
        left = stretch.tau[rows + late, drive] - smooth
        parts.append(Steps((at + late - share[:, None]) / rate, left, jump))
    return Steps(
        np.concatenate([one.after for one in parts]),
        np.concatenate([one.left for one in parts]),
        np.concatenate([one.jump for one in parts]),
    )
