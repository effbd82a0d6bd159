"""Torques that no effect explains: smooth functions of each drive's own motion and torque.

    τ_i = Y_i p + Σ c_abk T_a(x) T_b(u) T_k(s_i) + Σ_{j≠i} d_j s_j,    0 < a + k ≤ 3 − b

with Chebyshev's polynomials T, the place x of the drive within its range, and its velocity u and
the torques s of the model as shares of their largest. What a cause does that no effect is of goes
there, instead of into effects that imitate it, and bodies and friction are estimated beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebvander

from deltaid.effects.along_motion import InTask
from deltaid.effects.point import SIZE, Added, Deviations, TracePoint
from deltaid.estimation.additions import OfTorques, Own, Values
from deltaid.estimation.drive_rows import ColumnsOfDrives, OfDrives
from deltaid.model.verdict import listed
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.parameter import PRIOR_SPREAD, PriorParameter

# The lowest degree of functions by which a torque constant changes with the size of a speed: u² s.
_DEGREE = 3
# Degrees in place, velocity and torque; friction has columns of the velocity alone, and a factor
# for all torques is not identifiable.
_DEGREES = tuple(
    (a, b, k)
    for a, b, k in product(range(_DEGREE + 1), repeat=3)
    if 0 < a + k <= _DEGREE - b and (a, b, k) != (0, 0, 1)
)
UNEXPLAINED = "unexplained"
_QUANTITIES = ("place", "speed", "torque")


@dataclass(frozen=True, eq=False)
class FreeTorque(OfTorques):
    """Columns of all drives, one drive after the other.

    Attributes:
        middle, half: of each drive's range [rad or m].
        fastest: the largest speed of each drive [rad/s or m/s].
        strongest: the largest torque of each drive [N m or N].
        deviation: prior standard deviation of each coefficient [N m or N].
    """

    middle: tuple[float, ...]
    half: tuple[float, ...]
    fastest: tuple[float, ...]
    strongest: tuple[float, ...]
    deviation: tuple[float, ...]

    is_corrected = True

    def follows(self, drive: int) -> tuple[str, ...]:
        """What each column of a drive varies with."""
        own = (
            listed([name for name, degree in zip(_QUANTITIES, degrees, strict=True) if degree])
            for degrees in _DEGREES
        )
        others = (name for k, name in enumerate(self.dynamics.robot.drives) if k != drive)
        return (*(f"its {names}" for names in own), *(f"the torque of {name}" for name in others))

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        robot, rows = self.dynamics.robot, self.pattern[0].tolist()
        owners = [robot.drives[i] for i in rows]
        return tuple(
            PriorParameter("effect", owner, f"free{k}", robot.units(owner).force, -np.inf, np.inf,
                           0.0, deviation / PRIOR_SPREAD)
            for k, (owner, deviation) in enumerate(zip(owners, self.deviation, strict=True))
        )  # fmt: skip

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows = np.repeat(np.arange(self.dynamics.dof), columns_of_drive(self.dynamics.dof))
        return rows, np.arange(len(rows))

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        q = self.dynamics.kinematics.inverse(w.z)
        return self.of_motion(q, w.qd, self.torques(w, own, recording).T)

    def of_motion(self, q: InTask, qd: InTask, tau: InTask) -> Values:
        """Entries by positions, velocities and torques of the drives."""
        shares = [(q - self.middle) / self.half, qd / self.fastest, tau / self.strongest]
        T = [chebvander(np.clip(share, -1.0, 1.0), _DEGREE) for share in shares]
        place, speed, torque = T
        own = [place[:, :, a] * speed[:, :, b] * torque[:, :, k] for a, b, k in _DEGREES]
        return np.concatenate([
            [*(column[:, i] for column in own), *np.delete(shares[2], i, axis=1).T]
            for i in range(len(self.middle))
        ])  # fmt: skip


def columns_of_drive(dof: int) -> int:
    return len(_DEGREES) + dof - 1


class Unexplained(Added):
    """Free functions of all drives' torques."""

    addition: FreeTorque

    def __init__(self, points: Sequence[TracePoint]) -> None:
        point, least = points[0], np.finfo(float).tiny
        q = np.concatenate([point.q for point in points])
        fastest = np.max([np.abs(point.motion.qd).max(axis=0) for point in points], axis=0)
        strongest = np.max([point.largest for point in points], axis=0)
        middle, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0)
        deviation = np.repeat(SIZE * strongest, columns_of_drive(point.dof))
        values = (middle, np.maximum(half, least), np.maximum(fastest, least), strongest, deviation)
        addition = FreeTorque(
            point.dynamics, (), point.p, *(tuple(value.tolist()) for value in values)
        )
        super().__init__(UNEXPLAINED, addition)

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        entries = self.addition.of_motion(point.q, point.motion.qd, point.model.T)
        rows, numbers = self.addition.pattern
        columns = np.zeros((point.dof, len(point.q), len(entries)))
        columns[rows, :, numbers] = entries * point.motion.weights.T[rows]
        return columns

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        return np.array(self.addition.deviation)

    def kinds(self, drive: int) -> dict[str, list[int]]:
        """Numbers of a drive's columns by what they vary with."""
        kinds, first = dict[str, list[int]](), drive * columns_of_drive(self.addition.dynamics.dof)
        for k, follows in enumerate(self.addition.follows(drive)):
            kinds.setdefault(follows, []).append(first + k)
        return kinds


def shares_of_torque(point: TracePoint, torques: OfDrives) -> Float[np.ndarray, " dof"]:
    """What torques vary by as a share of what those of the drives do."""
    return torques.std(axis=1) / np.maximum(point.model.std(axis=1), np.finfo(float).tiny)
