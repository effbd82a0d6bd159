"""What is wrong with a simulated motion: what no robot could run, and what a controller lost.

A simulation that ran is no proof that its motion can be run. Before any controller, the motion
itself may ask for more torque or speed than a drive has, or leave the workspace; after it, a
controller may have stood at a limit, or be far from the motion by the end. Each is told in its own
words, with its drive, its size, its time and its share of the time.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from deltaid.control.tracking import Tracking
from deltaid.control.trajectory import Trajectory
from deltaid.dynamics.limits import LimitsAlong, effort_limits
from deltaid.errors import sentence
from deltaid.mechanism.kinematics import Kinematics, Samples
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
    tau = dynamics.torque(z, desired.qd, desired.qdd, plant.p)
    found = []
    for i, largest in enumerate(effort_limits(robot)):
        use = np.abs(tau[:, i]) / largest
        if use.max() > _BEYOND:
            found.append(_effort(plant, i, use, time))
    limits = LimitsAlong(dynamics)
    use = limits.kinematic(z, *_rates(dynamics.kinematics, z, desired.qd, desired.qdd))
    for name, shares in zip(limits.names, use.T, strict=True):
        if shares.max() > _BEYOND:
            found.append(_kinematic(name, shares, time))
    return tuple(found)


def _rates(kinematics: Kinematics, z: Samples, qd: Samples, qdd: Samples) -> tuple[Samples, ...]:
    """ż and z̈ of drive rates: J ż = q̇, J z̈ = q̈ − J̇ ż."""
    J = kinematics.jacobian(z)
    zd = np.linalg.solve(J, qd[:, :, None])
    along = kinematics.jacobian_rate(z, zd[:, :, 0]) @ zd
    return zd[:, :, 0], np.linalg.solve(J, qdd[:, :, None] - along)[:, :, 0]


def _effort(plant: Model, i: int, use: Signal, time: Signal) -> MotionProblem:
    drive, worst = plant.robot.drives[i], int(use.argmax())
    units, limit = plant.robot.units(drive), float(effort_limits(plant.robot)[i])
    share = float((use > 1).mean())
    needed = f"{use[worst] * limit:.3g} {units.force}"
    return MotionProblem(
        kind="torque",
        what=drive,
        text=f"the motion needs more {units.effort} than {drive} has: {needed} of "
        f"{limit:g} {units.force} at {time[worst]:.3g} s, beyond the limit for "
        f"{_percent(share)} of the time",
        short=f"{drive} needs {use[worst]:.0%} of its {units.effort}",
        size=float(use[worst]),
        time=float(time[worst]),
        share=share,
    )


def _kinematic(name: str, use: Signal, time: Signal) -> MotionProblem:
    worst, share = int(use.argmax()), float((use > 1).mean())
    kind: Kind = "range"
    words = f"the motion leaves what the robot may reach, by its limit “{name}”"
    if "speed" in name:
        kind, words = "speed", f"the motion is too fast for {name.removesuffix(' speed')}"
    elif "acceleration" in name:
        kind = "acceleration"
        words = f"the motion accelerates {name.removesuffix(' acceleration')} too much"
        if name.startswith("platform "):
            words = f"the motion accelerates the platform too much along {name[-1]}"
    elif name.startswith("workspace"):
        words = f"the motion leaves the workspace: {name}"
    return MotionProblem(
        kind=kind,
        what=name,
        text=f"{words}, {use[worst]:.0%} of what is described at {time[worst]:.3g} s, beyond it "
        f"for {_percent(share)} of the time",
        short=f"{name} at {use[worst]:.0%}",
        size=float(use[worst]),
        time=float(time[worst]),
        share=share,
    )


def of_tracking(plant: Model, result: Tracking) -> tuple[MotionProblem, ...]:
    """What became of a motion under a controller that no one would want on a robot."""
    valid = result.time < (np.inf if result.ended is None else result.ended)
    if not valid.any():
        return (_lost(result),)
    found = [
        _saturated(plant, i, result.saturated[valid, i], result.time[valid])
        for i in range(result.saturated.shape[1])
        if result.saturated[valid, i].mean() > _SATURATED
    ]
    found += [_lost(result)] if result.ended is not None else _branch(plant, result)
    _, half = plant.robot.within(0.0)
    away, limit = result.platform_error[valid], _FAR * float(half[plant.robot.task.moves].min())
    if away.size and away.max() > limit:
        found.append(_far(away, limit, result.time[valid]))
    turn = result.turn_error
    if turn is not None and np.abs(turn[valid]).max() > _TURNED:
        found.append(_turned(turn[valid], result.time[valid]))
    return tuple(found)


def _saturated(
    plant: Model, i: int, cut: Bool[np.ndarray, " samples"], time: Signal
) -> MotionProblem:
    drive, share = plant.robot.drives[i], float(cut.mean())
    first = float(time[int(cut.argmax())])
    return MotionProblem(
        kind="saturated",
        what=drive,
        text=f"the controller stands at the {plant.robot.units(drive).effort} limit of {drive} for "
        f"{_percent(share)} of the time, from {first:.3g} s on",
        short=f"{drive} at its limit",
        size=1.0,
        time=first,
        share=share,
    )


def _lost(result: Tracking) -> MotionProblem:
    ended = float(result.ended or 0.0)
    left = 1.0 - ended / float(result.time[-1])
    return MotionProblem(
        kind="lost",
        what="robot",
        text=sentence(
            f"lost after {ended:.4g} s, where a limb was stretched",
            "its gains or its model do not hold the robot on this motion",
            "lower the gains, or take a slower motion",
        ),
        short=f"lost after {ended:.4g} s",
        size=1.0,
        time=ended,
        share=left,
    )


def _branch(plant: Model, result: Tracking) -> list[MotionProblem]:
    """Where a robot went through a singular pose, beyond which its drives turn it elsewhere."""
    sides = np.sign(plant.dynamics.kinematics.regularity(result.z).determinant)
    other = sides != sides[0]
    if not other.any():
        return []
    first = float(result.time[int(other.argmax())])
    text = f"passed through a singular pose at {first:.4g} s and went on in another assembly mode"
    share = float(other.mean())
    return [
        MotionProblem("branch", "robot", text, f"other mode from {first:.4g} s", 1.0, first, share)
    ]


def _far(away: Signal, limit: float, time: Signal) -> MotionProblem:
    worst, first = int(away.argmax()), float(time[int((away > limit).argmax())])
    share = float((away > limit).mean())
    return MotionProblem(
        kind="diverged",
        what="platform",
        text=f"the loop does not follow: the platform is {1e3 * away[worst]:.3g} mm from where it "
        f"should be at {time[worst]:.3g} s, farther than {1e3 * limit:.3g} mm from {first:.3g} s "
        f"on, {_percent(share)} of the time",
        short=f"platform {1e3 * away[worst]:.3g} mm off",
        size=float(away[worst]),
        time=float(time[worst]),
        share=share,
    )


def _turned(error: Signal, time: Signal) -> MotionProblem:
    worst, share = int(np.abs(error).argmax()), float((np.abs(error) > _TURNED).mean())
    size = float(np.abs(error[worst]))
    whole = size / (2 * np.pi)
    amount = f"{whole:.2g} turns" if whole >= 0.75 else f"{np.rad2deg(size):.0f}°"
    return MotionProblem(
        kind="turn",
        what="tool",
        text=f"the tool is off by {amount} at {time[worst]:.3g} s, and by more than a quarter of a "
        f"turn for {_percent(share)} of the time",
        short=f"tool off by {amount}",
        size=size,
        time=float(time[worst]),
        share=share,
    )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"
