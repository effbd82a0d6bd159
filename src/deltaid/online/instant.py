"""What a cycle reads, all of one instant, and the pose there.

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

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.identification.as_identified import delays_of
from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.rotation import inverse
from deltaid.model.model import Model
from deltaid.online.graph import Kept, only_if
from deltaid.online.layout import Field, Layout
from deltaid.online.settings import OnlineSettings

# How long a signal may wait: seconds and cycles.
_LONGEST, _MOST = 0.05, 500
# A part of a cycle that is none.
_NONE = 1e-6


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

    def of(self, inputs: Layout) -> list[float]:
        """Of each number that a cycle reads: the gripper goes with the motion, in whole cycles."""
        each = {"tau": list(self.torque), "gripper": [float(self.whole)]}
        waits = (each.get(f.name, [self.motion] * f.size) for f in inputs.fields)
        return [one for field in waits for one in field]


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
    motion = float(np.maximum(delay.max(), 0.0))
    longest = motion - min(float(delay.min()), 0.0)
    if not (longest <= _LONGEST and longest * settings.rate <= _MOST):
        raise DeltaidError(
            f"makes signals wait {1e3 * longest:.3g} ms, or {longest * settings.rate:.4g} cycles; "
            f"{1e3 * _LONGEST:g} ms and {_MOST} cycles are the most that a cycle keeps",
            where="delay",
            cure="lags of drives are some milliseconds: is it in seconds? What comes later is put "
            "right before it is given",
        )
    cycles = settings.rate * np.array([motion, *(motion - delay)])
    cycles = np.where(np.abs(cycles - np.round(cycles)) < _NONE, np.round(cycles), cycles)
    return Waits(float(cycles[0]), tuple(cycles[1:].tolist()))


@dataclass(frozen=True, eq=False)
class Line:
    """What a cycle reads, all of one instant.

    Attributes:
        u: by field.
        cycles: how many good ones must have been before, so that nothing is of earlier times.
        kept: fields of the state; none where nothing waits.
    """

    u: dict[str, ca.SX]
    cycles: int
    kept: tuple[Kept, ...]


def line(
    inputs: Layout, u: dict[str, ca.SX], waits: Sequence[float], goes_on: ca.SX, finite: ca.SX
) -> Line:
    """Let signals wait.

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
        return Line(u, 0, ())
    past, start = ca.SX.sym("waiting", sum(counts)), 0
    then, following = list[ca.SX](), list[ca.SX]()
    now = ca.vertsplit(only_if(finite, inputs.vector(u)))
    for one, wait, count in zip(now, waits, counts, strict=True):
        before = ca.vertsplit(past[start : start + count]) if count else []
        values = [one, *(ca.if_else(goes_on, value, one) for value in before)]
        share = count - wait
        then.append(
            share * values[count - 1] + (1 - share) * values[count] if share else values[-1]
        )
        following += values[:count]
        start += count
    field = Field("waiting", start, "what waits, number by number, the latest first")
    u = {name: ca.vertcat(*then[at]) for name, at in inputs.places.items()}
    return Line(u, max(counts), (Kept(field, past, ca.vertcat(*following)),))


# Newton's steps a cycle; each squares the distance, and a robot moves a few millimetres a cycle.
_STEPS = 2
# Loops that are open by less [m, rad] count as closed; rounding to floats leaves some 1e-6.
_CLOSED = 1e-5


@dataclass(frozen=True)
class Pose:
    """z of one cycle, and whether the loops close there."""

    z: ca.SX
    closed: ca.SX


def pose(mechanism: Mechanism, near: ca.SX, q: ca.SX) -> Pose:
    """z of q.

    Args:
        near: the cycle before's.
    """
    form = mechanism.forward
    if form is not None:
        found = ca.Function("z", [mechanism.q_symbols], [form.z, form.margin, form.modes])
        z, margin, modes = found(q)
        return Pose(z, ca.logic_and(margin > 0, ca.mmin(modes) > 0))
    step = mechanism.z - inverse(ca.jacobian(mechanism.closure, mechanism.z)) @ mechanism.closure
    move = ca.Function("move", [mechanism.z, mechanism.q_symbols], [step])
    check = ca.Function(
        "check", [mechanism.z, mechanism.q_symbols], [mechanism.closure, mechanism.modes]
    )
    z = near
    for _ in range(_STEPS):
        z = move(z, q)
    gap, modes = check(z, q)
    return Pose(z, ca.logic_and(ca.sum1(ca.fabs(gap)) < _CLOSED, ca.mmin(modes) > 0))
