"""Filtered signals of a cycle: the residual torque and the columns that may explain it."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Int

from deltaid.dynamics.joint_columns import JointMotion, columns_of_drives
from deltaid.model.model import Model
from deltaid.online.even_rows import even_rows
from deltaid.online.graph import CycleFields, Field, Layout, all_finite, chosen, only_if
from deltaid.online.instant import inputs_of, instant, line, pose, waits
from deltaid.online.momentum import Lowpass, Momentum, build_momentum
from deltaid.online.settings import OnlineKnowledge, OnlineSettings

# Time after which filters have forgotten their initial state, in time constants.
SETTLED = 3.0
# Unmodelled load friction, as a share of the gears' load.
_CARRIED = 0.03


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals of one cycle, before the estimates.

    Attributes:
        inputs, u: layout and symbols of the inputs.
        good: 1 where they can be used and the loops close.
        live: 1 where this cycle and the previous ones are good, so that filters have a history.
        settled: 1 where filters have forgotten their initial state.
        calm: 1 where this cycle uses no skipped row.
        bridged: noise of speeds by skipped rows.
        z, qd: pose and speeds.
        gripper: its signal at that time.
        torque: filtered measured torque.
        residual: ρ, filtered torque beyond the model without a load.
        columns: filtered torques of a load's entries, of uncertain directions and of the followed
            friction, for one unit of each (`OnlineKnowledge`); δ × n.
        smooth_residual, smooth_columns: both through the same filter again. ρ and columns share the
            noise of speeds, which would make loads look lighter; the second filter attenuates it.
        at_load, at_friction: slices of the columns.
        kinds: of the columns, as of `States`.
        dry: filtered size of torques that speeds do not determine, of friction near rest and of
            saturated torques; δ.
        at_rest: its size while a drive rests, as long as `smooth_residual` remembers it.
        slow: filtered 1 / (1 + (q̇/v)²), drive by drive: near 1 where a drive is slow.
        momentum: the underlying equations.
    """

    inputs: Layout
    u: dict[str, ca.SX]
    good: ca.SX
    live: ca.SX
    settled: ca.SX
    calm: ca.SX
    bridged: ca.SX
    z: ca.SX
    qd: ca.SX
    gripper: ca.SX
    torque: ca.SX
    residual: ca.SX
    columns: ca.SX
    smooth_residual: ca.SX
    smooth_columns: ca.SX
    at_load: slice
    at_friction: slice
    kinds: Int[np.ndarray, " n"]
    dry: ca.SX
    at_rest: ca.SX
    slow: ca.SX
    momentum: Momentum


def signals(
    fields: CycleFields,
    model: Model,
    known: OnlineKnowledge,
    settings: OnlineSettings,
    anew: ca.SX,
) -> Signals:
    """The first part of a cycle: its filtered signals.

    Args:
        anew: 1 where filters begin anew after this cycle; a symbol to be replaced.
    """
    dof, mechanism = model.dynamics.dof, model.dynamics.kinematics.mechanism
    inputs, wait, home = inputs_of(model, settings), waits(model, settings), model.home
    u = inputs.symbols("in")
    # Good cycles in a row until inputs are of one instant, and until filters forget their start.
    needed = wait.cycles + (1 if settings.speed == "measured" else 2)
    most = needed + round(SETTLED * settings.rate / settings.corner)
    finite = all_finite(inputs.vector(u))
    (near,) = fields.keep(Field("z", dof, "pose [x, y, z, psi]", initial=tuple(home.tolist())))
    even = even_rows(fields, u, finite, model, known, settings, wait.cycles)
    row, skipped, lost, calm, bridged = even
    (count,) = fields.keep(Field("live", 1, f"good cycles in a row, up to {most}"))
    count = ca.if_else(lost, 0, count)
    fields.following["live"], fields.spoilt["live"] = ca.fmin(count + 1, most), ca.SX(0)
    waited = line(fields, inputs, row, wait.of_inputs(inputs), count > 0, finite)
    q, qd, tau = instant(fields, waited, count > 0, ca.SX(model.gains), settings)
    z, closed = pose(mechanism, near, q)
    # Until loops close, Newton's method continues from its last pose, or from home.
    begun = chosen(all_finite(z), z, ca.SX(home))
    fields.following["z"], fields.spoilt["z"] = z, chosen(finite, begun, near)
    momentum, *parts = _torques(model, known, settings, z, qd, tau)
    computed = ca.logic_and(*(all_finite(ca.vertcat(p.nz[:], tau)) for p in parts[:2]))
    good = ca.logic_and(finite, ca.logic_and(closed, computed))
    of_momentum, rest, dry, at_stand = (only_if(good, part) for part in parts)
    qd, tau = only_if(good, qd), only_if(good, tau)
    live = ca.logic_and(count >= needed, good)
    begins = ca.logic_or(anew, ca.logic_not(live))
    filters = _Filters(fields, begins, Lowpass.lines(settings.corner, settings.period))
    filtered, steady, lines = filters.filtered, filters.steady, filters.lines
    holds = settings.torque == "held" and settings.speed == "measured"
    of_torque = Lowpass.held(settings.corner, settings.period) if holds else lines
    torque = filtered("torque", tau, of_torque.before * tau, of_torque)
    of_momentum *= settings.corner
    x = of_momentum - rest
    columns = of_momentum - filtered("columns", x, lines.keep(of_momentum, x))
    both = only_if(live, ca.horzcat(torque - columns[:, 0], columns[:, 1:]))
    smooth, beyond = filtered("smooth", both, ca.SX(*both.shape)), _beyond(model, tau, settings)
    # (1 − sign²)² of friction: a slowly moving drive has a direction.
    rest, dry = dry * dry / (at_stand + 1e-12) + beyond, dry + beyond
    dry, rest = steady("dry", dry), steady("rest", rest)
    at_rest = steady("smooth_rest", rest)
    slow = steady("slow", 1 / (1 + (qd / ca.SX(known.slow_speed)) ** 2))
    fields.give(("skipped", skipped, "1 for a row that is not new or cannot be, and is not used"))
    counts = [len(known.entries.shown), known.directions.shape[1], len(known.followed)]
    counts.append(both.shape[1] - 1 - sum(counts))  # friction that models lack
    ends = np.cumsum([0, *counts]).tolist()
    return Signals(
        inputs=inputs,
        u=u,
        good=good,
        live=live,
        settled=ca.logic_and(count >= most, good),
        calm=calm,
        bridged=bridged,
        z=chosen(good, z, ca.SX(home)),
        qd=qd,
        gripper=waited["gripper"],
        torque=only_if(live, torque),
        residual=both[:, 0],
        columns=both[:, 1:],
        smooth_residual=smooth[:, 0],
        smooth_columns=smooth[:, 1:],
        at_load=slice(*ends[:2]),
        at_friction=slice(*ends[2:4]),
        kinds=np.repeat([0, 1, 2, 1], counts),
        dry=dry,
        at_rest=at_rest,
        slow=slow,
        momentum=momentum,
    )


def _torques(
    model: Model,
    known: OnlineKnowledge,
    settings: OnlineSettings,
    z: ca.SX,
    qd: ca.SX,
    tau: ca.SX,
) -> tuple[Momentum, ca.SX, ca.SX, ca.SX, ca.SX]:
    """Torques of one instant, linear in the directions of `_columns` and in friction that models
    lack.

    Returns:
        The equations; columns of the momentum, columns of the rest, and size of undetermined
        friction; and that size where the drives stand.
    """
    momentum, D = _columns(model, known, settings)
    load = _carried(model, qd, tau)
    along = ca.Function(
        "columns",
        [momentum.z, momentum.qd, momentum.load],
        [momentum.H @ D, momentum.W @ D, ca.substitute(momentum.dry, momentum.p, ca.SX(model.p))],
    )
    of_momentum, rest, dry = along(z, qd, load)
    dry_at_stand = along(z, ca.SX.zeros(qd.numel()), load)[2]
    # Friction that many gears have and few models: more at low speed, and with the gears' load.
    # Each is the same share in all drives.
    slow = (qd / ca.SX(known.slow_speed)) ** 2
    sign = qd / ca.sqrt(qd * qd + settings.rest_speed**2)
    falling = known.unmodelled_slow * sign * ca.exp(-slow)
    lacked = ca.horzcat(falling, _CARRIED * sign * ca.fabs(load))
    of_momentum = ca.horzcat(of_momentum, ca.SX(*lacked.shape))
    return momentum, of_momentum, ca.horzcat(rest, lacked), dry, dry_at_stand


@dataclass(frozen=True, eq=False)
class _Filters:
    """Filters of a cycle, which begin anew together."""

    fields: CycleFields
    begins: ca.SX
    lines: Lowpass

    def filtered(
        self, name: str, x: ca.SX, resting: ca.SX, lowpass: Lowpass | None = None
    ) -> ca.SX:
        """x through a filter; `resting` is its state where it begins anew."""
        lowpass, shape = lowpass or self.lines, x.sparsity()
        (before,) = self.fields.keep(Field(name, shape.nnz(), f"filter of {name}"))
        y = lowpass.output(ca.SX(shape, before), x)
        kept, resting = (ca.project(k, shape).nz[:] for k in (lowpass.keep(y, x), resting))
        self.fields.following[name] = chosen(self.begins, resting, kept)
        return y

    def steady(self, name: str, x: ca.SX) -> ca.SX:
        """x through a filter that begins anew as if x had not changed."""
        return self.filtered(name, x, self.lines.keep(x, x))


def _columns(
    model: Model, known: OnlineKnowledge, settings: OnlineSettings
) -> tuple[Momentum, ca.DM]:
    """The equations, and directions of p: the model, a load, its errors, friction."""
    rest = dict.fromkeys(model.robot.friction_joints, settings.rest_speed)
    unit = np.eye(model.p.size)
    momentum = build_momentum(model.robot, model.dynamics.kinematics.mechanism, rest)
    load = unit[:, known.entries.places(model.layout)] * known.load_scales
    friction = unit[:, list(known.followed)] * known.friction_std
    D = np.column_stack([model.p, load, known.directions, friction])
    return momentum, ca.sparsify(ca.DM(D))


def _carried(model: Model, qd: ca.SX, tau: ca.SX) -> ca.SX:
    """Load x of the gears from torques, τ = x + f + μ sign(q̇) |x|, without the rotors' share."""
    robot, none, x, share = model.robot, ca.SX(0), ca.SX(tau), ca.SX.zeros(tau.numel())
    for k, i, column in columns_of_drives(robot):
        if column.parameter.symbol == "load":
            share[i] += model.p[k] * ca.sign(qd[i])
        elif column.parameter.kind == "friction":
            motion = JointMotion(none, qd[i], none, ca.SX(1))
            x[i] -= model.p[k] * column.effort(motion)
    return x / (1 + share * ca.sign(x))


def _beyond(model: Model, tau: ca.SX, settings: OnlineSettings) -> ca.SX:
    """Size of torques at their limits or at the end of their channel, which may not be the real
    ones."""
    limits = [model.robot.limits_of(drive).effort or np.inf for drive in model.robot.drives]
    ends = np.abs(model.gains) * np.array(settings.torque_ends or [np.inf] * len(limits))
    size = ca.SX.zeros(tau.numel())
    for i, end in enumerate(np.minimum(ends, limits).tolist()):
        if np.isfinite(end):
            size[i] = end * (ca.fabs(tau[i]) >= 0.999 * end)
    return size
