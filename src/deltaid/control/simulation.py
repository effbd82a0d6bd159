"""Motion of a robot under torques: by an adaptive solver, or in time steps with friction at rest.

With friction that jumps at rest, a solver with error control stops or chatters. So `integrate` is
for robots whose friction is continuous, and `step_through` for all; neither replaces the other
automatically.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from deltaid.dynamics.dynamics import Parameters
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.errors import DeltaidError, KinematicsError, within
from deltaid.levels import ROUNDING
from deltaid.mechanism.forward import CLOSED
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.one_or_many import as_rows, real_numbers, require_finite
from deltaid.shown import Shown

# Torques as a function of time and the drives' q and q̇, one state a row.
Torque = Callable[[float, Samples, Samples], Samples]
History = Float[np.ndarray, "times states dof"]

# Relative error of a step; the absolute one (m, rad, and per s) is rounding. Energy then stays
# within 1e-10 over ten seconds. Run times for 10 s of a Delta: DOP853 0.2 s; LSODA 0.2 to 0.6 s,
# less accurate; CVODES (Adams) 0.08 s, but without batches or torques from Python.
_RELATIVE = 1e-10
# Longest time step [s]: a fast robot moves by half a millimetre, less than a drive's controller
# resolves.
LONGEST_STEP = 2.5e-4


@dataclass(frozen=True, repr=False)
class StatePath(Shown):
    """States over time: one slice for each time, one row for each initial state, even a single one.

    Attributes:
        time: [s].
        z, zd: task coordinates and velocities; NaN after a robot left its workspace.
    """

    time: Float[np.ndarray, " times"]
    z: History
    zd: History


def no_torque(time: float, q: Samples, qd: Samples) -> Samples:
    """Torques of drives that are switched off."""
    return np.zeros_like(q)


def integrate(
    forward: ForwardDynamics,
    p: Parameters,
    z: Samples,
    zd: Samples,
    time: Float[np.ndarray, " times"],
    torque: Torque = no_torque,
) -> StatePath:
    """Integrate the equations of motion from one or many initial states.

    One call of an eighth-order Runge–Kutta method (DOP853) integrates all states with common steps.

    Raises:
        DeltaidError: friction jumps at rest with these parameters.
        KinematicsError: a limb becomes stretched, at the time in the message; or states or torques
            have a wrong shape or are not finite.
        DescriptionError: p is not finite.
    """
    z, zd = _states(forward, p, z, zd)
    time = real_numbers(time, "time").astype(float)
    if not forward.is_smooth(p):
        raise DeltaidError(
            "friction that jumps at rest has no solution that a solver with error control finds",
            where=forward.robot.name,
            cure="use step_through",
        )
    shape = (2, *z.shape)

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        z, zd = x.reshape(shape)
        tau = _applied(torque, t, *forward.drive_motion(z, zd))
        return np.concatenate([zd.ravel(), forward.task_acceleration(z, zd, tau, p).ravel()])

    def margin(t: float, x: np.ndarray) -> float:
        return float(np.nan_to_num(forward.reach(x.reshape(shape)[0]), nan=-1.0).min()) - CLOSED

    margin.terminal = True  # pyright: ignore[reportFunctionMemberAccess], SciPy's way to say it
    span, start = (float(time[0]), float(time[-1])), np.concatenate([z.ravel(), zd.ravel()])
    solved = solve_ivp(
        rate, span, start, method="DOP853", t_eval=time, events=margin, rtol=_RELATIVE,
        atol=ROUNDING,
    )  # fmt: skip
    if solved.status != 0:
        at = solved.t_events[0][0] if solved.status == 1 else solved.t[-1]
        raise KinematicsError(
            f"a limb is stretched after {at:.4g} s; what follows is another working mode",
            where=forward.robot.name,
            cure="simulate a shorter time, or apply torques that hold the robot",
        )
    states = solved.y.T.reshape(len(time), *shape)
    return StatePath(np.asarray(time, dtype=float), states[:, 0], states[:, 1])


def step_through(
    forward: ForwardDynamics,
    p: Parameters,
    z: Samples,
    zd: Samples,
    duration: float,
    torque: Torque = no_torque,
    rate: float = 1000.0,
) -> StatePath:
    """Motion from one or many states under torques that are held for 1/rate, as by drives.

    Each sample is divided into steps of `ForwardDynamics.step` of at most `LONGEST_STEP`. States
    are NaN once a limb becomes stretched; other rows continue.

    Raises:
        KinematicsError: states or torques have a wrong shape or are not finite.
        DescriptionError: p is not finite.
    """
    z, zd = _states(forward, p, z, zd)
    within("duration", duration, (0.0, math.inf))
    samples, (substeps, h) = round(duration * rate), time_steps(rate)
    _, qd = forward.drive_motion(z, zd)
    path = np.empty((2, samples + 1, *z.shape))
    path[:, 0] = z, qd
    for k in range(samples):
        tau = _applied(torque, k / rate, forward.drive_coordinates(z), qd)
        for _ in range(substeps):
            z, qd = forward.step(z, qd, tau, p, h)
        path[:, k + 1] = z, qd
    flat = path.reshape(2, -1, z.shape[1])
    velocity = forward.task_velocity(flat[0], flat[1]).reshape(path.shape[1:])
    return StatePath(np.arange(samples + 1) / rate, path[0], velocity)


def _states(
    forward: ForwardDynamics, p: Parameters, z: Samples, zd: Samples
) -> tuple[Samples, ...]:
    """Initial states with one a row, of a motion with parameters p.

    Raises:
        KinematicsError: they have a wrong shape, or are not finite.
        DescriptionError: p is not finite.
    """
    forward.layout.require_finite(p)
    z, zd = as_rows(forward.dof, z=z, zd=zd)
    require_finite(z=z, zd=zd)
    return z, zd


def _applied(torque: Torque, time: float, q: Samples, qd: Samples) -> Samples:
    """Torques of a user's function, finite wherever the state is."""
    q, tau = as_rows(q.shape[1], q=q, tau=torque(time, q, qd))
    require_finite(q=np.hstack([q, qd]), tau=tau)
    return tau


def time_steps(rate: float, longest: float = LONGEST_STEP) -> tuple[int, float]:
    """Number and length [s] of the time steps within one sample of a drive."""
    substeps = int(np.ceil(1 / (rate * longest) - 1e-9))
    return substeps, 1 / (rate * substeps)
