"""Units and words for a joint that turns and for one that slides."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class JointUnits:
    """How a joint's numbers are called.

    Attributes:
        motion: 'angle' or 'position'.
        coordinate: unit of the joint's coordinate in files and arrays.
        shown: unit in which pictures for people show it.
        per_shown: how many of these make one of `coordinate`.
        effort: 'torque' or 'force'.
        force: its unit.
        stiffness: unit of a spring.
        inertia: unit of a rotor inertia reduced to the joint.
    """

    motion: str
    coordinate: str
    shown: str
    per_shown: float
    effort: str
    force: str
    stiffness: str
    inertia: str

    @property
    def speed(self) -> str:
        """Unit of the joint's speed."""
        return f"{self.coordinate}/s"


TURNING = JointUnits(
    motion="angle",
    coordinate="rad",
    shown="deg",
    per_shown=float(np.rad2deg(1.0)),
    effort="torque",
    force="N m",
    stiffness="N m/rad",
    inertia="kg m²",
)
SLIDING = JointUnits(
    motion="position",
    coordinate="m",
    shown="m",
    per_shown=1.0,
    effort="force",
    force="N",
    stiffness="N/m",
    inertia="kg",
)
