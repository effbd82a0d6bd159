"""Where along a motion forces are largest: one pass, constant memory."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.errors import RecordingError
from deltaid.joint_forces.constraint_forces import ConstraintForces, Motion


@dataclass(frozen=True)
class Instant:
    """A sample of a motion: time [s], task coordinates, drive speeds and accelerations."""

    time: float
    z: Float[np.ndarray, " dof"]
    qd: Float[np.ndarray, " dof"]
    qdd: Float[np.ndarray, " dof"]


@dataclass(frozen=True)
class Worst:
    """A force at the instant when it is worst.

    Attributes:
        part: strut, joint or bearing, such as 'strut1a' or 'motor2.moment.x'.
        kind: 'tension' is the largest force along a strut and 'compression' the least one,
            negative when it presses; 'socket' the least force that presses a strut onto its balls,
            springs left out; 'load' the component of a joint's force of largest size.
        channel: its name among the channels, which says at which end of a strut.
        unit: N or N m.
        value: the force.
        at: when.
    """

    part: str
    kind: str
    channel: str
    unit: str
    value: float
    at: Instant


@dataclass(frozen=True)
class Extremes:
    """The least and the largest value of every channel, and when it has them."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Float[np.ndarray, "two channels"]
    samples: Float[np.ndarray, "two channels columns"]

    def worst(self, part: str, kind: str, channels: Iterable[str], *, largest: bool) -> Worst:
        """The worst of some channels."""
        side = int(largest)
        at = [self.names.index(name) for name in channels]
        k = at[int((np.argmax if largest else np.argmin)(self.values[side, at]))]
        return self._worst(part, kind, side, k)

    def load(self, channel: str) -> Worst:
        """A channel where its size is largest."""
        k = self.names.index(channel)
        return self._worst(channel, "load", int(np.abs(self.values[:, k]).argmax()), k)

    def _worst(self, part: str, kind: str, side: int, k: int) -> Worst:
        time, *motion = self.samples[side, k]
        z, qd, qdd = np.split(np.array(motion), 3)
        value = float(self.values[side, k])
        instant = Instant(float(time), z, qd, qdd)
        return Worst(part, kind, self.names[k], self.units[k], value, instant)


def extremes(
    forces: ConstraintForces,
    p: Parameters,
    motion: Iterable[Motion],
) -> Extremes:
    """The extremes of all channels along a motion.

    Raises:
        RecordingError: the motion has no samples.
    """
    values, samples = np.array([]), np.array([])
    for part in motion:
        F = forces.evaluate(part.z, part.qd, part.qdd, p)
        at = np.stack([F.argmin(axis=0), F.argmax(axis=0)])
        found = np.take_along_axis(F, at, axis=0)
        rows = np.column_stack([part.time, part.z, part.qd, part.qdd])[at]
        if not values.size:
            values, samples = found, rows
            continue
        better = np.stack([found[0] < values[0], found[1] > values[1]])
        values = np.where(better, found, values)
        samples = np.where(better[..., None], rows, samples)
    if not values.size:
        raise RecordingError(
            "has no samples left",
            where="motion",
            cure="give a longer one; without velocities and accelerations the filter's length is "
            "lost at either end",
        )
    return Extremes(forces.names, forces.units, values, samples)


def worst_cases(forces: ConstraintForces, found: Extremes) -> tuple[Worst, ...]:
    """What a designer asks for: tension, compression and sockets of each strut, loads of joints."""
    cases = []
    for strut in forces.struts:
        along = (f"{strut}.platform.x", f"{strut}.elbow.x")
        cases.append(found.worst(strut, "tension", along, largest=True))
        cases.append(found.worst(strut, "compression", along, largest=False))
    if forces.socket_force is not None:
        for strut in forces.struts:
            ends = (f"{strut}.platform.out", f"{strut}.elbow.out")
            cases.append(found.worst(strut, "socket", ends, largest=False))
    loads = [n for n in forces.names if n.startswith(("motor", "telescope"))]
    cases += [found.load(name) for name in loads if not name.endswith(".drive")]
    return tuple(cases)
