"""Faults of a simulated motion: broken limits, and failures of the controller.

A simulation may succeed with a motion that no robot can run. The motion itself may exceed torque or
speed of a drive, or leave the workspace; a controller may saturate, or end far from the motion.
Each fault is reported with its drive, size, time and share of the time.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from deltaid.control.tracking import Tracking
from deltaid.control.trajectory import Trajectory
from deltaid.dynamics.limits import LimitsAlong, effort_limits
from deltaid.errors import sentence
from deltaid.model.model import Model
from deltaid.model.verdict import percent

Signal = Float[np.ndarray, " samples"]
Kind = Literal[
    "torque", "speed", "acceleration", "range", "saturated", "lost", "branch", "diverged", "turn"
]
# Share of a limit in use from which it counts as broken: splines and filters overshoot slightly.
_BEYOND = 1.01
# Share of samples at a limit from which a controller is saturated.
_SATURATED = 1e-3
# Distance from the desired motion, as a share of the workspace's smallest half extent, and error of
# the tool's turn [rad], from which a motion counts as lost.
_FAR, _TURNED = 0.2, np.pi / 2
# Instants of the motion that are checked: rate [1/s], and largest number.
_RATE, _MOST = 500.0, 50_000


@dataclass(frozen=True)
class MotionProblem:
    """A fault that makes a simulated motion worthless on a robot.

    Attributes:
        kind: kind of fault.
        what: the drive, or the limit.
        text: a sentence with size, time and share.
        short: the same in a few words, for a table.
        size: largest use as a share of the limit, 1.2 for a fifth beyond; without a limit, an error
            in m or rad.
        time: when it is worst, or when it begins [s].
        share: share of the time.
    """

    kind: Kind
    what: str
    text: str
    short: str
    size: float
    time: float
    share: float


def motion_problems(plant: Model, trajectory: Trajectory) -> tuple[MotionProblem, ...]:
    """Limits of a plant that a motion breaks, before any controller.

    Torques are those of the plant's inverse dynamics, which a perfect controller would apply.

    Raises:
        KinematicsError: the plant cannot reach the motion's poses.
    """
    samples = min(_MOST, max(2, round(trajectory.duration * _RATE)))
    time = np.linspace(0.0, trajectory.duration, samples)
    desired, dynamics, robot = trajectory.desired(time), plant.dynamics, plant.robot
    z = dynamics.kinematics.forward(desired.q)
    tau, limits = dynamics.torque(z, desired.qd, desired.qdd, plant.p), LimitsAlong(dynamics)

    problems = list[MotionProblem]()
    for drive, largest, used in zip(robot.drives, effort_limits(robot), np.abs(tau.T), strict=True):
        use, units = used / largest, robot.units(drive)
        problems += _problem(
            "torque",
            drive,
            time,
            _beyond(use),
            use,
            f"the motion needs more {units.effort} than {drive} has: {used.max():.3g} "
            f"{units.force} of {largest:g} {units.force} at {{at:.3g}} s, beyond the limit for "
            "{share} of the time",
            f"{drive} needs {use.max():.0%} of its {units.effort}",
        )
    # ż and z̈ of drive rates: J ż = q̇, J z̈ = q̈ − J̇ ż.
    J = dynamics.kinematics.jacobian(z)
    zd = np.linalg.solve(J, desired.qd[:, :, None])
    along = dynamics.kinematics.jacobian_rate(z, zd[:, :, 0]) @ zd
    zdd = np.linalg.solve(J, desired.qdd[:, :, None] - along)[:, :, 0]
    for name, use in zip(limits.names, limits.kinematic(z, zd[:, :, 0], zdd).T, strict=True):
        kind, words = _kinematic(name)
        problems += _problem(
            kind,
            name,
            time,
            _beyond(use),
            use,
            f"{words}, {use.max():.0%} of what is described at {{at:.3g}} s, beyond it for "
            "{share} of the time",
            f"{name} at {use.max():.0%}",
        )
    return tuple(problems)


def _beyond(use: Signal) -> Bool[np.ndarray, " samples"]:
    return (use > 1) & (use.max() > _BEYOND)


def _problem(
    kind: Kind, what: str, time: Signal, over: Bool[np.ndarray, " samples"], size: Signal | None,
    text: str, short: str,
) -> list[MotionProblem]:  # fmt: skip
    """A fault at its largest size, or at its beginning if it has no size; empty without `over`.

    `text` and `short` may name the times {at} and {first} and the {share} of the time.
    """
    if not over.any():
        return []
    k, first = int((over if size is None else size).argmax()), float(time[over.argmax()])
    at, share, worst = float(time[k]), float(over.mean()), 1.0 if size is None else float(size[k])
    said = text.format(at=at, first=first, share=percent(share))
    return [MotionProblem(kind, what, said, short.format(first=first), worst, at, share)]


def _kinematic(name: str) -> tuple[Kind, str]:
    """Kind and words of a broken limit of this name."""
    if "speed" in name:
        return "speed", f"the motion is too fast for {name.removesuffix(' speed')}"
    if name.startswith("platform ") and "acceleration" in name:
        return "acceleration", f"the motion accelerates the platform too much along {name[-1]}"
    if "acceleration" in name:
        moved = name.removesuffix(" acceleration")
        return "acceleration", f"the motion accelerates {moved} too much"
    if name.startswith("workspace"):
        return "range", f"the motion leaves the workspace: {name}"
    return "range", f"the motion leaves what the robot may reach, by its limit “{name}”"


def tracking_problems(plant: Model, result: Tracking) -> tuple[MotionProblem, ...]:
    """Faults of a motion under a controller."""
    valid, robot = result.valid, plant.robot
    time, problems = result.time[valid], list[MotionProblem]()
    for drive, cut in zip(robot.drives, result.saturated[valid].T, strict=True):
        problems += _problem(
            "saturated",
            drive,
            time,
            cut & (cut.sum() > _SATURATED * len(cut)),
            None,
            f"the controller stands at the {robot.units(drive).effort} limit of {drive} for "
            "{share} of the time, from {first:.3g} s on",
            f"{drive} at its limit",
        )
    if result.ended is not None:
        short, left = f"lost after {result.ended:.4g} s", 1.0 - result.ended / result.time[-1]
        text = sentence(
            f"{short}, where a limb was stretched",
            "its gains or its model do not hold the robot on this motion",
            "lower the gains, or take a slower motion",
        )
        problems.append(MotionProblem("lost", "robot", text, short, 1.0, result.ended, float(left)))
    else:  # beyond a singular pose the same drive motion moves the platform differently
        sides = np.sign(plant.dynamics.kinematics.regularity(result.z).determinant)
        problems += _problem(
            "branch",
            "robot",
            result.time,
            sides != sides[0],
            None,
            "passed through a singular pose at {first:.4g} s and went on in another assembly mode",
            "other mode from {first:.4g} s",
        )
    away = result.platform_error[valid]
    limit = _FAR * float(robot.within(0.0)[1][robot.task.moves].min())
    off = f"{1e3 * away.max(initial=0.0):.3g} mm"
    problems += _problem(
        "diverged",
        "platform",
        time,
        away > limit,
        away,
        f"the loop does not follow: the platform is {off} from where it should be at {{at:.3g}} s, "
        f"farther than {1e3 * limit:.3g} mm from {{first:.3g}} s on, {{share}} of the time",
        f"platform {off} off",
    )
    turn = result.turn_error
    turned = () if turn is None else _turn_problems(time, np.abs(turn[valid]))
    return (*problems, *turned)


def _turn_problems(time: Signal, turn: Signal) -> list[MotionProblem]:
    whole = float(turn.max(initial=0.0)) / (2 * np.pi)
    amount = f"{whole:.2g} turns" if whole >= 0.75 else f"{360 * whole:.0f}°"
    return _problem(
        "turn",
        "tool",
        time,
        turn > _TURNED,
        turn,
        f"the tool is off by {amount} at {{at:.3g}} s, and by more than a quarter of a turn for "
        "{share} of the time",
        f"tool off by {amount}",
    )
