"""What loads take of a robot's torques while they are held."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.recording.carried import carrier
from deltaid.recording.columns import Columns
from deltaid.robot.description import RobotDescription

Samples = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True, eq=False)
class Burden:
    """Loads as parameters of a robot whose other bodies weigh nothing and that has no friction.

    Attributes:
        dynamics: of the robot.
        columns: of the recording, which say when each load is held.
        p: of each load, in the order of `Columns.loads`.
    """

    dynamics: Dynamics
    columns: Columns
    p: Float[np.ndarray, "loads parameters"]

    @classmethod
    def of(
        cls, robot: RobotDescription, columns: Columns, loads: Sequence[Sequence[float]]
    ) -> "Burden":
        """Loads by their ten parameters each.

        Raises:
            RecordingError: the robot has no body that carries one of them.
        """
        dynamics = compiled(robot)
        p = np.zeros((len(columns.loads), len(dynamics.layout.names)))
        for row, load, ten in zip(p, columns.loads, loads, strict=True):
            row[dynamics.layout.body(carrier(load, robot))] = ten
        return cls(dynamics, columns, p)

    def torques(
        self,
        time: Float[np.ndarray, " samples"],
        z: Samples,
        qd: Samples,
        qdd: Samples,
        extra: Float[np.ndarray, "samples extra"],
    ) -> Samples:
        """τ of all loads that are held, sample by sample."""
        taken = np.zeros_like(z)
        for p, held in zip(self.p, self.columns.held(time, extra), strict=True):
            at = np.flatnonzero(held)
            if at.size and p.any():
                taken[at] += self.dynamics.torque(z[at], qd[at], qdd[at], p)
        return taken
