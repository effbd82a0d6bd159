"""What loads take of a robot's torques while they are held, and what pulls at it all the time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.recording.carried import carrier
from deltaid.recording.columns import Columns
from deltaid.robot.description import RobotDescription

Samples = Float[np.ndarray, "samples dof"]


@runtime_checkable
class Pull(Protocol):
    """Something beside the robot that takes torques of its drives."""

    def torques(self, z: Samples, qd: Samples) -> Samples:
        """What it takes along a motion."""
        ...


@dataclass(frozen=True, eq=False)
class Burden:
    """Loads as parameters of a robot whose other bodies weigh nothing and that has no friction.

    Attributes:
        dynamics: of the robot.
        columns: of the recording, which say when each load is held.
        p: of each load, in the order of `Columns.loads`.
        pulls: what takes torques all the time.
    """

    dynamics: Dynamics
    columns: Columns
    p: Float[np.ndarray, "loads parameters"]
    pulls: tuple[Pull, ...] = ()

    @classmethod
    def of_loads(
        cls,
        robot: RobotDescription,
        columns: Columns,
        loads: Sequence[Sequence[float]],
        pulls: Sequence[Pull] = (),
    ) -> "Burden":
        """Loads by their ten parameters each; none if their torques stay.

        Raises:
            RecordingError: the robot has no body that carries one of them.
        """
        dynamics = compiled(robot)
        p = np.zeros((len(columns.loads), len(dynamics.layout.names)))
        for row, load, ten in zip(p, columns.loads if loads else (), loads, strict=True):
            row[dynamics.layout.body(carrier(load, robot))] = ten
        return cls(dynamics, columns, p, tuple(pulls))

    def torques(
        self,
        time: Float[np.ndarray, " samples"],
        z: Samples,
        qd: Samples,
        qdd: Samples,
        extra: Float[np.ndarray, "samples extra"],
    ) -> Samples:
        """τ of all loads that are held, sample by sample, and of all that pulls."""
        taken = np.zeros_like(z)
        for pull in self.pulls:
            taken += pull.torques(z, qd)
        for p, held in zip(self.p, self.columns.held(time, extra), strict=True):
            at = np.flatnonzero(held)
            if at.size and p.any():
                taken[at] += self.dynamics.torque(z[at], qd[at], qdd[at], p)
        return taken
