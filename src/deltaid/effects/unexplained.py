"""Torques that no effect explains: smooth functions of each drive's own motion and torque.

    τ_i = Y_i p + Σ c_abk T_a(x) T_b(u) T_k(s_i) + Σ_{j≠i} d_j s_j + Σ e_m T_m(t),
    0 < a + k ≤ 3 − b,    0 < m ≤ 3

with Chebyshev polynomials T of the drive's place x within its range, its velocity u, the model's
torques s, each as a share of the largest, and the time t within the recording. They absorb the
torque of an unknown cause, which effects, bodies and friction would mimic otherwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebvander

from deltaid.effects.along_motion import InTask
from deltaid.effects.point import SIZE, Added, Deviations, TracePoint
from deltaid.estimation.additions import Own, TorqueColumns, Values
from deltaid.estimation.drive_rows import ColumnsOfDrives, OfDrives
from deltaid.model.verdict import listed, percent
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.parameter import PRIOR_SPREAD, PriorParameter

# Largest degree: the least for a torque constant that changes with the size of the speed, u² s.
_DEGREE = 3

Times = Float[np.ndarray, " samples"]
_QUANTITIES = ("place", "speed", "torque")
# Degrees in place, velocity and torque, without those of the velocity alone, which friction has,
# and without a factor of the torque, which is not identifiable.
_DEGREES = tuple(
    (a, b, k)
    for a, b, k in product(range(_DEGREE + 1), repeat=3)
    if 0 < a + k <= _DEGREE - b and (a, b, k) != (0, 0, 1)
)
_OTHERS, _TIME = "torques of other drives", "time"
UNEXPLAINED = "unexplained"


def _follows(degrees: tuple[int, ...]) -> str:
    """What a product varies with."""
    names = [name for name, degree in zip(_QUANTITIES, degrees, strict=True) if degree]
    return f"its {listed(names)}"


# Degrees of the columns by their kind, the quantities that they vary with.
KINDS = {
    follows: tuple(degrees for degrees in _DEGREES if _follows(degrees) == follows)
    for follows in dict.fromkeys(map(_follows, _DEGREES))
} | {_OTHERS: (), _TIME: ()}


@dataclass(frozen=True, eq=False)
class FreeTorque(TorqueColumns):
    """Columns of one kind, one drive after the other.

    Attributes:
        kind: the quantities that they vary with.
        middle, half: of each drive's range [rad or m].
        fastest: the largest speed of each drive [rad/s or m/s].
        strongest: the largest torque of each drive [N m or N].
        deviation: prior standard deviation of each coefficient [N m or N].
    """

    kind: str
    middle: tuple[float, ...]
    half: tuple[float, ...]
    fastest: tuple[float, ...]
    strongest: tuple[float, ...]
    deviation: tuple[float, ...]

    is_corrected = True

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        robot, rows = self.dynamics.robot, self.pattern[0].tolist()
        owners = [robot.drives[i] for i in rows]
        return tuple(
            PriorParameter("effect", owner, f"{self.kind}, {k}", robot.units(owner).force,
                           -np.inf, np.inf, 0.0, deviation / PRIOR_SPREAD)
            for k, (owner, deviation) in enumerate(zip(owners, self.deviation, strict=True))
        )  # fmt: skip

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        columns = np.arange(len(self.deviation))
        return columns // (len(columns) // self.dynamics.dof), columns

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        q, tau = self.dynamics.kinematics.inverse(w.z), self.torques(w, own, recording)
        return self.along(q, w.qd, tau.T, _passed(recording, w.time))

    def along(self, q: InTask, qd: InTask, tau: InTask, passed: Times) -> Values:
        """Entries by positions, velocities and torques of the drives, and time from −1 to 1."""
        shares = [(q - self.middle) / self.half, qd / self.fastest, tau / self.strongest]
        if self.kind == _OTHERS:
            return np.concatenate([np.delete(shares[2], i, axis=1).T for i in range(q.shape[1])])
        if self.kind == _TIME:
            return np.tile(chebvander(passed, _DEGREE)[:, 1:].T, (q.shape[1], 1))
        T = [chebvander(np.clip(share, -1.0, 1.0), _DEGREE) for share in shares]
        place, speed, torque = T
        columns = [place[..., a] * speed[..., b] * torque[..., k] for a, b, k in KINDS[self.kind]]
        return np.stack(columns, axis=2).transpose(1, 2, 0).reshape(-1, len(q))


def _passed(recording: PreparedRecording, time: Times) -> Times:
    """Time from −1 at the beginning of a recording to 1 at its end."""
    return 2.0 * recording.drifting().share(time) - 1.0


class Unexplained(Added):
    """An effect with the columns of one kind of all drives."""

    addition: FreeTorque

    def __init__(self, points: Sequence[TracePoint], kind: str) -> None:
        point, least = points[0], np.finfo(float).tiny
        q = np.concatenate([point.q for point in points])
        fastest = np.max([np.abs(point.motion.qd).max(axis=0) for point in points], axis=0)
        strongest = np.max([point.largest for point in points], axis=0)
        middle, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0)
        others = {_OTHERS: point.dof - 1, _TIME: _DEGREE}
        deviation = np.repeat(SIZE * strongest, others.get(kind, len(KINDS[kind])))
        values = (middle, np.maximum(half, least), np.maximum(fastest, least), strongest, deviation)
        addition = FreeTorque(
            point.dynamics, (), point.p, kind, *(tuple(value.tolist()) for value in values)
        )
        super().__init__(f"{UNEXPLAINED} {kind}", addition)

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        motion = point.motion
        passed = _passed(point.trace.recording, motion.time)
        entries = self.addition.along(point.q, motion.qd, point.model.T, passed)
        rows, numbers = self.addition.pattern
        columns = np.zeros((point.dof, len(point.q), len(entries)))
        columns[rows, :, numbers] = entries * motion.weights.T[rows]
        return columns

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        return np.array(self.addition.deviation)


def is_unexplained(name: str) -> bool:
    return name.startswith(UNEXPLAINED)


def shares_of_torque(point: TracePoint, torques: OfDrives) -> Float[np.ndarray, " dof"]:
    """Standard deviation of torques over that of the drives' torques; 0 for a drive that rests."""
    usual = point.model.std(axis=1)
    return np.divide(torques.std(axis=1), usual, out=np.zeros_like(usual), where=usual > 0)


def in_words(share: float, drive: str, varies: str) -> str:
    """The words for a share of a drive's torque and the clause on what it varies with."""
    return f"{UNEXPLAINED}: {percent(share)} of {drive}'s torque, {varies}"
