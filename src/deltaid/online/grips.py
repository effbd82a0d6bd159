"""Estimate the offset between the gripper's signal and the torques, and correct the load for it.

Estimates follow the signal: a load begins or ends with it (`changes`). In addition, candidate
times θ_j are kept at which it may really have been taken or released, and the case of neither.
Between θ_j and the signal, estimates lack a load of the mass m, or have one too many; this has
moved innovations and estimates by G m and F m since, which gives D and C as in `changes`. With the
estimate x ± √P of a load that is taken at the signal, the mass and its likelihood for θ_j are

    A = C + (1 + F)²/P,   B = D + (1 + F) x/P,   m = B/A ± 1/√A,
    w_j ∝ π(θ_j) exp(½ B²/A) / √(A P),

with F of the mass itself, and π Laplace's density about the signal plus a weight at the signal.
The mass of a released load is known. Torques before the signal may also be a push of any size.
Until the time is decided, outputs follow from the mixture. Once the spread of times is within a
step, or the load has hardly a chance to come, the mean of the mixture becomes the estimate.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.levels import UNLIKELY
from deltaid.online.changes import EVERY, Change, Onsets
from deltaid.online.graph import CycleFields
from deltaid.online.instant import UNKNOWN
from deltaid.online.kalman import Estimate
from deltaid.online.settings import SOON

# Typical error of a signal [s]; prior weight of a signal without error, relative to one of the
# other candidate times.
_TYPICAL, _IN_TIME = 0.05, 3.0
# Time after the signal and after the load surely came, from which the load's time is decided [s].
_AFTER = 0.04
# Time after the signal from which the mixture is used if the load surely came at an undetermined
# time [s].
_SETTLED = 0.1
# Least share of a load released before the signal that estimates contain, and relative deviation of
# its mass.
_MOVED, _ROUGH = 0.3, 0.1
# Prior odds of a push before the signal against an early load, in units of χ²: one in a hundred.
_PUSHED = -2 * np.log(UNLIKELY)


@dataclass(frozen=True, eq=False)
class Grip:
    """Estimate of when a load was taken or released, before a cycle's torques.

    Attributes:
        open_: 1 while the time is undecided, in this cycle.
        closes: 1 in the cycle in which it is decided.
        likely: estimates corrected for it.
        present: released mass that may still be there, in units of the largest.
        variance: least variance of the mass.
        remembered: torque of the load that filters remember from before it was taken or released,
            and that estimates do not contain.
        offset: of the signal [s].
    """

    open_: ca.SX
    closes: ca.SX
    likely: Estimate
    present: ca.SX
    variance: ca.SX
    remembered: ca.SX
    offset: ca.SX


def follow_grip(
    fields: CycleFields, grip: Grip, load: ca.SX, change: Change, period: float
) -> None:
    """Set the state of the next cycle.

    Args:
        load: its entries in the estimates before the change.
    """
    since, signalled = fields.before["since_grip"], change.signalled
    let_go = ca.logic_and(signalled, ca.logic_not(change.held))
    fields.following |= {
        "gripping": ca.fmax(grip.open_, signalled),
        # On average the signal came half a cycle before it was read.
        "since_grip": ca.if_else(signalled, 0.5 * period, ca.fmin(since + period, 1.0)),
        "left": ca.if_else(let_go, load, fields.before["left"]),
        "offset": ca.if_else(signalled, UNKNOWN, grip.offset),
    }


def grip_before(
    fields: CycleFields,
    onsets: Onsets,
    estimate: Estimate,
    gripper: ca.SX,
    differs: ca.SX,
) -> Grip:
    """Estimate of when a load was taken or released, from previous cycles.

    Args:
        estimate: after the previous cycle.
        gripper: its signal.
        differs: 1 where the signal differs from the state.
    """
    names = ("held", "gripping", "since_grip", "left", "offset")
    P0 = ca.fmax(estimate.P[0, 0], 1e-9)
    held, was_open, since, left, known_offset = (fields.before[name] for name in names)
    times = _times(onsets, since, left, held, estimate.x[0], P0)
    weight, off, masses, variances, change, moment = times
    came = ca.sum2(weight) + 1e-12
    offset = ca.sum2(weight * off) / came
    spread = ca.sum2(weight * (off - offset) ** 2) / came
    sure = ca.logic_and(came > 1 - UNLIKELY, since + ca.fmin(offset, 0) > _AFTER)
    timed = ca.logic_and(was_open, ca.logic_and(sure, spread < EVERY**2))
    late = since > ca.if_else(sure, _SETTLED, SOON)
    over = ca.logic_or(late, ca.logic_or(gripper <= -0.5, differs))
    closes = ca.logic_and(was_open, ca.logic_or(timed, over))
    mass = ca.sum2(weight * masses) / came
    variance = ca.sum2(weight * (variances + (masses - mass) ** 2)) / came
    moves = weight * change / came
    per_time = onsets.symbols.moved[:, :-1]
    moved = per_time @ moves[:, :-1].T
    squares = ca.sum2(weight * (variances + masses**2))
    share = per_time @ (weight * moment / squares)[:, :-1].T
    known = _with_load(estimate, moved, share, mass, variance, P0)
    likely = chosen_estimate(held, known, _without_load(estimate, moved, left.numel()))
    likely = chosen_estimate(was_open, likely, estimate)
    to_come, open_ = 1 - came, ca.if_else(closes, 0.0, was_open)
    # A push until the signal is no load: torques after it decide.
    fresh = ca.if_else(since < _AFTER, 1.0, 0.0)
    return Grip(
        open_=open_,
        closes=closes,
        likely=likely,
        present=ca.if_else(held, 0.0, to_come * mass) * open_,
        variance=open_
        * ca.if_else(held, ca.fmax(variance + to_come * (1 + mass**2), fresh), to_come * mass**2),
        remembered=-onsets.symbols.once[:, :-1] @ moves[:, :-1].T * open_,
        offset=ca.if_else(timed, offset, known_offset),
    )


def _times(
    onsets: Onsets, since: ca.SX, left: ca.SX, held: ca.SX, x: ca.SX, P: ca.SX
) -> tuple[ca.SX, ...]:
    """For each candidate time, the signal's last: probability, offset of the signal, mass
    and its variance, the change in torques before estimates contained it, and the mean of their
    product. The last onset stands for no change yet and takes the remaining probability."""
    D, C, F = onsets.symbols.evidence, onsets.symbols.information, onsets.symbols.moved[0, :]
    off, zero = ca.horzcat(onsets.ages - since, 0.0), ca.SX.zeros(1)
    D, C, F = (ca.horzcat(part, zero) for part in (D, C, F))
    signal = off.numel() - 1
    prior = ca.horzcat(
        ca.exp(-ca.fabs(off[:signal]) / _TYPICAL),
        _TYPICAL / onsets.step * ca.exp(-since / _TYPICAL) * (since < SOON),
        _IN_TIME,
    )
    A = C + (1 + F) ** 2 / P
    B = ca.fmax(D + (1 + F) * x / P, 0)
    # A push does not depend on the load, and ended before the signal.
    push = D / (C + 1)
    late = ca.horzcat(ca.if_else(off[:signal] > 0, 1.0, 0.0), 0.0, 0.0)
    other = x - F * push
    beyond = D * push - _PUSHED + (x * x - ca.fmin(other, 0) ** 2) / P - B * B / A
    pushed = ca.logic_and(late, beyond > 0)
    taken = (
        ca.if_else(pushed, B * B / A + beyond, B * B / A),
        1 / ca.sqrt(ca.if_else(pushed, C + 1, A * P)),
        ca.if_else(pushed, ca.fmax(other, 0), B / A),
        ca.if_else(pushed, P, 1 / A),
        ca.if_else(pushed, push, B / A),
        ca.if_else(pushed, push * ca.fmax(other, 0), (B / A) ** 2 + 1 / A),
    )
    mass = left[0] / ca.fmax(1 - F, _MOVED)
    gone = -(2 * D + C * mass) * mass, 1.0, mass, (_ROUGH * mass) ** 2, -mass, -(mass**2)
    gain, share, *rest = (ca.if_else(held, *pair) for pair in zip(taken, gone, strict=True))
    weight = prior * share * ca.exp(0.5 * (gain - ca.mmax(gain)))
    weight /= ca.sum2(weight)
    off = ca.horzcat(off[:signal], 0.0, 0.0) * ca.if_else(ca.logic_and(held, pushed), 0.0, 1.0)
    parts = weight, off, *rest
    return tuple(ca.horzcat(part[:signal], part[signal + 1]) for part in parts)


def _with_load(
    estimate: Estimate, moved: ca.SX, share: ca.SX, mass: ca.SX, variance: ca.SX, P: ca.SX
) -> Estimate:
    """The estimate with a known mass, and without the error made before the load was known.

    Args:
        moved: error of the estimates.
        share: its regression on the mass, E(moved m) / E(m²); the mean mass alone does not give it
            while it is near zero.
    """
    along = estimate.P[:, 0] / P
    x = estimate.x - moved + along * (mass + moved[0] - estimate.x[0])
    g = along * (1 + share[0]) - share
    return Estimate(x, ca.tril2symm(ca.tril(estimate.P - along @ along.T * P + g @ g.T * variance)))


def _without_load(estimate: Estimate, moved: ca.SX, n_load: int) -> Estimate:
    """The estimate without the load's effect on the other states, of which a share is uncertain."""
    others = ca.vertcat(ca.SX.zeros(n_load), moved[n_load:])
    spread = others @ others.T * _ROUGH**2
    return Estimate(estimate.x - others, ca.tril2symm(ca.tril(estimate.P + spread)))


def chosen_estimate(condition: ca.SX, a: Estimate, b: Estimate) -> Estimate:
    return Estimate(ca.if_else(condition, a.x, b.x), ca.if_else(condition, a.P, b.P))
