"""Random motions within a robot's limits: for base parameters, demonstrations and tests."""

import numpy as np
from jaxtyping import Float

from deltaid.errors import KinematicsError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.motion.fourier import FourierMotion
from deltaid.robot.description import RobotDescription

_GRID = 400
_ATTEMPTS = 100


def random_motion(
    kinematics: Kinematics,
    rng: np.random.Generator,
    *,
    period: float = 10.0,
    harmonics: int = 8,
) -> FourierMotion:
    """A periodic motion with random coefficients, scaled to stay within the description's limits.

    Amplitudes fall with the harmonic, so that no single one exhausts the acceleration.

    Raises:
        KinematicsError: no such motion was found; the description's limits leave no room.
    """
    robot = kinematics.robot
    reason = ""
    for _ in range(_ATTEMPTS):
        motion = _scaled(robot, kinematics.dof, rng, period, harmonics)
        time = np.linspace(0.0, period, _GRID)
        z, zd, zdd = motion.evaluate(time)
        try:
            q, _, _ = kinematics.drive_motion(z, zd, zdd)
        except KinematicsError as error:
            reason = error.what
            continue
        if np.ptp(np.sign(kinematics.regularity(z).determinant)) > 0:
            reason = "the robot passes through singular poses"
            continue
        reason = _outside(robot, q)
        if not reason:
            return motion
    raise KinematicsError(
        f"no random motion in the described workspace is possible: {reason}",
        where=robot.name,
        cure="check workspace (platform points have z < 0), the limbs' lengths and arrangement, "
        "and drive_limits in the description",
    )


def _outside(robot: RobotDescription, q: Float[np.ndarray, "samples dof"]) -> str:
    """The first drive that leaves its described range, in words; empty if none does."""
    for i, drive in enumerate(robot.drives):
        limits = robot.drive_limits.get(drive)
        if limits is not None and limits.range is not None:
            low, high = limits.range
            if q[:, i].min() < low or q[:, i].max() > high:
                what = "position" if robot.is_linear(drive) else "angle"
                return f"{drive} leaves its {what} range"
    return ""


def _scaled(
    robot: RobotDescription, dof: int, rng: np.random.Generator, period: float, harmonics: int
) -> FourierMotion:
    """Random coefficients, scaled to the workspace and to speed and acceleration limits."""
    w0 = 2 * np.pi / period
    decay = np.arange(1, harmonics + 1) ** -0.5
    sine = rng.standard_normal((dof, harmonics)) * decay
    cosine = rng.standard_normal((dof, harmonics)) * decay
    motion = FourierMotion(w0, np.zeros(dof), sine, cosine)
    z, zd, zdd = (np.abs(x).max(axis=0) for x in motion.evaluate(np.linspace(0, period, _GRID)))
    centre, half = robot.within(0.0)
    task, scale = robot.task, np.ones(dof)
    m = task.moves
    scale[m] = 0.95 * np.minimum.reduce([half[m] / z[m], robot.platform_speed / zd[m],
                                         robot.platform_acceleration / zdd[m]])  # fmt: skip
    if task.turn is not None:
        turn, i = robot.turn, task.turn
        shares = [turn.speed / zd[i], turn.acceleration / zdd[i]]
        if robot.platform_turns:  # a telescope turns without end
            shares.append(0.5 * (turn.high - turn.low) / z[i])
            centre[i] = 0.5 * (turn.high + turn.low)
        scale[i] = 0.95 * min(shares)
    return FourierMotion(w0, centre, sine * scale[:, None], cosine * scale[:, None])
