"""Measured poses: readings of instruments, their slopes and unknowns.

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

# Units that users often forget to state, by their number per metre.
NAMED_UNITS = {1e3: "mm", 39.37: "inch", 100.0: "cm"}

Points = Float[np.ndarray, "rows 3"]
Tools = Float[np.ndarray, "rows ends 3"]
# Measured minus predicted [m], slopes of the prediction by the tool points of all ends, and by the
# instrument's unknowns.
Slopes = tuple[Float[np.ndarray, "rows values"], Float[np.ndarray, "rows values coordinates"],
               Float[np.ndarray, "rows values own"]]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Instrument(ABC):
    """Readings of one session: drive coordinates of each end [rad or m], values of the columns
    `read`, their standard deviation [m] (`usual` by default), and rows of the file."""

    kind: ClassVar[PoseKind]
    reading: ClassVar[str]
    readings: ClassVar[str]
    read: ClassVar[tuple[str, ...]]
    usual: ClassVar[float]
    unknowns: ClassVar[tuple[str, ...]] = ()
    source: str
    q: Float[np.ndarray, "rows ends drives"]
    values: Float[np.ndarray, "rows values"]
    noise: float
    rows: Int[np.ndarray, " rows"]

    @cached_property
    def numbers(self) -> Float[np.ndarray, "rows numbers"]:
        return np.hstack([self.q.reshape(len(self.q), -1), self.values])

    @cached_property
    def repeats(self) -> Int[np.ndarray, " rows"]:
        """For each reading, the first one with identical numbers."""
        _, first, which = np.unique(self.numbers, axis=0, return_index=True, return_inverse=True)
        return first[which.ravel()]

    @property
    def is_first(self) -> Bool[np.ndarray, " rows"]:
        return self.repeats == np.arange(len(self.repeats))

    @abstractmethod
    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        """A state of the instrument's unknowns that fits the tool points of its used readings."""

    @abstractmethod
    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        """Errors and slopes at tool points."""

    def moved(self, state: np.ndarray, by: Float[np.ndarray, " own"]) -> np.ndarray:
        """The state after a step of the unknowns."""
        return state + by


class PointReadings(Instrument):
    """3-D points of a tracker or of a camera with a tag; the state is a 3 × 4 matrix [R t]."""

    kind = readings = "points"
    reading = "point"
    read, usual = ("px", "py", "pz"), 2e-5
    unknowns = ("frame turn x", "frame turn y", "frame turn z", "frame x", "frame y", "frame z")

    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        return aligned(x[used, 0], self.values[used])

    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        R, t = state[:, :3], state[:, 3]
        turned = x[:, 0] @ R.T
        turns = np.stack([np.cross(axis, turned) for axis in np.eye(3)], axis=2)
        shifts, R = (np.broadcast_to(part, (len(x), 3, 3)) for part in (np.eye(3), R))
        return self.values - turned - t, R, np.concatenate([turns, shifts], axis=2)

    def moved(self, state: np.ndarray, by: Float[np.ndarray, " own"]) -> np.ndarray:
        turn = Rotation.from_rotvec(by[:3]).as_matrix()
        return np.column_stack([turn @ state[:, :3], state[:, 3] + by[3:]])


class ProbeReadings(Instrument):
    """Contacts with a plane, of a printer's or mill's touch probe; values are the heights of blocks
    on it. The state is h, a, b."""

    kind = "probe"
    reading, readings = "touch", "touches"
    read, usual = ("block",), 1e-5
    unknowns = ("plane height", "plane slope x", "plane slope y")

    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        A, height = np.insert(x[used, 0, :2], 0, 1.0, axis=1), x[used, 0, 2]
        return np.linalg.lstsq(A, height - self.values[used, 0], rcond=None)[0]

    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        A = np.insert(x[:, 0, :2], 0, 1.0, axis=1)
        error = A @ state + self.values[:, 0] - x[:, 0, 2]
        across = np.broadcast_to([-state[1], -state[2], 1.0], (len(A), 1, 3))
        return error[:, None], across, -A[:, None, :]


class DistanceReadings(Instrument):
    """Distances between two tool points each, by calliper or ballbar."""

    kind = readings = "distances"
    reading = "distance"
    read, usual = ("distance",), 2e-5

    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        return np.zeros(0)

    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        length = lengths(x)[:, None]
        along, none = ((x[:, 1] - x[:, 0]) / length)[:, None, :], np.zeros((len(x), 1, 0))
        return self.values - length, np.concatenate([-along, along], axis=2), none


def lengths(x: Tools) -> Float[np.ndarray, " rows"]:
    """Distances between both ends of each row [m]."""
    return np.linalg.norm(x[:, 1] - x[:, 0], axis=1)


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
