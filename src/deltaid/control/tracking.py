"""A sampled controller on a plant, and tracking errors.

A controller runs sample by sample, as in a drive: at each sample k of period T the drive reads its
encoders and computes a torque, which it holds until the next sample:

1. q_m = q(t_k) rounded to encoder steps; e = q_m − q_d(t_k).
2. ė = the difference of e over T through a first-order low-pass. Differentiating e instead of q_m
   causes no lag while the motion is followed.
3. The law uses e and ė `delay` samples later.
4. The law is evaluated for the middle of the interval in which its torque is held, with q_d and q̇_d
   of this time, q = q_d + e and q̇ = q̇_d + ė; torques are cut to the drives' limits.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from deltaid.control.controllers import Controller, ControlModel, Desired, tuned
from deltaid.control.options import ControllerName
from deltaid.control.plant import Plant, Running
from deltaid.control.trajectory import Trajectory
from deltaid.dynamics.limits import effort_limits
from deltaid.kernel.batch import BLOCK
from deltaid.mechanism.kinematics import Samples
from deltaid.model.model import Model
from deltaid.robot.limits import Task

# Resolution of a common encoder, 20 bits a turn [rad].
ENCODER_STEP = 2 * np.pi / 2**20
# Model of a controller: constant, or a function of time [s].
Knowledge = ControlModel | Callable[[float], ControlModel]


@dataclass(frozen=True)
class Drives:
    """Electronics of the drives.

    Attributes:
        rate: sampling rate [1/s].
        encoder_step: resolution of a measured coordinate [rad or m]; 0 for exact ones.
        delay: samples from an encoder's reading to its use.
        velocity_cutoff: of the low-pass on differences, as a share of the rate.
        current_loop: bandwidth [Hz] of the first-order lag from the commanded to the actual torque;
            infinite for none.
    """

    rate: float = 1000.0
    encoder_step: float = ENCODER_STEP
    delay: int = 0
    velocity_cutoff: float = 0.2
    current_loop: float = np.inf


@dataclass(frozen=True)
class TrackingError:
    """Tracking errors and torques, until the motion ends or the robot leaves its workspace.

    Attributes:
        drive_rms, drive_max: of q − q_d [rad or m].
        platform_rms, platform_max: distance of the platform point from its desired position [m].
        turn_rms, turn_max: of ψ − ψ_d [rad]; None for a robot that does not turn its tool.
        torque_rms, torque_max: of the torques applied [N m or N].
        saturated: share of the samples at which a limit cut a drive's torque.
    """

    drive_rms: Float[np.ndarray, " dof"]
    drive_max: Float[np.ndarray, " dof"]
    platform_rms: float
    platform_max: float
    turn_rms: float | None
    turn_max: float | None
    torque_rms: Float[np.ndarray, " dof"]
    torque_max: Float[np.ndarray, " dof"]
    saturated: Float[np.ndarray, " dof"]


@dataclass(frozen=True)
class Tracking:
    """A desired motion and the resulting one, one sample a row.

    Attributes:
        time: [s].
        q_desired, z_desired, q, z: drive and task coordinates; q and z are NaN after `ended`.
        tau: applied torques.
        saturated: whether a limit cut a drive's torque.
        ended: when the robot left its workspace [s]; None if it did not.
        task: components of z.
        qd: velocities of the drives.
    """

    time: Float[np.ndarray, " samples"]
    q_desired: Samples
    z_desired: Samples
    q: Samples
    z: Samples
    tau: Samples
    saturated: Bool[np.ndarray, "samples dof"]
    ended: float | None
    task: Task
    qd: Samples

    @property
    def drive_error(self) -> Samples:
        """Error q − q_d of the drives [rad or m]."""
        return self.q - self.q_desired

    @property
    def platform_error(self) -> Float[np.ndarray, " samples"]:
        """Distance of the platform point from its desired position [m]."""
        return np.linalg.norm((self.z - self.z_desired)[:, self.task.moves], axis=1)

    @property
    def turn_error(self) -> Float[np.ndarray, " samples"] | None:
        """ψ − ψ_d [rad]; None for a robot that does not turn its tool."""
        i = self.task.turn
        return None if i is None else self.z[:, i] - self.z_desired[:, i]

    @cached_property
    def valid(self) -> Bool[np.ndarray, " samples"]:
        """Whether a sample is before `ended`."""
        return self.time < (np.inf if self.ended is None else self.ended)

    @property
    def error(self) -> TrackingError:
        """Tracking errors and torques of the valid samples."""
        valid, tau = self.valid, self.tau[self.valid]
        drives, platform = self.drive_error[valid], self.platform_error[valid]
        turn = None if self.turn_error is None else self.turn_error[valid]
        return TrackingError(
            drive_rms=_rms(drives),
            drive_max=np.abs(drives).max(axis=0),
            platform_rms=float(_rms(platform)),
            platform_max=float(platform.max()),
            turn_rms=None if turn is None else float(_rms(turn)),
            turn_max=None if turn is None else float(np.abs(turn).max()),
            torque_rms=_rms(tau),
            torque_max=np.abs(tau).max(axis=0),
            saturated=self.saturated[valid].mean(axis=0),
        )


def track(
    plant: Model | Plant,
    controller: Controller,
    model: Knowledge,
    trajectory: Trajectory,
    drives: Drives,
) -> Tracking:
    """Run a controller that knows `model` on a robot `plant` along a trajectory, from its start.

    Args:
        model: model of the controller; a function of time if it changes, as when the controller
            learns of a load.

    Raises:
        KinematicsError: the trajectory is out of the plant's reach, or of the model's.
    """
    plant, period = plant if isinstance(plant, Plant) else Plant(plant), 1 / drives.rate
    known = model if callable(model) else lambda _: model
    time = np.arange(int(trajectory.duration * drives.rate + 1e-9) + 1) * period
    start, desired = trajectory.desired(time), trajectory.desired(time + 0.5 * period)
    limits, step = effort_limits(plant.model.robot), drives.encoder_step
    share = 1 - np.exp(-2 * np.pi * drives.velocity_cutoff)
    running = Running(plant, start.q[:1], start.qd[:1], drives.rate, drives.current_loop)
    path = np.empty((3, *start.q.shape))
    torques, wanted, errors, rates = (np.zeros_like(start.q) for _ in range(4))
    for k in range(len(time)):
        q = running.encoders
        path[:, k] = q[0], running.z[0], running.qd[0]
        errors[k] = (np.round(q / step) * step if step > 0 else q)[0] - start.q[k]
        if k > 0:
            slope = (errors[k] - errors[k - 1]) * drives.rate
            rates[k] = rates[k - 1] + share * (slope - rates[k - 1])
        now = Desired(*(x[k : k + 1] for x in (desired.z, desired.q, desired.qd, desired.qdd)))
        late = max(k - drives.delay, 0)
        measured = now.q + errors[late], now.qd + rates[late]
        wanted[k] = controller.torque(known(float(time[k])), *measured, now)[0]
        torques[k] = np.clip(wanted[k], -limits, limits)
        running.hold(torques[k : k + 1], float(time[k]))
    # A controller may lose the robot one sample earlier, because its model has other lengths.
    lost = np.flatnonzero(~(np.isfinite(path).all(axis=(0, 2)) & np.isfinite(wanted).all(axis=1)))
    return Tracking(
        time=time,
        q_desired=start.q,
        z_desired=start.z,
        q=path[0],
        z=path[1],
        qd=path[2],
        tau=torques,
        saturated=np.abs(wanted) > limits,
        ended=float(time[lost[0]]) if lost.size else None,
        task=plant.model.robot.task,
    )


def gains(
    name: ControllerName, model: ControlModel, trajectory: Trajectory, bandwidth: float
) -> Controller:
    """A controller tuned with a model's M along a trajectory; `bandwidth` in Hz.

    Raises:
        KinematicsError: the trajectory is out of reach.
    """
    return tuned(name, model.mass_diagonal(poses(trajectory)), bandwidth)


def poses(trajectory: Trajectory) -> Samples:
    """Drive coordinates along a trajectory for checks of M, as many as one block of a kernel."""
    return trajectory.desired(np.linspace(0.0, trajectory.duration, BLOCK)).q


def _rms(values: Float[np.ndarray, "samples *columns"]) -> Float[np.ndarray, "*columns"]:
    return np.sqrt((values**2).mean(axis=0))
