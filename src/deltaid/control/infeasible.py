"""What is wrong with a simulated motion: what no robot could run, and what a controller lost.

A simulation that ran is no proof that its motion can be run. Before any controller, the motion
itself may ask for more torque or speed than a drive has, or leave the workspace; after it, a
controller may have stood at a limit, or be far from the motion by the end. Each is told in its own
words, with its drive, its size, its time and its share of the time.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.control.tracking import Tracking, Trajectory
from deltaid.dynamics.limits import LimitsAlong, effort_limits
from deltaid.errors import sentence
from deltaid.model.model import Model

Signal = Float[np.ndarray, " samples"]
Kind = Literal[
    "torque", "speed", "acceleration", "range", "saturated", "lost", "branch", "diverged", "turn"
]
# A limit counts as broken beyond this: splines and filters may overshoot by rounding.
_BEYOND = 1.01
# Share of samples at a limit from which a controller counts as saturated.
_SATURATED = 1e-3
# Distance from the desired motion, as a share of the workspace's smallest half extent, and error of
# the tool's turn [rad], from which a motion is not followed any more.
_FAR, _TURNED = 0.2, np.pi / 2
# Instants at which the motion is looked at, a second.
_RATE, _MOST = 500.0, 50_000


@dataclass(frozen=True)
class MotionProblem:
    """One thing that makes a simulated motion worthless on a robot.

    Attributes:
        kind: what kind of thing.
        what: the drive, or the limit.
        text: a sentence with size, time and share.
        short: the same in a few words, for a table.
        size: how much: of a limit, as a share of it, 1.2 for a fifth beyond; otherwise in m or rad.
        time: where it is worst, or where it began [s].
        share: of the time.
    """

    kind: Kind
    what: str
    text: str
    short: str
    size: float
    time: float
    share: float


def of_motion(plant: Model, trajectory: Trajectory) -> tuple[MotionProblem, ...]:
    """What a motion asks of a plant beyond its limits, before any controller.

    Torques are those of the plant's inverse dynamics, which a perfect controller would apply.

    Raises:
        KinematicsError: the plant cannot reach the motion's poses.
    """
    samples = min(_MOST, max(2, round(trajectory.duration * _RATE)))
    time = np.linspace(0.0, trajectory.duration, samples)
    desired, dynamics, robot = trajectory.desired(time), plant.dynamics, plant.robot
    z = dynamics.kinematics.forward(desired.q)
    tau, limits = dynamics.torque(z, desired.qd, desired.qdd, plant.p), LimitsAlong(dynamics)

    def beyond(kind: Kind, what: str, use: Signal, asks: str, over: str, short: str) -> None:
        if use.max() > _BEYOND:
            worst, share = int(use.argmax()), float((use > 1).mean())
            text = f"{asks} at {time[worst]:.3g} s, {over} for {_percent(share)} of the time"
            size, at = float(use[worst]), float(time[worst])
            problems.append(MotionProblem(kind, what, text, short, size, at, share))

    problems: list[MotionProblem] = []
    for drive, largest, used in zip(robot.drives, effort_limits(robot), np.abs(tau.T), strict=True):
        units, most = robot.units(drive), float((used / largest).max())
        asks = f"the motion needs more {units.effort} than {drive} has: {most * largest:.3g} "
        asks += f"{units.force} of {largest:g} {units.force}"
        short = f"{drive} needs {most:.0%} of its {units.effort}"
        beyond("torque", drive, used / largest, asks, "beyond the limit", short)
    # ż and z̈ of drive rates: J ż = q̇, J z̈ = q̈ − J̇ ż.
    J = dynamics.kinematics.jacobian(z)
    zd = np.linalg.solve(J, desired.qd[:, :, None])
    along = dynamics.kinematics.jacobian_rate(z, zd[:, :, 0]) @ zd
    zdd = np.linalg.solve(J, desired.qdd[:, :, None] - along)[:, :, 0]
    for name, use in zip(limits.names, limits.kinematic(z, zd[:, :, 0], zdd).T, strict=True):
        kind, words = _kinematic(name)
        asks, over = f"{words}, {use.max():.0%} of what is described", "beyond it"
        beyond(kind, name, use, asks, over, f"{name} at {use.max():.0%}")
    return tuple(problems)


def _kinematic(name: str) -> tuple[Kind, str]:
    """What it is to break a limit of this name."""
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


def of_tracking(plant: Model, result: Tracking) -> tuple[MotionProblem, ...]:
    """What became of a motion under a controller that no one would want on a robot."""
    valid, robot = result.valid, plant.robot
    time, problems = result.time[valid], list[MotionProblem]()
    for drive, cut in zip(robot.drives, result.saturated[valid].T, strict=True):
        if cut.sum() > _SATURATED * len(cut):
            share, first = float(cut.mean()), float(time[cut.argmax()])
            text = (
                f"the controller stands at the {robot.units(drive).effort} limit of {drive} for "
                f"{_percent(share)} of the time, from {first:.3g} s on"
            )
            short = f"{drive} at its limit"
            problems.append(MotionProblem("saturated", drive, text, short, 1.0, first, share))
    if result.ended is not None:
        short, left = f"lost after {result.ended:.4g} s", 1.0 - result.ended / result.time[-1]
        text = sentence(
            f"{short}, where a limb was stretched",
            "its gains or its model do not hold the robot on this motion",
            "lower the gains, or take a slower motion",
        )
        found = MotionProblem("lost", "robot", text, short, 1.0, result.ended, float(left))
        problems.append(found)
    else:  # beyond a singular pose its drives turn a robot elsewhere
        sides = np.sign(plant.dynamics.kinematics.regularity(result.z).determinant)
        other = sides != sides[0]
        if other.any():
            first = float(result.time[other.argmax()])
            text = (
                f"passed through a singular pose at {first:.4g} s and went on in another assembly "
                "mode"
            )
            short, share = f"other mode from {first:.4g} s", float(other.mean())
            problems.append(MotionProblem("branch", "robot", text, short, 1.0, first, share))
    away = result.platform_error[valid]
    limit = _FAR * float(robot.within(0.0)[1][robot.task.moves].min())
    if away.max(initial=0.0) > limit:
        k, share = int(away.argmax()), float((away > limit).mean())
        text = (
            f"the loop does not follow: the platform is {1e3 * away[k]:.3g} mm from where it "
            f"should be at {time[k]:.3g} s, farther than {1e3 * limit:.3g} mm from "
            f"{time[(away > limit).argmax()]:.3g} s on, {_percent(share)} of the time"
        )
        short, size = f"platform {1e3 * away[k]:.3g} mm off", float(away[k])
        found = MotionProblem("diverged", "platform", text, short, size, float(time[k]), share)
        problems.append(found)
    turn = np.zeros(0) if result.turn_error is None else np.abs(result.turn_error[valid])
    if turn.max(initial=0.0) > _TURNED:
        k, share = int(turn.argmax()), float((turn > _TURNED).mean())
        whole = float(turn[k]) / (2 * np.pi)
        amount = f"{whole:.2g} turns" if whole >= 0.75 else f"{360 * whole:.0f}°"
        text = (
            f"the tool is off by {amount} at {time[k]:.3g} s, and by more than a quarter of a "
            f"turn for {_percent(share)} of the time"
        )
        short, size = f"tool off by {amount}", float(turn[k])
        problems.append(MotionProblem("turn", "tool", text, short, size, float(time[k]), share))
    return tuple(problems)


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"
