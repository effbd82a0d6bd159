"""Where the direction of a friction joint is not known, because it is about to turn round.

Friction changes its sign with the speed ϑ̇. With noise on the positions, and channels that are
not read at the very same instant, the time of a reversal is known to about a sample; what torque
and model make of the rows about it can differ by the whole friction. A row is left out where

    |ϑ̇| ≤ δ |ϑ̈| + 3 σ,

δ the time by which torques and positions may be apart, a millisecond and no more than the time
between two samples, and σ the deviation that noise of the positions gives ϑ̇ after the filter:
for a drive in its own row, for a passive joint in the rows of all drives that move it. Where a
drive's torque has been interpolated, δ is longer by the samples that it was made of.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from deltaid.mechanism.kinematics import Kinematics

# A speed within so many standard deviations of zero may have either sign.
_CERTAIN = 3.0
# Torques and positions of one row are taken at the same instant within this [s].
_SAME = 1e-3


@dataclass(frozen=True, eq=False)
class Directions:
    """When joints turn round.

    Attributes:
        period: time between two samples [s].
        noise: σ of each drive's speed [rad/s or m/s].
        smear: over how many samples to either side each drive's torque is spread; empty for none.
    """

    period: float
    noise: Float[np.ndarray, " dof"]
    smear: tuple[int, ...] = ()

    def known(
        self,
        kinematics: Kinematics,
        z: Float[np.ndarray, "samples dof"],
        qd: Float[np.ndarray, "samples dof"],
        qdd: Float[np.ndarray, "samples dof"],
        within: float = _SAME,
    ) -> Bool[np.ndarray, "samples dof"]:
        """Whether in a drive's row the direction of every joint with friction is known.

        Args:
            within: longest δ [s].
        """
        robot, apart = kinematics.robot, np.full(qd.shape[1], min(self.period, within))
        if self.smear:
            apart += self.period * np.array(self.smear)
        known = np.abs(qd) > apart * np.abs(qdd) + _CERTAIN * self.noise
        known |= np.array([drive not in robot.friction for drive in robot.drives])
        passive = kinematics.passive_friction
        if passive.names:
            joints = passive.rates(z, qd, qdd)
            noise = np.linalg.norm(joints.slope * self.noise, axis=2)
            for k, moved_by in enumerate(passive.moved_by):
                speed, rise = np.abs(joints.speed[:, k, None]), np.abs(joints.acceleration[:, k])
                sure = speed > apart * rise[:, None] + _CERTAIN * noise[:, k, None]
                known &= sure | ~moved_by
        return known
