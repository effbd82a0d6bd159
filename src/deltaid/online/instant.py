"""What a cycle reads, on an even grid and all of one instant, and the pose there.

Rows come as buses deliver them: late by parts of a cycle, not new, or such as cannot be.
Filters take rows on an even grid. With stamps, `elapsed` since the last new row, a row that was
taken δ after its cycle is put there by the parabola through it and the two rows before, its speed
by the straight line. δ is what stamps run ahead of cycles; the difference of both clocks, which is
slow, is forgotten. Stamps that leave the grid by half a cycle are a hole: all begins anew.

A row that is not new, or cannot be, is skipped: in its place the motion goes on with the same
acceleration, 3 q₁ − 3 q₂ + q₃, and the torques of the row before. By how much the next row is off
that, over a cycle, counts as noise of speeds for as long as filters remember it; so does what the
parabola makes of noise. Where nobody says whether a row is new, one that repeats the row before bit
for bit is not, if few rows do.
A row cannot be whose torque is ten times the largest that a drive takes or is limited to, or whose
position needs such a torque in all drives at once. What goes on for 20 ms ends the motion: filters
begin anew with what is read then.

Where torques come later or earlier than their motion, signals wait for one another. A torque that
is reported δ_i late, τ_reported,i(t) = τ_i(t − δ_i), belongs to the motion of δ_i ago. So a cycle
takes the motion of w = max(0, δ_1, …) ago, and of each drive the torque that was reported w − δ_i
ago: all of one instant. What lies between two cycles is interpolated along a straight line. The
numbers that wait stand one behind the other and move on by one a cycle, so their count and the work
are fixed.

The pose z of measured drive coordinates is a closed form, or found by Newton steps cycle by cycle.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.identification.sources import delays_of
from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.rotation import inverse
from deltaid.model.model import Model
from deltaid.online.graph import CycleFields, Field, Layout, chosen, every, only_if
from deltaid.online.settings import OnlineKnowledge, OnlineSettings

# What a gripper says.
NOT_TOLD, EMPTY, HOLDS = -1.0, 0.0, 1.0
# How long a signal may wait: seconds and cycles.
_LONGEST, _MOST = 0.05, 500
# A part of a cycle that is none.
_NONE = 1e-6


def inputs_of(model: Model, settings: OnlineSettings) -> Layout:
    """What a cycle reads."""
    dof, units = model.dynamics.dof, model.robot
    angle = "m" if all(units.is_linear(drive) for drive in units.drives) else "rad"
    elapsed = "since the last new row by its stamp, 0 if this row is not new, -1 unknown"
    return Layout(
        Field("q", dof, "drive coordinates", angle),
        Field("qd", dof if settings.speed == "measured" else 0, "drive velocities", f"{angle}/s"),
        Field("tau", dof, "torques or forces as the drives report them"),
        Field("gripper", 1, "1 holds, 0 empty, -1 unknown", initial=NOT_TOLD),
        Field("elapsed", 1, elapsed, "s", initial=NOT_TOLD),
    )


@dataclass(frozen=True)
class Waits:
    """How long signals wait in a cycle, all in cycles.

    Attributes:
        motion: positions and speeds.
        torque: of each drive.
    """

    motion: float
    torque: tuple[float, ...]

    @property
    def whole(self) -> int:
        """Cycles by which what is known is late, the nearest whole number."""
        return round(self.motion)

    @property
    def cycles(self) -> int:
        """How many good ones must be before one, so that nothing is of earlier times."""
        return int(np.ceil(max(self.motion, *self.torque)))

    def of_inputs(self, inputs: Layout) -> list[float]:
        """Of each number that a cycle reads: the gripper goes with the motion, in whole cycles."""
        each = {"tau": [*self.torque], "gripper": [float(self.whole)], "elapsed": [0.0]}
        return [x for f in inputs.fields for x in each.get(f.name, [self.motion] * f.size)]


def waits(model: Model, settings: OnlineSettings) -> Waits:
    """What the drives' lags make signals wait: those of the settings, else those of the model.

    Raises:
        DeltaidError: their number is not that of the drives, or they are too long.
    """
    dof = len(model.robot.drives)
    given = delays_of(model) if settings.delay is None else np.atleast_1d(settings.delay)
    if given.size not in (1, dof):
        raise DeltaidError(
            f"has {given.size} numbers, and the robot has {dof} drives",
            where="delay",
            cure="give one for all drives, or one for each",
        )
    delay: Float[np.ndarray, " drives"] = np.broadcast_to(given, (dof,))
    motion = max(float(delay.max()), 0.0)
    longest = motion - min(float(delay.min()), 0.0)
    if not (longest <= _LONGEST and longest * settings.rate <= _MOST):
        raise DeltaidError(
            f"makes signals wait {1e3 * longest:.3g} ms, or {longest * settings.rate:.4g} cycles; "
            f"{1e3 * _LONGEST:g} ms and {_MOST} cycles are the most that a cycle keeps",
            where="delay",
            cure="lags of drives are some milliseconds: is it in seconds? What comes later is "
            "corrected before it is given",
        )
    cycles = settings.rate * np.array([motion, *(motion - delay)])
    cycles = np.where(np.abs(cycles - np.round(cycles)) < _NONE, np.round(cycles), cycles)
    return Waits(float(cycles[0]), tuple(cycles[1:].tolist()))


def line(
    fields: CycleFields,
    inputs: Layout,
    u: dict[str, ca.SX],
    waits: Sequence[float],
    goes_on: ca.SX,
    finite: ca.SX,
) -> dict[str, ca.SX]:
    """Let signals wait: what is read, all of one instant, by field.

    Args:
        inputs, u: what is read, with its symbols.
        waits: of each number, in cycles.
        goes_on: 1 where the cycle before was good; if not, it counts as if the robot had been
            where it is now.
        finite: 1 where all that is read is finite; if not, zeros are kept, and `goes_on` has to be
            0 in the next cycle.
    """
    counts = [int(np.ceil(wait)) for wait in waits]
    if not any(counts):
        return u
    (past,) = fields.keep(
        Field("waiting", sum(counts), "what waits, number by number, the latest first")
    )
    then, following, past = list[ca.SX](), list[ca.SX](), iter(ca.vertsplit(past))
    now = ca.vertsplit(only_if(finite, inputs.vector(u)))
    for number, wait, count in zip(now, waits, counts, strict=True):
        before = (ca.if_else(goes_on, value, number) for value in islice(past, count))
        values, share = [number, *before], count - wait
        mixed = share * values[count - 1] + (1 - share) * values[count] if share else values[-1]
        then.append(mixed)
        following += values[:count]
    fields.following["waiting"] = ca.vertcat(*following)
    return {name: ca.vertcat(*then[place]) for name, place in inputs.places.items()}


def instant(
    fields: CycleFields, u: dict[str, ca.SX], goes_on: ca.SX, gains: ca.SX, settings: OnlineSettings
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """q, q̇ and τ of this cycle, or of the middle between the last one and this one.

    A torque that holds between two positions is that of the middle.

    Args:
        u: what is read, of one instant.
        goes_on: 1 where the cycle before was good.
    """
    q, tau = u["q"], gains * u["tau"]
    if settings.speed == "measured":
        return q, u["qd"], tau
    q_before, tau_before = fields.keep(
        Field("q_before", q.numel(), "drive coordinates of the cycle before"),
        Field("tau_before", q.numel(), "torques of the cycle before"),
    )
    fields.following |= {"q_before": q, "tau_before": tau}
    fields.spoilt |= {"q_before": q_before, "tau_before": tau_before}
    last = chosen(goes_on, q_before, q)
    middle = tau_before if settings.torque == "held" else 0.5 * (tau + tau_before)
    return 0.5 * (q + last), (q - last) / settings.period, middle


# Newton's steps a cycle; each squares the distance, and a robot moves a few millimetres a cycle.
_STEPS = 2
# Loops that are open by less [m, rad] count as closed; rounding to floats leaves some 1e-6.
_CLOSED = 1e-5


def pose(mechanism: Mechanism, near: ca.SX, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """z of q, and whether the loops close there.

    Args:
        near: the cycle before's.
    """
    m, form, z = mechanism, mechanism.forward, near
    if form is not None:
        found = ca.Function("z", [m.q_symbols], [form.z, form.margin, form.modes])
        z, margin, modes = found(q)
        return z, ca.logic_and(margin > 0, ca.mmin(modes) > 0)
    step = m.z - inverse(ca.jacobian(m.closure, m.z)) @ m.closure
    move = ca.Function("move", [m.z, m.q_symbols], [step])
    for _ in range(_STEPS):
        z = move(z, q)
    gap, modes = ca.Function("check", [m.z, m.q_symbols], [m.closure, m.modes])(z, q)
    return z, ca.logic_and(ca.sum1(ca.fabs(gap)) < _CLOSED, ca.mmin(modes) > 0)


# Torques that no drive has, in units of its largest, and for how long rows are skipped at most [s].
_BEYOND, _LONGEST_SKIP = 10.0, 0.02
# Rows repeat where nothing changes, and are new, if more than this share of so many did.
_REPEATS, _ROWS = 0.2, 20
# A jump is larger than what steps of a coarse encoder may look like [rad or m].
_COARSE = 1e-3
# Over which the clocks of stamps and of cycles are taken for one [s].
_CLOCKS = 1.0
# Rows of the past that a motion goes on from; positions behind a skipped one that still have a
# share of it, as differences and means do.
_PAST, _BEHIND = 3, 3


def even_rows(
    fields: CycleFields,
    u: dict[str, ca.SX],
    finite: ca.SX,
    model: Model,
    known: OnlineKnowledge,
    settings: OnlineSettings,
    waiting: int,
) -> tuple[dict[str, ca.SX], ca.SX, ca.SX, ca.SX, ca.SX]:
    """Put rows on an even grid, and skip those that are not new or cannot be.

    Args:
        u: what is read.
        finite: 1 where all of it is.
        waiting: cycles for which signals wait.

    Returns:
        What is read, by field; 1 where the row is not used, as it is not new or cannot be; 1 where
        rows were skipped for too long, or behind a hole: all begins anew; 1 where no row that was
        skipped is in what the cycle uses; further noise of speeds by rows that were skipped or late
        [rad/s or m/s].
    """
    noise = ca.DM(np.array(settings.speed_noise or np.zeros(u["q"].numel())))
    h, dof, measured = settings.period, u["q"].numel(), "qd" in u
    names = ("q1", "q2", "q3", "tau1", "read", "off", *(("qd1", "qd2") if measured else ()))
    rows, missed, late, rests, repeating = fields.keep(
        Field("rows", 1, "rows in a row that were used, up to 3"),
        Field("missed", 1, "rows skipped in a row"),
        Field("late", 1, "by which the last row was taken after its cycle", "s"),
        Field("bridged", 1, "cycles in which a skipped row still has a share"),
        Field("repeating", 1, "share of rows that repeat the one before"),
    )
    past = fields.keep(*(Field(f"{name}_row", dof, "of rows before") for name in names))
    q1, q2, q3, tau1, read, off, *speeds = past
    has_past, elapsed, ahead = rows > _PAST - 0.5, u["elapsed"], 3 * q1 - 3 * q2 + q3
    stamped = elapsed > 0.5 * NOT_TOLD
    new = ca.logic_and(elapsed > 0, has_past)
    drift = late + elapsed - (missed + 1) * h
    hole = ca.logic_and(new, ca.fabs(drift) >= 0.5 * h)
    drift = ca.if_else(new, ca.if_else(hole, 0, drift * np.exp(-h / _CLOCKS)), late)
    at = ca.if_else(new, drift, 0.0)
    bend = ((u["q"] - q1) / (h + at) - (q1 - q2) / h) / (2 * h + at)
    q = chosen(new, 2 * q1 - q2 + 2 * h**2 * bend, u["q"])
    repeats = ca.sumsqr(u["q"] - read) + ca.sumsqr(u["tau"] - tau1) <= 0
    stale = every(has_past, repeats, repeating < _REPEATS)
    old = ca.logic_and(finite, ca.if_else(stamped, elapsed <= 0, stale))
    torque, jump = _bounds(model, known, settings)
    beyond = ca.logic_or(
        ca.mmax(ca.fabs(u["tau"]) / ca.SX(torque)) > 1,
        ca.mmax(ca.fabs(q - ahead) / ca.SX(jump)) > 1,
    )
    bad = ca.logic_or(old, every(finite, has_past, beyond))
    over = ca.logic_or(missed + 1 > max(_LONGEST_SKIP / h, 1.0), ca.logic_not(has_past))
    anew = ca.logic_or(hole, ca.logic_and(bad, over))
    skipped = ca.logic_and(bad, ca.logic_not(anew))
    even = u | {"q": chosen(skipped, ahead, q), "tau": chosen(skipped, tau1, u["tau"])}
    behind = ca.logic_and(missed > 0, ca.logic_not(bad))
    # the parabola has a q + b q₁ + …, a and b of at: noise of a speed beyond that of differences
    a, b = 2 * h**2 / ((2 * h + at) * (h + at)), 2 * at / (h + at)
    stretched = ca.sqrt(ca.fmax(0.5 * (a**2 + (1 - b) ** 2) - 1, 0))
    found = chosen(behind, ca.fabs(q - ahead) / h, stretched * noise)
    off = ca.fmax(off * np.exp(-settings.corner * h), found)
    following = {
        "q1": even["q"],
        "q2": q1,
        "q3": q2,
        "tau1": even["tau"],
        "read": u["q"],
        "off": off,
    }
    if measured:
        qd1, qd2 = speeds
        qd = chosen(new, qd1 + (u["qd"] - qd1) * (h / (h + at)), u["qd"])
        even["qd"] = chosen(skipped, 2 * qd1 - qd2, qd)
        following |= {"qd1": even["qd"], "qd2": qd1}
    bridged = ca.if_else(skipped, float(waiting + _BEHIND), ca.fmax(rests - 1, 0))
    numbers = {  # a row that is not new is no past
        "rows": ca.if_else(anew, ca.if_else(old, 0, 1), ca.fmin(rows + 1, _PAST)),
        "missed": ca.if_else(skipped, missed + 1, 0),
        "late": drift,
        "bridged": bridged,
        "repeating": repeating + (ca.if_else(repeats, 1.0, 0.0) - repeating) / _ROWS,
    }
    fields.following |= numbers | {f"{name}_row": x for name, x in following.items()}
    fields.spoilt |= dict.fromkeys(numbers, ca.SX(0))
    fields.spoilt |= {f"{name}_row": x for name, x in zip(names, past, strict=True)}
    return even, ca.logic_or(skipped, old), ca.logic_or(anew, rows < 0.5), bridged < 0.5, off


def _bounds(
    model: Model, known: OnlineKnowledge, settings: OnlineSettings
) -> tuple[Float[np.ndarray, " drives"], Float[np.ndarray, " drives"]]:
    """Torque of each drive as it reports it, and by how much its position may be off what the rows
    before let expect, beyond which a row cannot be."""
    efforts = [model.robot.limits_of(drive).effort or 0.0 for drive in model.robot.drives]
    bound = _BEYOND * np.maximum(known.largest, efforts)
    q = model.dynamics.kinematics.inverse(np.array(model.home))
    M = model.dynamics.terms(q, np.zeros_like(q), model.p).M
    jump = np.abs(np.linalg.inv(M)) @ bound * settings.period**2
    return bound / np.abs(model.gains), np.maximum(jump, _COARSE)
