"""Random motions within a robot's limits, and motions slowed down until they keep every limit."""

from dataclasses import replace
from numbers import Integral

import numpy as np

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.limits import LimitsAlong
from deltaid.errors import KinematicsError, positive, typed
from deltaid.mechanism.kinematics import Kinematics, Samples
from deltaid.motion.fourier import FourierMotion
from deltaid.robot.description import RobotDescription

# Numbers of samples of a period at which `random_motion` and `tamed` check limits.
_GRID, INSTANTS = 400, 1000
# Largest number of random motions that are tried.
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
        DeltaidError: an argument has another type, or is not positive.
        KinematicsError: no motion within the description's limits was found.
    """
    typed("kinematics", kinematics, Kinematics, "the Kinematics of a robot")
    typed("rng", rng, np.random.Generator, "a generator, such as numpy.random.default_rng(0)")
    typed("harmonics", harmonics, Integral, "a whole number")
    positive("period", period)
    positive("harmonics", harmonics)
    robot, reason = kinematics.robot, ""
    for _ in range(_ATTEMPTS):
        motion = _scaled(robot, kinematics.dof, rng, period, harmonics)
        reason = _obstacle(kinematics, *motion.evaluate(np.linspace(0.0, period, _GRID)))
        if not reason:
            return motion
    raise KinematicsError(
        f"no random motion in the described workspace is possible: {reason}",
        where=robot.name,
        cure="check workspace (platform points have z < 0), the limbs' lengths and arrangement, "
        "and drive_limits in the description",
    )


def _obstacle(kinematics: Kinematics, z: Samples, zd: Samples, zdd: Samples) -> str:
    """Why a motion is impossible; empty if it is not."""
    try:
        q, _, _ = kinematics.drive_motion(z, zd, zdd)
    except KinematicsError as error:
        return error.what
    if np.ptp(np.sign(kinematics.regularity(z).determinant)) > 0:
        return "the robot passes through singular poses"
    for drive, angles in zip(kinematics.robot.drives, q.T, strict=True):
        low, high = kinematics.robot.limits_of(drive).range or (-np.inf, np.inf)
        if angles.min() < low or angles.max() > high:
            return f"{drive} leaves its {kinematics.robot.units(drive).motion} range"
    return ""


def _scaled(
    robot: RobotDescription, dof: int, rng: np.random.Generator, period: float, harmonics: int
) -> FourierMotion:
    w0, decay = 2 * np.pi / period, np.arange(1, harmonics + 1) ** -0.5
    sine, cosine = (rng.standard_normal((dof, harmonics)) * decay for _ in range(2))
    motion = FourierMotion(w0, np.zeros(dof), sine, cosine)
    z, zd, zdd = (np.abs(x).max(axis=0) for x in motion.evaluate(np.linspace(0, period, _GRID)))
    (centre, half), task, scale = robot.within(0.0), robot.task, np.ones(dof)
    m = task.moves
    scale[m] = 0.95 * np.minimum.reduce([half[m] / z[m], robot.platform_speed / zd[m],
                                         robot.platform_acceleration / zdd[m]])  # fmt: skip
    if task.turn is not None:
        turn, i, share = robot.turn, task.turn, np.inf
        if turn.has_range:
            centre[i], share = 0.5 * (turn.high + turn.low), 0.5 * (turn.high - turn.low) / z[i]
        scale[i] = 0.95 * min(turn.speed / zd[i], turn.acceleration / zdd[i], share)
    return FourierMotion(w0, centre, sine * scale[:, None], cosine * scale[:, None])


# Share of a torque limit that may be used; noise and a controller's feedback need the rest.
_EFFORT = 0.8
# Largest number of steps of slowing down.
_STEPS = 60
# Factor of speed, or of the size of the tool's turns, in each step.
_LESS = 0.93


def tamed(dynamics: Dynamics, p: Parameters, motion: FourierMotion) -> FourierMotion:
    """Reduce the tool's turns if only they exceed a limit, else slow the motion down, until it
    keeps all limits.

    Slowing leaves the path unchanged. Turns are reduced first, because a fourth drive that is short
    of torque would slow the whole robot down.

    Raises:
        KinematicsError: the path leaves the workspace, or standing on it takes too much torque.
    """
    limits, turn = LimitsAlong(dynamics), dynamics.robot.task.turn
    if turn is not None and not _is_within(limits, p, motion):
        still = _turning(motion, turn, 0.0)
        if _is_within(limits, p, still):
            ladder = (_turning(motion, turn, _LESS**k) for k in range(1, _STEPS))
            return next((m for m in ladder if _is_within(limits, p, m)), still)
    slower = (
        replace(motion, base_frequency=motion.base_frequency * _LESS**k) for k in range(_STEPS)
    )
    if (slow := next((m for m in slower if _is_within(limits, p, m)), None)) is not None:
        return slow
    use = _use(limits, p, replace(motion, base_frequency=motion.base_frequency * _LESS**_STEPS))
    worst = max(use, key=lambda name: use[name])
    raise KinematicsError(
        f"no motion keeps the described limits: {worst} is at {use[worst]:.0%} of what may be "
        "used of it, however slow the motion is",
        where=dynamics.robot.name,
        cure="check workspace, drive_limits and masses in the description",
    )


def _turning(motion: FourierMotion, turn: int, factor: float) -> FourierMotion:
    scale = np.ones((len(motion.centre), 1))
    scale[turn] = factor
    return replace(motion, sine=motion.sine * scale, cosine=motion.cosine * scale)


def _is_within(limits: LimitsAlong, p: Parameters, motion: FourierMotion) -> bool:
    return max(_use(limits, p, motion).values(), default=0.0) <= 1.0


def _use(limits: LimitsAlong, p: Parameters, motion: FourierMotion) -> dict[str, float]:
    z, zd, zdd = motion.evaluate(np.linspace(0.0, 2 * np.pi, INSTANTS) / motion.base_frequency)
    kinematic = limits.kinematic(z, zd, zdd).max(axis=0)
    efforts = limits.effort(z, zd, zdd, p).max(axis=0) / _EFFORT
    names = (*limits.names, *limits.efforts)
    return dict(zip(names, map(float, (*kinematic, *efforts)), strict=True))
