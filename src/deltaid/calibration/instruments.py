"""What instruments show of tool points: rows, their slopes, and unknowns of the instrument.

Points      m = R x + t of a tracker or camera, whose frame (R, t) is unknown
Probe       z − (h + a x + b y + block) = 0 on a plane of unknown height and slopes, bare or on
            blocks of known height
Distances   |x_A − x_B| of a calliper or ballbar
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from deltaid.sensors.planning.offers import PoseKind

Points = Float[np.ndarray, "rows 3"]
Tools = Float[np.ndarray, "rows ends 3"]


@dataclass(frozen=True, eq=False)
class Slopes:
    """Rows of an instrument at some tool points.

    Attributes:
        error: measured less predicted [m].
        tools: slopes of the prediction by the tool points of all ends.
        own: slopes of the prediction by changes of the instrument's unknowns.
    """

    error: Float[np.ndarray, "rows values"]
    tools: Float[np.ndarray, "rows values coordinates"]
    own: Float[np.ndarray, "rows values own"]


@dataclass(frozen=True, eq=False)
class Instrument(ABC):
    """Readings of one session.

    Attributes:
        readings: what they are called.
        source: file that they come from.
        q: drive coordinates of each end [rad or m].
        values: what was read [m].
        noise: standard deviation of each value, as stated [m].
        rows: of the file, for messages.
    """

    kind: ClassVar[PoseKind]
    readings: ClassVar[str]
    unknowns: ClassVar[tuple[str, ...]] = ()
    source: str
    q: Float[np.ndarray, "rows ends drives"]
    values: Float[np.ndarray, "rows values"]
    noise: float
    rows: Int[np.ndarray, " rows"]

    @cached_property
    def numbers(self) -> Float[np.ndarray, "rows numbers"]:
        """All numbers of each reading."""
        return np.hstack([self.q.reshape(len(self.q), -1), self.values])

    @cached_property
    def repeats(self) -> Int[np.ndarray, " rows"]:
        """Of each reading, the first that has the same numbers, digit by digit."""
        _, first, which = np.unique(self.numbers, axis=0, return_index=True, return_inverse=True)
        return first[which.ravel()]

    @property
    def is_first(self) -> Bool[np.ndarray, " rows"]:
        """Whether no earlier reading has the same numbers."""
        return self.repeats == np.arange(len(self.repeats))

    @abstractmethod
    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        """A state of the instrument's unknowns that fits the tool points of its used readings."""

    @abstractmethod
    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        """Errors and slopes at tool points."""

    def moved(self, state: np.ndarray, by: Float[np.ndarray, " own"]) -> np.ndarray:
        """The state after changes of the unknowns."""
        return state + by


class PointReadings(Instrument):
    """3-D points; the state is a 3 × 4 matrix [R t]."""

    kind = readings = "points"
    unknowns = ("frame turn x", "frame turn y", "frame turn z", "frame x", "frame y", "frame z")

    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        return aligned(x[used, 0], self.values[used])

    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        R, t = state[:, :3], state[:, 3]
        turned = x[:, 0] @ R.T
        own = np.zeros((len(turned), 3, 6))
        own[:, :, 3:] = np.eye(3)
        for k, axis in enumerate(np.eye(3)):
            own[:, :, k] = np.cross(axis, turned)
        return Slopes(self.values - turned - t, np.broadcast_to(R, (len(own), 3, 3)), own)

    def moved(self, state: np.ndarray, by: Float[np.ndarray, " own"]) -> np.ndarray:
        turn = Rotation.from_rotvec(by[:3]).as_matrix()
        return np.column_stack([turn @ state[:, :3], state[:, 3] + by[3:]])


class ProbeReadings(Instrument):
    """Contacts with a plane; values are the heights of blocks on it. The state is h, a, b."""

    kind = "probe"
    readings = "touches"
    unknowns = ("plane height", "plane slope x", "plane slope y")

    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        x = x[used]
        A = np.insert(x[:, 0, :2], 0, 1.0, axis=1)
        return np.linalg.lstsq(A, x[:, 0, 2] - self.values[used, 0], rcond=None)[0]

    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        A = np.insert(x[:, 0, :2], 0, 1.0, axis=1)
        error = A @ state + self.values[:, 0] - x[:, 0, 2]
        across = np.broadcast_to([-state[1], -state[2], 1.0], (len(A), 1, 3))
        return Slopes(error[:, None], across, -A[:, None, :])


class DistanceReadings(Instrument):
    """Distances between two tool points each."""

    kind = readings = "distances"

    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        return np.zeros(0)

    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        way = x[:, 1] - x[:, 0]
        length = np.linalg.norm(way, axis=1, keepdims=True)
        along = (way / length)[:, None, :]
        return Slopes(
            self.values - length,
            np.concatenate([-along, along], axis=2),
            np.zeros((len(way), 1, 0)),
        )


KINDS: dict[PoseKind, type[Instrument]] = {
    "points": PointReadings, "probe": ProbeReadings, "distances": DistanceReadings,
}  # fmt: skip


def aligned(x: Points, m: Points, mirrored: bool = False) -> Float[np.ndarray, "3 4"]:
    """[R t] of least squares with m ≈ R x + t (Kabsch 1976), R a reflection where mirrored."""
    mean_x, mean_m = x.mean(axis=0), m.mean(axis=0)
    U, _, Vt = np.linalg.svd((m - mean_m).T @ (x - mean_x))
    sign = np.sign(np.linalg.det(U @ Vt)) * (-1.0 if mirrored else 1.0)
    R = U @ np.diag([1.0, 1.0, sign]) @ Vt
    return np.column_stack([R, mean_m - R @ mean_x])
