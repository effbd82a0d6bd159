"""Parts of a robot as a spanning tree of bodies with its loops cut (`tree.py`)."""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

Vector = Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class TreeJoint:
    """A joint with one coordinate, whose axis goes through the body's origin.

    Attributes:
        name: 'drive1', 'limb1_swing', …
        slides: or turns.
        axis: unit vector in the frame that the body's joints before this one leave.
    """

    name: str
    slides: bool
    axis: Vector


@dataclass(frozen=True)
class TreeBody:
    """A body and what joins it to its parent.

    Attributes:
        name: unique in the tree.
        parent: name of another body; empty for the world.
        R, r: pose of the link frame in the parent's, with all joints at zero [m].
        joints: one after the other.
        p: the ten inertia parameters of all bodies that move as this one.
    """

    name: str
    parent: str
    R: Float[np.ndarray, "3 3"]
    r: Vector
    joints: tuple[TreeJoint, ...]
    p: Float[np.ndarray, " 10"]


@dataclass(frozen=True)
class TreePoint:
    """A named point of a body, in its link frame [m]."""

    name: str
    body: str
    position: Vector


@dataclass(frozen=True)
class LoopCut:
    """Two points that coincide in the closed robot."""

    name: str
    first: TreePoint
    second: TreePoint


@dataclass(frozen=True)
class TreeStrut:
    """One strut as it is drawn, between two points of other bodies.

    The struts of a limb are one body of the tree, in their middle. They keep their distance along
    the driven body's y, about which they do not tilt, so no body of the tree carries both as lines.

    Attributes:
        name: 'strut1a', 'strut1b', …; 'strut1' where a limb has one.
        body: of the tree whose part it is.
        first, second: at the driven body and at the platform.
    """

    name: str
    body: str
    first: TreePoint
    second: TreePoint


@dataclass(frozen=True)
class Coupling:
    """A joint whose coordinate is `ratio` times that of the joint `follows`."""

    joint: str
    follows: str
    ratio: float


@dataclass(frozen=True)
class Tree:
    """The cut robot.

    Attributes:
        bodies: parents before children.
        cuts, couplings: what closes the loops.
        struts: to draw.
        coordinates: of every joint, by name, as functions of z in the closed robot.
        z: their symbols.
    """

    bodies: tuple[TreeBody, ...]
    cuts: tuple[LoopCut, ...]
    couplings: tuple[Coupling, ...]
    struts: tuple[TreeStrut, ...]
    coordinates: Mapping[str, ca.SX]
    z: ca.SX

    def joint_coordinates(self, z: Float[np.ndarray, " dof"]) -> dict[str, float]:
        """Coordinates of all joints at one pose."""
        values = ca.Function("x", [self.z], [ca.vertcat(*self.coordinates.values())])(z)
        return dict(zip(self.coordinates, np.asarray(values).ravel().tolist(), strict=True))

    def children(self, parent: str) -> tuple[TreeBody, ...]:
        """The bodies on one body; on the world for an empty name."""
        return tuple(body for body in self.bodies if body.parent == parent)
