"""What a cycle reads of a robot: residual torque and the columns that may explain it, filtered."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.dynamics.joint_columns import JointMotion, joint_columns
from deltaid.model.model import Model
from deltaid.online.graph import Kept, Part, all_finite, chosen, only_if
from deltaid.online.instant import Line, line, pose, waits
from deltaid.online.knowledge import Knowledge
from deltaid.online.layout import Field, Layout
from deltaid.online.momentum import Lowpass, Momentum, build_momentum, filtered_torque
from deltaid.online.settings import OnlineSettings

# How long filters remember what they began with, in their time constants.
_SETTLED = 3.0
# Friction by what gears carry that a model may lack, as a share of that.
_CARRIED = 0.03


@dataclass(frozen=True, eq=False)
class Signals:
    """One cycle, before anything is estimated.

    Attributes:
        inputs, u: what is read, and its symbols.
        good: 1 where it can be used and the loops close.
        live: 1 where this cycle is good and those before were, so that filters have a past, and
        settled: for so long that they have forgotten what they began with.
        z, qd, tau: pose, speeds, and torques on the joints' side.
        gripper: what it told at that time.
        torque: filtered torque, as measured.
        residual: ρ, filtered torque that the model without any load does not explain.
        columns: filtered torques of a load's entries, of the model's own directions and of the
            followed friction, for one unit of each (`Knowledge`); δ × n.
        smooth_residual, smooth_columns: both through the same filter once more. Noise of speeds, of
            which ρ and columns have the same and which would make loads look lighter, falls there
            with the frequency.
        at_load, at_directions, at_friction, at_lacked: where they stand among the columns.
        dry: filtered size of the torque that no speed tells, friction near rest and torques at
            their limits; δ.
        slow: filtered 1 / (1 + (q̇/v)²), drive by drive: near 1 where a drive is slow.
        momentum: the equations behind it.
    """

    inputs: Layout
    u: dict[str, ca.SX]
    good: ca.SX
    live: ca.SX
    settled: ca.SX
    z: ca.SX
    qd: ca.SX
    tau: ca.SX
    gripper: ca.SX
    torque: ca.SX
    residual: ca.SX
    columns: ca.SX
    smooth_residual: ca.SX
    smooth_columns: ca.SX
    at_load: slice
    at_directions: slice
    at_friction: slice
    at_lacked: slice
    dry: ca.SX
    slow: ca.SX
    momentum: Momentum


def inputs_of(model: Model, settings: OnlineSettings) -> Layout:
    """What a cycle reads."""
    dof, units = model.dynamics.dof, model.robot
    angle = "m" if all(units.is_linear(drive) for drive in units.drives) else "rad"
    return Layout.of(
        Field("q", dof, "drive coordinates", angle),
        Field("qd", dof if settings.speed == "measured" else 0, "drive velocities", f"{angle}/s"),
        Field("tau", dof, "torques or forces as the drives report them"),
        Field("gripper", 1, "1 holds, 0 empty, -1 not told", initial=-1.0),
    )


def signals(
    model: Model, known: Knowledge, settings: OnlineSettings, anew: ca.SX
) -> tuple[Signals, Part]:
    """The first part of a cycle.

    Args:
        anew: 1 where filters begin anew behind this cycle; a symbol to be replaced.
    """
    dof, mechanism = model.dynamics.dof, model.dynamics.kinematics.mechanism
    inputs = inputs_of(model, settings)
    u = inputs.symbols("in")
    finite, count = all_finite(inputs.vector(u)), ca.SX.sym("live")
    waited = line(inputs, u, waits(model, settings).of(inputs), count > 0, finite)
    now = _instant(waited, count, ca.SX(model.gains), settings)
    q, qd, tau = now.q, now.qd, now.tau
    near = ca.SX.sym("z", dof)
    found = pose(mechanism, near, q)
    momentum, D = _columns(model, known, settings)
    load = _carried(model, qd, tau)
    period, K = settings.period, settings.corner
    lines = Lowpass.lines(K, period)
    along = ca.Function(
        "columns",
        [momentum.z, momentum.qd, momentum.load],
        [momentum.H @ D, momentum.W @ D, ca.substitute(momentum.dry, momentum.p, ca.SX(model.p))],
    )
    parts = along(found.z, qd, load)
    lacked = _lacked(known, settings, qd, load)
    parts = [ca.horzcat(parts[0], ca.SX(*lacked.shape)), ca.horzcat(parts[1], lacked), parts[2]]
    computed = ca.logic_and(*(all_finite(ca.vertcat(p.nz[:], tau)) for p in parts[:2]))
    good = ca.logic_and(finite, ca.logic_and(found.closed, computed))
    of_momentum, rest, dry = (only_if(good, part) for part in parts)
    qd, tau, z = only_if(good, qd), only_if(good, tau), chosen(good, found.z, ca.SX(model.home))
    live = ca.logic_and(now.live, good)
    shape = (ca.DM(of_momentum.sparsity(), 1) + ca.DM(rest.sparsity(), 1)).sparsity()
    before = ca.SX.sym("columns", shape.nnz())
    f = filtered_torque(of_momentum, rest, ca.SX(shape, before), lines, K)
    of_torque = Lowpass.held(K, period) if now.holds else lines
    torque_before, dry_before = ca.SX.sym("torque", dof), ca.SX.sym("dry", dof)
    torque = of_torque.output(torque_before, tau)
    dry = dry + _beyond(model, tau, settings)
    dry_now = lines.output(dry_before, dry)
    slow_before, slow = ca.SX.sym("slow", dof), 1 / (1 + (qd / ca.SX(known.slow_speed)) ** 2)
    slow_now = lines.output(slow_before, slow)
    both = only_if(live, ca.horzcat(torque - f.output[:, 0], f.output[:, 1:]))
    smooth_shape = both.sparsity()
    smooth_before = ca.SX.sym("smooth", smooth_shape.nnz())
    smooth = lines.output(ca.SX(smooth_shape, smooth_before), both)
    begins = ca.logic_or(anew, ca.logic_not(live))
    at = np.cumsum([1, len(known.entries.shown), known.directions.shape[1], len(known.followed)])
    kept = [
        _z(near, finite, found.z, model),
        *now.kept,
        _filter(
            "torque", torque_before, of_torque.keep(torque, tau), of_torque.before * tau, begins
        ),
        _filter("columns", before, _entries(f.kept, shape), _entries(f.resting, shape), begins),
        _filter(
            "smooth",
            smooth_before,
            _entries(lines.keep(smooth, both), smooth_shape),
            ca.SX.zeros(smooth_shape.nnz()),
            begins,
        ),
        _filter("dry", dry_before, lines.keep(dry_now, dry), lines.keep(dry, dry), begins),
        _filter("slow", slow_before, lines.keep(slow_now, slow), lines.keep(slow, slow), begins),
    ]
    return Signals(
        inputs, u, good, live, ca.logic_and(now.settled, good), z, qd, tau, waited.u["gripper"],
        torque=only_if(live, torque),
        residual=both[:, 0],
        columns=both[:, 1:],
        smooth_residual=smooth[:, 0],
        smooth_columns=smooth[:, 1:],
        at_load=slice(0, int(at[1]) - 1),
        at_directions=slice(int(at[1]) - 1, int(at[2]) - 1),
        at_friction=slice(int(at[2]) - 1, int(at[3]) - 1),
        at_lacked=slice(int(at[3]) - 1, int(at[3]) - 1 + lacked.shape[1]),
        dry=dry_now,
        slow=slow_now,
        momentum=momentum,
    ), Part(tuple(kept), ())  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Instant:
    """Where and how fast the robot is at one instant, and the torques there.

    Attributes:
        live: 1 where the cycles before were good, and
        settled: for so long that filters have forgotten what they began with.
        holds: whether the torque stays until the next instant.
    """

    q: ca.SX
    qd: ca.SX
    tau: ca.SX
    live: ca.SX
    settled: ca.SX
    holds: bool
    kept: tuple[Kept, ...]


def _instant(waited: Line, count: ca.SX, gains: ca.SX, settings: OnlineSettings) -> _Instant:
    """This cycle's, or the middle between the last one's and this one's.

    A torque that holds between two positions is that of the middle.

    Args:
        waited: what is read, of one instant.
        count: good cycles in a row.
    """
    u, q, tau = waited.u, waited.u["q"], gains * waited.u["tau"]
    held = settings.torque == "held"
    needed = waited.cycles + (1 if settings.speed == "measured" else 2)
    most = needed + round(_SETTLED * settings.rate / settings.corner)
    field = Field("live", 1, f"good cycles in a row, up to {most}")
    kept = [Kept(field, count, ca.fmin(count + 1, most), ca.SX(0)), *waited.kept]
    live, settled = count >= needed, count >= most
    if settings.speed == "measured":
        return _Instant(q, u["qd"], tau, live, settled, held, tuple(kept))
    dof = q.numel()
    q_before, tau_before = ca.SX.sym("q_before", dof), ca.SX.sym("tau_before", dof)
    kept += [
        Kept(
            Field("q_before", dof, "drive coordinates of the cycle before"), q_before, q, q_before
        ),
        Kept(Field("tau_before", dof, "torques of the cycle before"), tau_before, tau, tau_before),
    ]
    last = chosen(count > 0, q_before, q)
    middle = tau_before if held else 0.5 * (tau + tau_before)
    speed = (q - last) / settings.period
    return _Instant(0.5 * (q + last), speed, middle, live, settled, False, tuple(kept))


def _columns(model: Model, known: Knowledge, settings: OnlineSettings) -> tuple[Momentum, ca.DM]:
    """The equations, and directions of p: the model's own, a load, its errors, friction."""
    rest = dict.fromkeys(model.robot.friction_joints, settings.rest_speed)
    momentum = build_momentum(model.robot, model.dynamics.kinematics.mechanism, rest)
    unit, first = np.eye(model.p.size), model.layout.body(known.entries.body).start
    load = unit[:, [first + k for k in known.entries.shown]] * known.load_scales
    friction = unit[:, list(known.followed)] * known.friction_std
    D = np.column_stack([model.p, load, known.directions, friction])
    return momentum, ca.sparsify(ca.DM(D))


def _lacked(known: Knowledge, settings: OnlineSettings, qd: ca.SX, load: ca.SX) -> ca.SX:
    """Friction that many gears have and few models: more of it at low speed, and with what gears
    carry; each the same share of all drives."""
    sign = qd / ca.sqrt(qd * qd + settings.rest_speed**2)
    falling = known.unmodelled_slow * sign * ca.exp(-((qd / ca.SX(known.slow_speed)) ** 2))
    return ca.horzcat(falling, _CARRIED * sign * ca.fabs(load))


def _entries(matrix: ca.SX, shape: ca.Sparsity) -> ca.SX:
    return ca.project(matrix, shape).nz[:]


def _carried(model: Model, qd: ca.SX, tau: ca.SX) -> ca.SX:
    """What gears carry, x, from torques: τ = x + f + μ sign(q̇) |x|, without the rotors' share."""
    robot, none = model.robot, ca.SX(0)
    x, share = ca.SX(tau), ca.SX.zeros(tau.numel())
    for k, column in enumerate(joint_columns(robot), start=model.layout.coefficients.start):
        if column.joint in robot.drives and column.parameter.kind == "friction":
            i = robot.drives.index(column.joint)
            motion = JointMotion(none, qd[i], none, ca.SX(1))
            if column.parameter.symbol == "load":
                share[i] += model.p[k] * ca.sign(qd[i])
            else:
                x[i] -= model.p[k] * column.effort(motion)
    return x / (1 + share * ca.sign(x))


def _beyond(model: Model, tau: ca.SX, settings: OnlineSettings) -> ca.SX:
    """Size of torques at their limits, or at the end of their channel, where a report may not be
    what acts."""
    robot, found = model.robot, ca.SX.zeros(tau.numel())
    ends = np.abs(model.gains) * np.array(settings.torque_ends or [np.inf] * len(robot.drives))
    for i, drive in enumerate(robot.drives):
        limit = robot.drive_limits.get(drive)
        end = min(float(ends[i]), (limit and limit.effort) or np.inf)
        if np.isfinite(end):
            found[i] = end * (ca.fabs(tau[i]) >= 0.999 * end)
    return found


def _z(near: ca.SX, finite: ca.SX, z: ca.SX, model: Model) -> Kept:
    """The pose; where loops do not close yet it goes on from where it came, or from home."""
    home = ca.SX(model.home)
    field = Field("z", z.numel(), "pose [x, y, z, psi]", initial=tuple(model.home.tolist()))
    onwards = chosen(finite, chosen(all_finite(z), z, home), near)
    return Kept(field, near, z, onwards)


def _filter(name: str, before: ca.SX, kept: ca.SX, resting: ca.SX, begins: ca.SX) -> Kept:
    field = Field(name, before.numel(), f"filter of {name}")
    return Kept(field, before, chosen(begins, ca.vec(resting), ca.vec(kept)))
