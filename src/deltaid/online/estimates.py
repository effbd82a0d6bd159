"""Estimate the held load, the model's errors and friction together, cycle by cycle.

    ρ = Ψ p_load + Φ c + d + noise

Ψ and Φ are filtered columns (`signals`). c are errors of the model: constants with the covariance
of the identification, and the drives' friction, which may change slowly. d are unmodelled torques
that last some hundredths of a second, one number per drive; their size is learnt from
E(d² + P_dd) = 1 in units of it. Because all are estimated together, information about c from times
without a load, or with an earlier one, is kept, and uncertainty of c that remains is part of the
load's interval, however long it is held.

A new load resets only the load's states.

Friction adapts slowly and stays physical. Its coefficients follow residuals; their covariance, but
not their mean, returns to the prior, so nothing changes without motion. They stay within a share of
the identified values and never fall below zero. Friction h(v) with such coefficients dissipates
energy at any speed, and a consistent load keeps M positive definite and Ṁ − 2C skew. So the model
is passive at any instant. While coefficients change, energy may flow slowly; passivity of a whole
loop is not claimed.
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from deltaid.estimation.scatter import NORMAL
from deltaid.model.model import Model
from deltaid.online.changes import Change, Onsets, estimate_after, judge_change
from deltaid.online.graph import CycleFields, Field, chosen
from deltaid.online.grips import Grip, chosen_estimate, follow_grip, grip_before
from deltaid.online.instant import UNKNOWN
from deltaid.online.kalman import DRIVES, Estimate, States, learn_levels
from deltaid.online.momentum import Lowpass
from deltaid.online.settings import OnlineKnowledge, OnlineSettings
from deltaid.online.signals import Signals

Bounds = tuple[tuple[float, ...], tuple[float, ...]]

# Rest that counts as one measurement [s]: while a drive rests, its static friction is one unknown
# torque. Otherwise standstills would determine load and friction.
_AT_REST = 1.0


@dataclass(frozen=True, eq=False)
class CycleEstimates:
    """Estimates of one cycle.

    Attributes:
        before: mean and covariance of the states before this cycle's measurements.
        behind: mean and covariance after them.
        change: whether another load is held from now on.
        differs: 1 where the gripper's signal differs from the previous state.
        grip: estimate of when a load was taken or released.
        lacking: size of unmodelled torques, δ.
    """

    before: Estimate
    behind: Estimate
    change: Change
    differs: ca.SX
    grip: Grip
    lacking: ca.SX


def estimates(
    fields: CycleFields,
    s: Signals,
    known: OnlineKnowledge,
    settings: OnlineSettings,
    touched: ca.SX,
    bounds: Bounds,
) -> CycleEstimates:
    """The second part of a cycle: its estimates.

    Args:
        touched: 1 while the robot is pushed, so that residuals are not used.
        bounds: of the followed friction, in deviations.
    """
    period, n_load, dof = settings.period, len(known.entries.shown), s.qd.numel()
    silent, lowpass = s.gripper <= -0.5, Lowpass.lines(settings.corner, period)
    kinds = States(np.append(s.kinds, [3] * dof), period, settings.friction_time)
    kept, doc = kinds.before(fields), "how much more than thought the model lacks of {} drives"
    moving, slow = fields.keep(
        *(Field(f"{kind}_level", dof, doc.format(kind), initial=1.0) for kind in DRIVES)
    )
    parts = ca.SX(known.unmodelled * moving), ca.SX(known.unmodelled_slow * slow * s.slow)
    size = parts[0] + parts[1]
    rows = ca.horzcat(s.smooth_columns, ca.diag(size))
    held, *_ = fields.keep(
        Field("held", 1, "1 while a load is held"),
        Field("waited", 1, "time since the gripper's signal", "s"),
        Field("alert", 1, "time for which a change was likely", "s"),
        Field("gripping", 1, "1 while it is open when it was taken or left"),
        Field("since_grip", 1, "the gripper's signal", "s"),
        Field("left", n_load, "load left last, in units of the largest"),
        Field("offset", 1, "of the gripper's signal", "s", UNKNOWN),
    )
    onsets = Onsets.before(fields, 1 - kinds.wander * (1 - kinds.stays), dof, lowpass, period)
    differs = ca.logic_and(s.gripper > -0.5, (s.gripper > 0.5) != held)
    grip = grip_before(fields, onsets, kept, s.gripper, differs)
    onsets = replace(onsets, open_=grip.open_)
    before = kinds.later(chosen_estimate(grip.closes, grip.likely, kept), held)
    innovations = s.smooth_residual - rows @ before.x
    variances = ca.SX(known.noise**2) + (_AT_REST / period) * s.at_rest**2
    weight = s.live * s.calm * (1 - touched) * (1 - differs)
    # Entries of a change in units of its mass: as of the held or just released load, otherwise a
    # mass alone.
    least = known.least_mass / known.load_scales[0]
    load = ca.if_else(grip.open_, fields.before["left"] * (1 - held), before.x[:n_load] * held)
    unit = ca.vertcat(ca.SX(1), ca.SX.zeros(n_load - 1))
    shape = chosen(load[0] > least, load / ca.fmax(load[0], least), unit)
    once, twice = s.columns[:, :n_load] @ shape, rows[:, :n_load] @ shape
    behind = before
    for i in range(dof):
        behind, update = behind.measured(rows[i, :], s.smooth_residual[i], variances[i], weight)
        onsets = onsets.measured(i, twice, update)
    seen = onsets.likeliest
    spread = ca.sqrt(ca.fmax(behind.P[0, 0], 0))
    change = judge_change(fields, seen, s.gripper, differs, behind.x[0], spread, least, settings)
    judged = ca.logic_and(silent, ca.fabs(seen.score) > settings.alarm)
    calm = weight * (1 - judged) * (1 - grip.open_)
    learn_levels(fields, parts, behind.part(slice(-dof, None)), calm, period)
    follow_grip(fields, grip, behind.x[:n_load], change, period)
    onsets.follow(fields, change, grip.closes, once, twice)
    behind = estimate_after(_bounded(behind, s.at_friction, bounds, calm), seen, change, n_load)
    fields.following |= {"x": behind.x, "P": ca.tril(ca.densify(behind.P)).nz[:]}
    likely = ca.logic_and(grip.open_, ca.logic_not(change.changed))
    P = ca.SX(grip.likely.P)
    P[0, 0] = ca.fmax(P[0, 0], grip.variance)  # the load may still come
    given = Estimate(grip.likely.x, P)
    loaded = chosen_estimate(likely, given, behind).part(slice(0, n_load))
    load = known.entries.consistent(loaded.x, loaded.P, known.load_scales, settings.extent)
    load = chosen(change.held, load, ca.SX.zeros(n_load))
    std = ca.sqrt(ca.fmax(ca.diag(loaded.P), 0)) * ca.SX(known.load_scales)
    open_, information = ca.logic_and(silent, ca.logic_not(change.held)), ca.SX(0)
    for onset, recent in onsets.unsignalled:
        information = ca.fmax(information, onset.information * recent)
    most = ca.fmin(1.0, settings.alarm / ca.sqrt(information + 1e-12)) * known.load_scales[0]
    unnoticed = ca.if_else(open_, most, 0.0)
    names = ", ".join(known.entries.names)
    fields.give(
        ("held", change.held, "1 while a load is held"),
        ("changed", change.changed, "1 in the cycle in which that changed"),
        ("load", load, f"entries of the load: {names}"),
        ("load_std", std, "their standard deviations"),
        ("grip_offset", grip.offset,
         "by which the gripper's last signal came after what torques show, -1 unknown", "s"),
        ("change_score", seen.score, "deviations by which the mass looks changed"),
        ("unnoticed", unnoticed, "mass that may have been taken without being noticed", "kg"),
        ("residual", s.residual, "torque that the empty model lacks"),
        ("unexplained", innovations, "what load and model leave of it"),
    )  # fmt: skip
    return CycleEstimates(before, behind, change, differs, grip, size)


def _bounded(estimate: Estimate, at: slice, bounds: Bounds, calm: ca.SX) -> Estimate:
    """The estimate with friction within its bounds.

    Correlated states move with a coefficient, x + P_k (bound − x_k) / P_kk: the likeliest estimate
    at the bound. If the coefficient moved alone, the others would no longer fit the measurements.

    Args:
        calm: 1 unless the load may have changed; its effect is removed from unbounded estimates.
    """
    x, P = ca.SX(estimate.x), estimate.P
    for k, low, high in zip(range(at.start, at.stop), *bounds, strict=True):
        beyond = calm * (ca.fmin(ca.fmax(x[k], low), high) - x[k])
        x = x + P[:, k] * (beyond / ca.fmax(P[k, k], 1e-12))
    return Estimate(x, P)


def friction_bounds(model: Model, known: OnlineKnowledge, share: float) -> Bounds:
    """Lowest and highest deviation of each followed coefficient, in units of `friction_std`."""
    low, high = [], []
    for k, std in zip(known.followed, known.friction_std, strict=True):
        parameter, value = model.layout.parameters[k], float(model.p[k])
        # An offset may be zero, and has the interval of its deviation instead of a share.
        reach = NORMAL * std if parameter.signed else share * abs(value)
        low.append((max(parameter.low, value - reach) - value) / std)
        high.append((min(parameter.high, value + reach) - value) / std)
    return tuple(low), tuple(high)


def give_friction(
    fields: CycleFields, model: Model, known: OnlineKnowledge, x: ca.SX, bounds: Bounds
) -> None:
    """Add the followed coefficients as an output.

    Args:
        x: their deviations after a cycle.
    """
    x = ca.fmin(ca.fmax(x, ca.SX(bounds[0])), ca.SX(bounds[1]))
    names = ", ".join(model.layout.names[k] for k in known.followed)
    value = ca.SX(model.p[list(known.followed)]) + ca.SX(np.array(known.friction_std)) * x
    fields.give(("friction", value, f"coefficients: {names}"))
