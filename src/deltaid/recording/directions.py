"""Where the direction of a friction joint is not known, because it is about to turn round.

Friction changes its sign with the speed ϑ̇. Recorded sample by sample, and with noise on the
positions, the instant of a reversal is known to a sample at best; what torque and model make of
the rows about it can differ by the whole friction. A row is left out where

    |ϑ̇| ≤ T |ϑ̈| + 3 σ,

T the time between samples and σ the deviation that noise of the positions gives ϑ̇ after the filter:
for a drive in its own row, for a passive joint in the rows of all drives that move it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from deltaid.mechanism.kinematics import Kinematics

# A speed within so many standard deviations of zero may have either sign.
_CERTAIN = 3.0


@dataclass(frozen=True, eq=False)
class Directions:
    """When joints turn round.

    Attributes:
        period: T [s].
        noise: σ of each drive's speed [rad/s or m/s].
    """

    period: float
    noise: Float[np.ndarray, " dof"]

    def known(
        self,
        kinematics: Kinematics,
        z: Float[np.ndarray, "samples dof"],
        qd: Float[np.ndarray, "samples dof"],
        qdd: Float[np.ndarray, "samples dof"],
    ) -> Bool[np.ndarray, "samples dof"]:
        """Whether in a drive's row the direction of every joint with friction is known."""
        robot = kinematics.robot
        known = np.abs(qd) > self.period * np.abs(qdd) + _CERTAIN * self.noise
        known |= np.array([drive not in robot.friction for drive in robot.drives])
        passive = kinematics.passive_friction
        if passive.names:
            joints = passive.rates(z, qd, qdd)
            noise = np.linalg.norm(joints.slope * self.noise, axis=2)
            sure = np.abs(joints.speed) > (
                self.period * np.abs(joints.acceleration) + _CERTAIN * noise
            )
            for k, moved_by in enumerate(passive.moved_by):
                known &= sure[:, k, None] | ~moved_by
        return known
