"""Courses of torques beside a robot's own columns: what many recordings would give, in one pass."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.estimation.additions import Addition, Own, Values
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.parameter import PriorParameter


@dataclass(frozen=True, eq=False)
class Courses(Addition):
    """Courses of torques over a recording, each in a column of its own for every drive.

    Attributes:
        torques: at every row of the recording [N m or N].
        rate: of the recording [Hz].
    """

    torques: Float[np.ndarray, "courses dof rows"]
    rate: float

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return tuple(
            PriorParameter("constant", f"course{k}", "torque", "", -np.inf, np.inf, 0.0, 1.0)
            for k in range(len(self.torques))
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        courses, dof, _ = self.torques.shape
        return np.tile(np.arange(dof), courses), np.repeat(np.arange(courses), dof)

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        rows = np.rint(w.time * self.rate).astype(int)
        return self.torques[:, :, rows].reshape(-1, len(rows))
