"""A recording and the columns that explain its torques, for their expectation.

Nuisance columns stand for what the description may lack: other friction, lags, gains, offsets.
Without them, residuals at low speed, in one direction or where late torques change fast would look
like events. They have priors about zero and are discarded afterwards.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.joint import SHAPES
from deltaid.estimation.additions import Addition, Extended, entries, extended, torques_of
from deltaid.estimation.information import active_columns
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import Directions, SampleBlock
from deltaid.robot.parameter import PriorParameter

# Largest unknown lag of torques [s], for which the direction of friction is unknown at a reversal.
_APART = 5e-3
# Number of columns of a joint: offset, friction that differs by direction, shapes of friction.
_OF_JOINT = len(SHAPES) + 2
# Prior standard deviations of nuisance coefficients: lags [ms]; others as a share of the usual
# torque, which parameters of the robot may change as much.
_LAG, SHARE = 4.0, 0.1

Torques = Float[np.ndarray, "dof samples"]


@dataclass(frozen=True, eq=False)
class ExplainedRecording:
    """A robot with extra columns, and a recording with the repairs that are known."""

    dynamics: Dynamics
    additions: tuple[Addition, ...]
    recording: PreparedRecording

    @cached_property
    def regressor(self) -> Extended:
        return extended(self.dynamics, self.additions)

    @cached_property
    def active(self) -> Int[np.ndarray, " active"]:
        """Columns that torques depend on."""
        return active_columns(self.regressor)

    @cached_property
    def parameters(self) -> tuple[PriorParameter, ...]:
        more = (parameter for addition in self.additions for parameter in addition.parameters)
        parameters = (*self.dynamics.layout.parameters, *more)
        return tuple(parameters[k] for k in self.active)

    @cached_property
    def pattern(self) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
        """Drive of each entry, and number of its column among the active ones."""
        rows, columns = self.regressor.regressor_pattern
        return rows, np.searchsorted(self.active, columns)

    def entries(self, w: SampleBlock) -> Float[np.ndarray, "entries samples"]:
        return entries(self.regressor, w, w.tau, self.recording)

    def torques(
        self, values: Float[np.ndarray, "entries samples"], p: Float[np.ndarray, " active"]
    ) -> Torques:
        return torques_of(self.pattern, self.dynamics.dof, values, p)

    def counts(self, w: SampleBlock) -> Bool[np.ndarray, "dof samples"]:
        """Whether a drive's torque counts and the directions of all friction in it are known."""
        known = Directions(np.inf, np.zeros(self.dynamics.dof)).known(
            self.dynamics.kinematics, w.z, w.qd, w.qdd, within=_APART
        )
        return ((w.weights > 0.5) & known).T


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Nuisance columns: offsets and friction of joints, then those in proportion to torques.

    `speed` and `torque` are the usual ones of each joint (drives first) and drive, which scale the
    columns of friction and offsets.
    """

    kinematics: Kinematics
    speed: Float[np.ndarray, " joints"]
    torque: Float[np.ndarray, " dof"]

    @property
    def deviations(self) -> Float[np.ndarray, " columns"]:
        of_torque = np.tile([_LAG, SHARE, SHARE], len(self.torque))  # lag, load friction, gain
        return np.append(np.full(_OF_JOINT * len(self.speed), SHARE), of_torque)

    def friction(self, w: SampleBlock) -> Float[np.ndarray, "dof columns samples"]:
        """Torques at the drives of each joint's offset and shapes of friction."""
        speed, slope = joint_rates(self.kinematics, w)
        v = (speed / self.speed).T
        size, sign, offset = np.abs(v), np.sign(v), np.zeros_like(v)
        offset[: len(self.torque)] = 1.0
        shapes = np.stack([offset, size, *(sign * shape(size) for shape, _ in SHAPES)], axis=1)
        passive = slope.transpose(1, 2, 0)
        largest = np.maximum(np.abs(passive).max(axis=2, initial=0.0), 1e-12)
        passive = passive * (self.torque / largest).min(axis=1)[:, None, None]
        arms = np.vstack([np.diag(self.torque)[:, :, None] * np.ones(len(w.time)), passive])
        return np.einsum("jds,jks->djks", arms, shapes).reshape(len(self.torque), -1, len(w.time))

    def added(
        self, w: SampleBlock, tau: Torques, rate: float, x: Float[np.ndarray, " columns"]
    ) -> Torques:
        """Torques of the model plus those of these columns, at samples of this rate [Hz]."""
        of_joints, of_drives = np.split(x, [_OF_JOINT * len(self.speed)])
        rise = np.gradient(tau, axis=1) * rate if len(w.time) > 1 else 0 * tau
        by_torque = of_torques(tau, rise, w.qd.T) * of_drives.reshape(len(tau), -1, 1)
        return tau + of_joints @ self.friction(w) + by_torque.sum(axis=1)

    def lags(self, x: Float[np.ndarray, " columns"]) -> Float[np.ndarray, " dof"]:
        """How late torques are, to first order [s]."""
        of_drives = x[_OF_JOINT * len(self.speed) :]
        return 1e-3 * of_drives[:: len(of_drives) // len(self.torque)]


def of_torques(
    tau: Torques, rise: Torques, speed: Torques
) -> Float[np.ndarray, "dof columns samples"]:
    """Each drive's lag [ms], share of load friction and error of gain, from the model's torques,
    their rise [1/s] and the drives' speeds."""
    return np.stack([-1e-3 * rise, np.abs(tau) * np.sign(speed), tau], axis=1)


def joint_rates(
    kinematics: Kinematics, w: SampleBlock
) -> tuple[Float[np.ndarray, "samples joints"], Float[np.ndarray, "samples passive dof"]]:
    """Speeds of drives and passive joints with friction, and ∂ϑ/∂q of the latter."""
    passive = kinematics.passive_friction
    if not passive.names:
        return w.qd, np.zeros((len(w.time), 0, kinematics.dof))
    rates = passive.rates(w.z, w.qd, w.qdd)
    return np.hstack([w.qd, rates.speed]), rates.slope
