"""Places of the platform that are the same in all recordings of a robot."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.robot.description import RobotDescription

# A recording's range along an axis is cut into three to seven places.
_PARTS = 3


@dataclass(frozen=True, eq=False)
class Lattice:
    """Cells of the workspace, halved until they are a third of a recording's range or less.

    Attributes:
        low: corner of the workspace [m].
        size: of a cell [m].
        halvings: how often each axis of the workspace's third was halved.
        first, count: cells that the recording reaches along each axis.
    """

    low: Float[np.ndarray, " 3"]
    size: Float[np.ndarray, " 3"]
    halvings: Int[np.ndarray, " 3"]
    first: Int[np.ndarray, " 3"]
    count: Int[np.ndarray, " 3"]

    @classmethod
    def over(cls, robot: RobotDescription, reach: Float[np.ndarray, "2 3"]) -> "Lattice":
        """That of a recording whose platform reached from one corner to another."""
        low, high = robot.workspace.bounding_box
        whole = np.maximum(high - low, 1e-9)
        times = whole / np.clip(reach[1] - reach[0], 1e-3 * whole, whole)
        halvings = np.floor(np.log2(times)).astype(int)
        size = whole / (_PARTS * 2.0**halvings)
        first = np.floor((reach[0] - low) / size).astype(int)
        last = np.ceil((reach[1] - low) / size).astype(int)
        return cls(low, size, halvings, first, np.maximum(last - first, 1))

    @property
    def box(self) -> Float[np.ndarray, "2 3"]:
        """What the cells cover [m]."""
        return self.low + np.stack([self.first, self.first + self.count]) * self.size

    @property
    def parts(self) -> tuple[int, int, int]:
        """Cells along each axis."""
        x, y, z = self.count.tolist()
        return x, y, z

    def name(self, number: int) -> str:
        """What a cell is called in every recording that has cells of its size."""
        x, y, _ = self.parts
        own = self.first + np.array([number % x, number // x % y, number // (x * y)])
        return f"place {'.'.join(map(str, self.halvings))}:{'.'.join(map(str, own))}"
