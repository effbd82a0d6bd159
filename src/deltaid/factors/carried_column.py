"""What a gear loses of what it carries, as one column a drive: sign(q̇) |x|.

x is the torque on the link's side by known parameters, of the robot and of what it holds.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter


@dataclass(frozen=True, eq=False)
class CarriedColumns(Addition):
    """One column a drive.

    Attributes:
        dynamics: of the robot.
        p: parameters by which it is known what gears carry.
    """

    dynamics: Dynamics
    p: Float[np.ndarray, " parameters"]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """A share of the load each."""
        return tuple(
            Parameter("constant", drive, "carried", "1", -np.inf, np.inf, 0.0, 1.0)
            for drive in self.dynamics.robot.drives
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Each in its drive's row."""
        each = np.arange(self.dynamics.dof)
        return each, each

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        """sign(q̇) |x|."""
        del own, recording
        x = self.dynamics.carried(w.z, w.qd, w.qdd, self.p) + w.carried
        return (np.sign(w.qd) * np.abs(x)).T

    def on(self, dynamics: Dynamics) -> "CarriedColumns":
        return replace(self, dynamics=dynamics)
