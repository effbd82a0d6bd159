"""What drives do beside what a description says: friction of other forms, lags, gains, offsets.

What is left of torques when a model has been fitted is large where somebody pushes, but also where
friction is not what the description says, at low speed or in one direction, and wherever torques
change fast if they come late. Columns of all of these take part in the fit that looks for events,
so that none of them looks like one. They are drawn to zero and forgotten afterwards.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.effects.friction import SHAPES
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.windows import Samples

# Forms of friction of a joint, and columns a drive has of its torque: slope, size, itself.
FORMS, OF_TORQUE = len(SHAPES) + 1, 3
# Standard deviations that the columns' coefficients are drawn to zero with: friction and offsets as
# shares of the usual torque, lags [ms], load friction and gains.
_FRICTION, _LAG, _SHARE = 0.1, 4.0, 0.1


@dataclass(frozen=True, eq=False)
class Slack:
    """Columns for the joints of a robot, at its drives.

    Attributes:
        kinematics: of the robot.
        speed: of each joint, drives first, that its forms are scaled with [rad/s or m/s].
        torque: of each drive that coefficients are scaled with [N m or N].
    """

    kinematics: Kinematics
    speed: Float[np.ndarray, " joints"]
    torque: Float[np.ndarray, " dof"]

    @property
    def dof(self) -> int:
        """Number of drives."""
        return len(self.torque)

    @cached_property
    def deviations(self) -> Float[np.ndarray, " columns"]:
        """Standard deviations that coefficients are drawn to zero with."""
        friction = np.full(self.dof + FORMS * len(self.speed), _FRICTION)
        return np.append(friction, np.tile([_LAG, _SHARE, _SHARE], self.dof))

    def friction(self, w: Samples) -> Float[np.ndarray, "dof columns samples"]:
        """Offsets of the drives, and further forms of friction of all joints."""
        dof, (forms, arms) = self.dof, self._forms(w)
        out = np.zeros((dof, dof + FORMS * len(self.speed), len(w.time)))
        drives = np.arange(dof)
        out[drives, drives] = self.torque[:, None]
        for j, form in enumerate(forms):
            own = slice(dof + FORMS * j, dof + FORMS * (j + 1))
            if j < dof:
                out[j, own] = form * self.torque[j]
            else:
                out[:, own] = form * arms[j - dof][:, None]
        return out

    def friction_torque(
        self, w: Samples, coefficients: Float[np.ndarray, " columns"]
    ) -> Float[np.ndarray, "dof samples"]:
        """The sum of these columns."""
        dof, (forms, arms) = self.dof, self._forms(w)
        out = np.repeat((coefficients[:dof] * self.torque)[:, None], len(w.time), axis=1)
        for j, (form, of_form) in enumerate(
            zip(forms, coefficients[dof:].reshape(-1, FORMS), strict=True)
        ):
            if j < dof:
                out[j] += (of_form * self.torque[j]) @ form
            else:
                out += arms[j - dof] * (of_form @ form)
        return out

    def _forms(
        self, w: Samples
    ) -> tuple[Float[np.ndarray, "joints forms samples"], Float[np.ndarray, "passive dof samples"]]:
        """Forms of friction of each joint, and what passive joints make of theirs at the drives."""
        speed, slope = joint_rates(self.kinematics, w)
        v = (speed / self.speed).T
        size = np.abs(v)
        forms = [size, *(np.sign(v) * shape(size) for shape, _ in SHAPES)]
        arms = slope.transpose(1, 2, 0)
        largest = np.maximum(np.abs(arms).max(axis=2, initial=0.0), 1e-12)
        scale = (self.torque / largest).min(axis=1)
        return np.stack(forms, axis=1), arms * scale[:, None, None]

    def of_torque(
        self,
        tau: Float[np.ndarray, "dof samples"],
        rise: Float[np.ndarray, "dof samples"],
        speed: Float[np.ndarray, "dof samples"],
    ) -> Float[np.ndarray, "dof columns samples"]:
        """Lags [ms], shares of load friction and errors of gains of the drives.

        Args:
            tau, rise: torques by the model, and their rise [1/s].
            speed: of the drives.
        """
        dof = self.dof
        out = np.zeros((dof, OF_TORQUE * dof, tau.shape[1]))
        for i in range(dof):
            own = slice(OF_TORQUE * i, OF_TORQUE * (i + 1))
            out[i, own] = np.stack([-1e-3 * rise[i], np.abs(tau[i]) * np.sign(speed[i]), tau[i]])
        return out


def joint_rates(
    kinematics: Kinematics, w: Samples
) -> tuple[Float[np.ndarray, "samples joints"], Float[np.ndarray, "samples passive dof"]]:
    """Speeds of drives and passive joints with friction, and ∂ϑ/∂q of the latter."""
    passive = kinematics.passive_friction
    if not passive.names:
        return w.qd, np.zeros((len(w.time), 0, kinematics.dof))
    rates = passive.rates(w.z, w.qd, w.qdd)
    return np.hstack([w.qd, rates.speed]), rates.slope
