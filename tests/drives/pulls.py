"""Forces on a robot that its description lacks."""

from dataclasses import dataclass

import numpy as np

from oracle.tree import Array
from plants import Truth


@dataclass(frozen=True, eq=False)
class Hose:
    """A hose, cable or spring at the platform: F = force − drag v/|v| − stiffness (r − rest).

    Attributes:
        force: (3,) in the world (N).
        drag: against the platform's velocity (N); zero at rest.
        stiffness: of the spring (N/m).
        rest: (3,) position of the platform at which the spring is relaxed (m).
    """

    force: Array
    drag: float
    stiffness: float
    rest: Array

    def pull(self, truth: Truth) -> Array:
        """F on the platform, (samples, 3)."""
        v = truth.zd[:, :3]
        speed = np.linalg.norm(v, axis=1, keepdims=True)
        way = np.divide(v, speed, out=np.zeros_like(v), where=speed > 0)
        return self.force - self.drag * way - self.stiffness * (truth.z[:, :3] - self.rest)

    def torque(self, truth: Truth) -> Array:
        """−Jᵀ F: torque that the motors must add, (samples, drives)."""
        return -np.einsum("szd,sz->sd", truth.hand[:, :3], self.pull(truth))


@dataclass(frozen=True, eq=False)
class Cable:
    """An elastic cable from the platform to a fixed point, always taut.

    Attributes:
        anchor: (3,) the fixed point in the world (m).
        stiffness: along the cable (N/m).
        slack: its length without tension (m).
    """

    anchor: Array
    stiffness: float
    slack: float

    def torque(self, truth: Truth) -> Array:
        """−Jᵀ F: torque that the motors must add, (samples, drives)."""
        along = self.anchor - truth.z[:, :3]
        length = np.linalg.norm(along, axis=1, keepdims=True)
        pull = self.stiffness * (length - self.slack) * along / length
        return -np.einsum("szd,sz->sd", truth.hand[:, :3], pull)


@dataclass(frozen=True, eq=False)
class Balancer:
    """A spring at each drive with the torque −stiffness (q − rest); both (drives,).

    In N m/rad and rad; in N/m and m for a linear drive.
    """

    stiffness: Array
    rest: Array

    def torque(self, truth: Truth) -> Array:
        """Torque that the motors must add, (samples, drives)."""
        return self.stiffness * (truth.q - self.rest)
