"""Inputs of a cycle, all of one instant, and the pose there.

If torques are late or early against their motion, signals are delayed. A torque that is reported
δ_i late, τ_reported,i(t) = τ_i(t − δ_i), belongs to the motion δ_i ago. So a cycle uses the motion
of w = max(0, δ_1, …) ago, and of each drive the torque that was reported w − δ_i ago: all of one
instant. Values between two cycles are interpolated linearly. Delayed numbers are stored in a shift
register, so memory and work are fixed.

The pose z of measured drive coordinates is a closed form, or follows by Newton steps cycle by
cycle.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.identification.sources import delays_of
from deltaid.mechanism.forward import CLOSED_SINGLE
from deltaid.mechanism.mechanism import Mechanism
from deltaid.model.model import Model
from deltaid.online.graph import CycleFields, Field, Layout, chosen, only_if
from deltaid.online.settings import OnlineSettings

# Values of a gripper's signal.
UNKNOWN, EMPTY, HOLDS = -1.0, 0.0, 1.0
# Longest delay of a signal, in seconds and in cycles, which a shift register stores.
_LONGEST, _MOST = 0.05, 500


def inputs_of(model: Model, settings: OnlineSettings) -> Layout:
    """Layout of a cycle's inputs."""
    dof, units = model.dynamics.dof, model.robot
    angle = "m" if all(units.linear_drives) else "rad"
    elapsed = "since the last new row by its stamp, 0 if this row is not new, -1 unknown"
    return Layout(
        Field("q", dof, "drive coordinates", angle),
        Field("qd", dof if settings.speed == "measured" else 0, "drive velocities", f"{angle}/s"),
        Field("tau", dof, "torques or forces as the drives report them"),
        Field("gripper", 1, "1 holds, 0 empty, -1 unknown", initial=UNKNOWN),
        Field("elapsed", 1, elapsed, "s", initial=UNKNOWN),
    )


@dataclass(frozen=True)
class Waits:
    """Delays of signals, in cycles.

    Attributes:
        motion: positions and speeds.
        torque: of each drive.
    """

    motion: float
    torque: tuple[float, ...]

    @property
    def whole(self) -> int:
        """Delay of the outputs, the nearest whole number of cycles."""
        return round(self.motion)

    @property
    def cycles(self) -> int:
        """Number of good cycles before one that uses none from before a gap."""
        return int(np.ceil(max(self.motion, *self.torque)))

    def of_inputs(self, inputs: Layout) -> list[float]:
        """Delay of each input; the gripper's equals the motion's, in whole cycles."""
        each = {"tau": [*self.torque], "gripper": [float(self.whole)], "elapsed": [0.0]}
        return [x for f in inputs.fields for x in each.get(f.name, [self.motion] * f.size)]


def waits(model: Model, settings: OnlineSettings) -> Waits:
    """Delays for the drives' lags: from the settings, otherwise from the model.

    Raises:
        DeltaidError: the number of lags is not one or the number of drives, or lags are too long.
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
    cycles = np.where(np.isclose(cycles, np.round(cycles)), np.round(cycles), cycles)
    return Waits(float(cycles[0]), tuple(cycles[1:].tolist()))


def line(
    fields: CycleFields,
    inputs: Layout,
    u: dict[str, ca.SX],
    waits: Sequence[float],
    goes_on: ca.SX,
    finite: ca.SX,
) -> dict[str, ca.SX]:
    """Delay signals: inputs, all of one instant, by field.

    Args:
        inputs, u: layout and symbols.
        waits: delay of each number, in cycles.
        goes_on: 1 where the previous cycle was good; if not, the robot is assumed to have rested.
        finite: 1 where all inputs are finite; if not, zeros are kept, and `goes_on` has to be 0 in
            the next cycle.
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
    """q, q̇ and τ of this cycle, or of the middle between the previous one and this one.

    A torque that is held between two positions belongs to the middle.

    Args:
        u: inputs of one instant.
        goes_on: 1 where the previous cycle was good.
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


# Newton steps per cycle: each squares the distance, and a robot moves a few millimetres per cycle.
_STEPS = 2


def pose(mechanism: Mechanism, near: ca.SX, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """z of q, and whether the loops close there.

    Args:
        near: z of the previous cycle.
    """
    m, form, z = mechanism, mechanism.forward, near
    if form is not None:
        closed_form = ca.Function("z", [m.q_symbols], [form.z, form.margin, form.modes])
        z, margin, modes = closed_form(q)
        return z, ca.logic_and(margin > 0, ca.mmin(modes) > 0)
    move = ca.Function("move", [m.z, m.q_symbols], [m.z - m.newton_step])
    for _ in range(_STEPS):
        z = move(z, q)
    gap, modes = ca.Function("check", [m.z, m.q_symbols], [m.closure, m.modes])(z, q)
    return z, ca.logic_and(ca.sum1(ca.fabs(gap)) < CLOSED_SINGLE, ca.mmin(modes) > 0)
