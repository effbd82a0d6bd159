"""Which coordinates a robot's task z consists of: those of the platform point r, and ψ of a tool.

A Delta has z = (x, y, z) or (x, y, z, ψ). A mechanism of the user's own may have fewer: a planar
one (x, z), a sled (x), a turntable (ψ). Directions in which r does not move keep the coordinate 0.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Shaped

TaskName = Literal["x", "y", "z", "psi"]
NAMES: tuple[TaskName, ...] = ("x", "y", "z", "psi")
UNITS = {"x": "m", "y": "m", "z": "m", "psi": "rad"}


@dataclass(frozen=True)
class Task:
    """The entries of z, in their order: some of x, y and z, then ψ if the tool turns."""

    names: tuple[TaskName, ...]

    @property
    def axes(self) -> tuple[int, ...]:
        """Which of the world's axes 0, 1, 2 the point moves along; they come first in z."""
        return tuple(NAMES.index(name) for name in self.names if name != "psi")

    @property
    def turn(self) -> int | None:
        """The place of ψ in z; None for a robot that does not turn its tool."""
        return self.names.index("psi") if "psi" in self.names else None

    @property
    def moves(self) -> slice:
        """The places of the point's coordinates in z."""
        return slice(0, len(self.axes))

    def point(self, z: Float[np.ndarray, "*rows dof"]) -> Float[np.ndarray, "*rows 3"]:
        """The platform point r in the world [m]."""
        if self.axes == (0, 1, 2):
            return z[..., :3]
        r = np.zeros((*z.shape[:-1], 3))
        r[..., self.axes] = z[..., self.moves]
        return r

    def of_point(self, r: Shaped[np.ndarray, "*rows 3"]) -> Float[np.ndarray, "*rows moves"]:
        """The entries of z that a point in the world has."""
        return r[..., self.axes]
