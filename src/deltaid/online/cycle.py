"""The whole cycle of one robot as one graph, with contact detection and the covariance of the
residual.

The noise of speeds is estimated from the speeds: a motion is smooth, so noise makes nearly all of
the n-th difference Dₙ of a drive's speeds. With white noise of the measured numbers, and speeds as
sums of these with weights c,

    σ² = Σ c² / Σ (c ∗ d)² · E Dₙ²,   d the weights of the n-th difference.

A motion increases σ slightly; a push does not, because bodies still move smoothly. The mean is over
cycles in which the drive moves: at rest an encoder's steps do not change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import casadi as ca
import numpy as np

from deltaid.identification.events import LONGEST_EVENT
from deltaid.model.model import Model
from deltaid.online.contact import ContactResidual, contact, threshold
from deltaid.online.estimates import CycleEstimates, estimates, friction_bounds, give_friction
from deltaid.online.graph import CycleFields, Field, StepGraph, every
from deltaid.online.grips import chosen_estimate
from deltaid.online.instant import waits
from deltaid.online.kalman import LARGEST_STEP, LEARNT
from deltaid.online.settings import OnlineKnowledge, OnlineSettings, knowledge
from deltaid.online.signals import SETTLED, Signals, signals


@dataclass(frozen=True, eq=False)
class Cycle:
    """Input of additional parts: model and settings of the cycle, its signals and estimates, and
    its fields."""

    model: Model
    settings: OnlineSettings
    known: OnlineKnowledge
    signals: Signals
    estimates: CycleEstimates
    fields: CycleFields


# Adds a part to the cycle, such as contact detection.
MorePart = Callable[[Cycle], None]


def step_graph(
    model: Model,
    settings: OnlineSettings | None = None,
    more: Sequence[MorePart] = (),
    known: OnlineKnowledge | None = None,
) -> StepGraph:
    """Graph of one cycle, from state and inputs to next state and outputs.

    Args:
        more: additional parts, last in the state and in the outputs.
        known: uncertainty to use instead of the model's.

    Raises:
        DeltaidError: settings and robot do not fit each other.
    """
    settings = settings or OnlineSettings()
    known = known or knowledge(model, settings)
    anew, touched, fields = ca.SX.sym("anew"), ca.SX.sym("touched"), CycleFields()
    read = signals(fields, model, known, settings, anew)
    bounds = friction_bounds(model, known, settings.friction_range)
    estimated = estimates(fields, read, known, settings, touched, bounds)
    give_friction(fields, model, known, estimated.behind.x[read.at_friction], bounds)
    for add in more:
        add(Cycle(model, settings, known, read, estimated, fields))
    graph = fields.graph(read.inputs, read.u, read.good)
    rests = ca.if_else(fields.following.get("contact_rests", ca.SX(0)) > 0, 1.0, 0.0)
    x, y = ca.substitute([graph.following, graph.y], [anew], [estimated.change.changed])
    x, y = ca.substitute([x, y], [touched], [rests])
    return replace(graph, following=x, y=y)


# Time constant of the decay of a released load that may still be present [s].
_HANGS_ON = 0.02
# Deviation of the moments of an unsignalled load, as a share of the largest.
_ASIDE = 0.2
# Ratio of squared residuals to their variance that is tolerated before the variance is enlarged;
# memory of decreasing residuals, and of the noise of speeds while drives move [s].
_TOLERATED, _MEMORY = 2.0, 10.0


def standard_parts(model: Model) -> tuple[MorePart, ...]:
    """Parts of every cycle in addition to loads and friction: contacts, if the model is identified.

    Without the intervals of an identification, contacts and model errors look alike.
    """
    return () if model.identified is None else (contact_of,)


def contact_of(cycle: Cycle) -> None:
    """The part of a cycle that detects contacts.

    During a push, and while filters remember it, nothing is learnt; a residual that lasts longer
    than any push is a model error, which estimates absorb.
    """
    s, settings, robot, fields = cycle.signals, cycle.settings, cycle.model.robot, cycle.fields
    since, rests, excess, _ = fields.keep(
        Field("contact_time", 1, "since a contact began, 0 without", "s"),
        Field("contact_rests", 1, "for which nothing is learnt yet", "s"),
        Field("excess", 1, "how much larger residuals are", initial=1.0),
        Field("hangs_on", 1, "of the load let go last, what may still be there"),
    )
    larger = ca.fmax(excess / _TOLERATED, 1.0)
    residual = _residual(cycle, larger)
    dof, touched = residual.levers.shape[1], ca.if_else(since > 0, 1.0, 0.0)
    u = threshold(settings.false_alarms, settings.corner, dof)
    seen = contact(residual, touched, u, every(s.settled, ca.logic_or(s.calm, since > 0)))
    lasts = ca.if_else(seen.detected > 0.5, ca.fmin(since + settings.period, LONGEST_EVENT), 0.0)
    pushed = ca.logic_and(seen.detected > 0.5, lasts < LONGEST_EVENT)
    pauses = ca.if_else(
        pushed, 2 * SETTLED / settings.corner, ca.fmax(rests - settings.period, 0.0)
    )
    # Filters restart with the gripper's signal, and a contact before may have been the load.
    pauses = ca.if_else(cycle.estimates.change.signalled, 0.0, pauses)
    found = ca.fmin((seen.size * u) ** 2 * larger / dof, LARGEST_STEP)
    memory = ca.if_else(found > excess, LEARNT, _MEMORY)
    learns = every(s.settled, s.calm, seen.detected < 0.5)
    learnt = excess + settings.period / memory * learns * (found - excess)
    of_drives = "N" if all(robot.linear_drives) else "N m"
    fields.following |= {"contact_time": lasts, "contact_rests": pauses, "excess": learnt}
    fields.give(
        ("contact", seen.detected, "1 while there is a contact"),
        ("contact_size", seen.size, "size of the residual, 1 at the threshold"),
        ("contact_limb", seen.limb,
         "drive whose limb is touched, 0 the platform, -1 no contact"),
        ("contact_force", seen.force, "force on the platform point", "N"),
        ("contact_effort", seen.effort, "torque from outside on each drive", of_drives),
        ("contact_information", ca.vec(seen.information),
         "A: along a unit vector n a force of (u + 1.645) / sqrt(n' A n) is found"),
    )  # fmt: skip


def _residual(cycle: Cycle, larger: ca.SX) -> ContactResidual:
    """The residual and its covariance, scaled by `larger`: the sum for estimates, unmodelled
    torques, filtered torque noise, and noise of speeds in the momentum, K M v.

    A load that is still unknown is in M too: its column is computed from noisy speeds, and the
    effect of that noise is not in the column's span.

    Unmodelled torques are estimated only over their short memory, so they stay in the residual, and
    their whole size is in its covariance.
    """
    s, e, settings = cycle.signals, cycle.estimates, cycle.settings
    model, n = cycle.model, s.columns.shape[1]
    believed = chosen_estimate(e.grip.open_, e.grip.likely, e.before).part(slice(0, n))
    x, P = ca.SX(believed.x), ca.SX(believed.P)
    x[0] += e.grip.present
    P[0, 0] += ca.fmax(e.grip.variance - P[0, 0], 0)
    partly = _partly(cycle, ca.fmax(x[0], 0))
    behind = e.lacking**2 + cycle.known.noise**2 * (0.5 * settings.corner * settings.period)
    lifted, silent = s.columns[:, s.at_load], 1 - ca.if_else(s.gripper > -0.5, 1.0, 0.0)
    aside = ca.horzcat(lifted[:, 1:] * (_ASIDE * silent), lifted[:, 0] * partly)
    S = s.columns @ P @ s.columns.T + ca.diag(behind) + aside @ aside.T
    known = settings.speed_noise
    noise = learn_speed_noise(cycle) if known is None else ca.SX(np.array(known) ** 2)
    spread = ca.fmax(ca.diag(P)[s.at_load], 0)
    spread[0] += partly**2
    S += settings.corner**2 * of_speeds(cycle, x[s.at_load], spread, noise + s.bridged**2)
    mechanism = model.dynamics.kinematics.mechanism
    T = mechanism.speeds.inverse_jacobian[model.robot.task.moves, :]
    return ContactResidual(
        value=s.residual - s.columns @ x - e.grip.remembered,
        covariance=S * larger,
        bound=s.dry,
        levers=ca.Function("levers", [mechanism.z], [T])(s.z),
        lifted=lifted[:, 0],
        light=-x[0] * silent,
        heavy=(1 - x[0]) * silent,
    )


def _partly(cycle: Cycle, mass: ca.SX) -> ca.SX:
    """Mass that may be present although the gripper signals none, or that is not yet known.

    Args:
        mass: of the load held, in units of the largest one.
    """
    e, hung = cycle.estimates, cycle.fields.before["hangs_on"]
    expected = ca.if_else(cycle.signals.gripper > 0.5, 1.0, mass)
    let_go = ca.logic_and(e.change.changed, ca.logic_not(e.change.held))
    hangs = ca.if_else(let_go, mass, hung * np.exp(-cycle.settings.period / _HANGS_ON))
    cycle.fields.following["hangs_on"] = hangs
    return ca.if_else(e.differs, expected, hung)


def of_speeds(cycle: Cycle, x: ca.SX, spread: ca.SX, noise: ca.SX) -> ca.SX:
    """Covariance of the momentum M v by noise of speeds, with the held load.

    Args:
        x, spread: entries of the load in units of its largest ones, and their variances.
        noise: variances of speeds.
    """
    momentum, known, model = cycle.signals.momentum, cycle.known, cycle.model
    p, entries = ca.SX(model.p), ca.SX.sym("entries", x.numel())
    p[known.entries.places(model.layout)] += ca.SX(known.load_scales) * entries
    M = ca.substitute(momentum.M, momentum.p, p)
    by_entry = ca.horzsplit(ca.jacobian(ca.vec(M), entries))
    parts = [M, *(ca.reshape(column, *M.shape) for column in by_entry)]
    at_pose = ca.Function("M", [momentum.z, entries], parts)(cycle.signals.z, x)
    shares = zip(at_pose, (1.0, *ca.vertsplit(spread)), strict=True)
    return sum((share * part @ ca.diag(noise) @ part.T for part, share in shares), ca.SX(*M.shape))


# Order of the difference of speeds.
_ORDER = 5


def learn_speed_noise(cycle: Cycle) -> ca.SX:
    """Variance of each drive's speed before this cycle.

    It begins with `rest_speed`, below which the sign of a speed is unknown, as one cycle's value.
    """
    fields, s, settings = cycle.fields, cycle.signals, cycle.settings
    dof, wait = s.qd.numel(), waits(cycle.model, settings)
    variance, cycles, *past = fields.keep(
        Field("speed_variance", dof, "of speeds", initial=settings.rest_speed**2),
        Field("speed_cycles", dof, "in which they were measured", initial=1.0),
        *(Field(f"speed_{k}", dof, f"difference {k} of speeds") for k in range(_ORDER)),
    )
    differences = [s.qd]
    for before in past:
        differences.append(differences[-1] - before)
    # Σ c² / Σ (c ∗ d)²: ratio of the variance of speeds to the variance of their n-th difference
    c = np.array([1 - wait.motion % 1.0, wait.motion % 1.0])
    c = np.convolve(c, [1.0, -1.0]) if settings.speed == "differenced" else c
    d = reduce(np.convolve, [[1.0, -1.0]] * _ORDER, c)
    shown = float(np.sum(c**2) / np.sum(d**2)) * differences[-1] ** 2
    moves = every(s.slow < 0.5, s.settled, s.calm)
    # Rows that were skipped leave larger differences for some cycles.
    step = ca.fmin(shown, LARGEST_STEP * variance) - variance
    count = ca.fmin(cycles + moves, _MEMORY / settings.period)
    fields.following |= {"speed_variance": variance + moves * step / count, "speed_cycles": count}
    fields.following |= {f"speed_{k}": x for k, x in enumerate(differences[:-1])}
    return variance
