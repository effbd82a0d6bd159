"""Torques that a description lacks and that follow from the robot's motion alone."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.model.corrections import Kind
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples

InTask = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True, eq=False)
class AlongMotion(Addition):
    """Torques that are linear in their coefficients.

    Attributes:
        dynamics: of the robot.
    """

    dynamics: Dynamics

    kind: ClassVar[Kind]
    name: ClassVar[str]
    symbols: ClassVar[tuple[str, ...]]

    @abstractmethod
    def of_motion(self, z: InTask, qd: InTask) -> Values:
        """Entries along a motion."""

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        return self.of_motion(w.z, w.qd)

    @property
    def is_corrected(self) -> bool:
        return True

    def on(self, dynamics: Dynamics) -> "AlongMotion":
        return replace(self, dynamics=dynamics)
