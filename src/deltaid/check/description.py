"""Missing friction and limits; reach, limits and holding torque over the workspace."""

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.at_rest import AtRest, Poses
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.limits import torque_limits
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import KinematicsError
from deltaid.model.verdict import Grade, Proposal, Verdict
from deltaid.model.words import listed, percent
from deltaid.robot.description import RobotDescription

# A start for friction that nobody has measured: Coulomb friction as a share of the torque that
# gravity asks for, and the speed [rad/s or m/s] at which viscous friction is as large.
_SHARE, _SPEED = 0.1, {False: 3.0, True: 0.5}
_DEFAULTS = {"platform_speed": "m/s", "platform_acceleration": "m/s²"}
# Poses evaluated, and the share of them that may break a limit at the workspace's edge.
_POINTS, _EDGE = 4096, 0.01


def checked_friction(robot: RobotDescription) -> Iterable[Verdict]:
    """Whether every drive has a friction law."""
    missing = [drive for drive in robot.drives if drive not in robot.friction]
    if not missing:
        seen = f"described of {listed(robot.friction_joints)}"
        yield Verdict("friction-missing", Grade.GOOD, seen)
        return
    laws = ((drive, *law) for drive in missing for law in _law(robot, drive).items())
    changes = tuple((f"friction.{drive}.{key}", value) for drive, key, value in laws)
    yield Verdict(
        "friction-missing",
        Grade.DOUBTFUL,
        f"no friction is described of {listed(missing)}",
        listed(missing),
        "left out of the description; a fit then puts the friction there is into masses and "
        "inertias",
        "describe it; its size is only a start, as the recording decides it",
        (Proposal("robot", changes),),
        number=float(len(missing)),
        unit="drives",
    )


def checked_limits(robot: RobotDescription) -> Iterable[Verdict]:
    """Whether limits are given, and what acts where they are not."""
    defaults = [key for key in _DEFAULTS if key not in robot.model_fields_set]
    limits = robot.drive_limits
    free = [drive for drive in robot.drives if drive not in limits or not limits[drive].effort]
    seen = [
        f"{key} is not given: {getattr(robot, key):g} {_DEFAULTS[key]} acts" for key in defaults
    ]
    if free:
        text = {robot.units(drive).effort for drive in free}
        seen.append(f"no {' or '.join(sorted(text))} limit of {listed(free)}")
    if not seen:
        speed, acceleration = robot.platform_speed, robot.platform_acceleration
        text = f"platform {speed:g} m/s, {acceleration:g} m/s²; effort of all drives"
        yield Verdict("limits-missing", Grade.GOOD, text)
        return
    yield Verdict(
        "limits-missing",
        Grade.DOUBTFUL,
        "; ".join(seen),
        listed(defaults + ["drive_limits"] * bool(free)),
        "left out of the description",
        "give what the machine may do before `deltaid excite` plans a motion: it goes to the "
        "limits that it knows; identification does not depend on them",
        number=float(len(seen)),
        unit="limits",
    )


def _law(robot: RobotDescription, drive: str) -> dict[str, Any]:
    """Friction of a drive of the same kind; else from the gravity torque."""
    kind = robot.is_linear(drive)
    for other in robot.drives:
        same_kind = robot.is_linear(other) == kind and (other == "drive4") == (drive == "drive4")
        if other in robot.friction and (same_kind or robot.platform_turns):
            law = robot.friction[other]
            return {"viscous": law.viscous, "coulomb": law.coulomb}
    dynamics = compiled(robot)
    home, still = dynamics.kinematics.home[None], np.zeros((1, dynamics.dof))
    torque = np.abs(dynamics.torque(home, still, still, prior_parameters(robot))[0]).max()
    coulomb = float(f"{_SHARE * torque:.2g}") or 0.1
    return {"viscous": float(f"{coulomb / _SPEED[kind]:.2g}"), "coulomb": coulomb}


def checked_workspace(description: RobotDescription) -> Iterable[Verdict]:
    """Verdicts on reach, limits of pose and holding torque over the workspace."""
    dynamics = compiled(description)
    try:
        robot = AtRest(dynamics, prior_parameters(dynamics.robot))
    except KinematicsError as error:
        seen = f"the robot cannot stand in the middle of its workspace: {error.what}"
        cause = "workspace, lengths or working mode do not go together"
        key, where, unit = "workspace-cut", "workspace", "share"
        yield Verdict(key, Grade.WRONG, seen, where, cause, error.cure, number=0.0, unit=unit)
        return
    poses = robot(_points(dynamics))
    yield _cut(robot, poses)
    yield from _held(dynamics, poses)


def _points(dynamics: Dynamics) -> Float[np.ndarray, "points dof"]:
    """Poses all over the workspace, the same in every run."""
    rng, space = np.random.default_rng(0), dynamics.robot.workspace
    low, high = space.bounding_box
    inside = np.zeros((0, 3))
    while len(inside) < _POINTS:
        points = rng.uniform(low, high, (_POINTS, 3))
        inside = np.concatenate([inside, points[space.contains(points)]])
    task, turn = dynamics.robot.task, dynamics.robot.turn
    angles = rng.uniform(turn.low, turn.high, (_POINTS, 1 if task.turn is not None else 0))
    return np.hstack([task.of_point(inside[:_POINTS]), angles])


def _cut(robot: AtRest, poses: Poses) -> Verdict:
    """Share of the workspace within reach and pose limits."""
    pose_limits = slice(robot.of_workspace, len(robot.limits) - len(torque_limits(robot.robot)))
    # Without the number of the drive or strut.
    names = [" ".join(re.sub(r"\d", "", name).split()) for name in robot.limits[pose_limits]]
    broken = poses.shares[:, pose_limits] > 1.0  # not so where NaN: not reached
    reached = float(np.mean(poses.stands))
    usable = float(np.mean(poses.stands & ~np.any(broken, axis=1)))
    if 1 - usable <= _EDGE:
        seen = f"{percent(usable)} of it lies within all limits of drives and joints"
        return Verdict("workspace-cut", Grade.GOOD, seen, number=1 - usable, unit="share")
    parts = {
        f"{name} cuts": float(np.mean(np.any(broken[:, [n == name for n in names]], axis=1)))
        for name in dict.fromkeys(names)
    }
    parts["out of reach are"] = 1 - reached
    worst = sorted((name for name in parts if parts[name] > 0), key=lambda name: -parts[name])
    return Verdict(
        "workspace-cut",
        Grade.DOUBTFUL,
        f"{percent(1 - usable)} of the workspace cannot be used: "
        + "; ".join(f"{name} {percent(parts[name])}" for name in worst[:3]),
        "workspace",
        "a workspace that is larger than what the machine can do, or a limit, a zero or a length "
        "that is wrong",
        f"shrink the workspace or widen the limits{_needed(robot, poses)}, and check the lengths",
        number=1 - usable,
        unit="share",
    )


def _needed(robot: AtRest, poses: Poses) -> str:
    """Drive ranges that the workspace needs beyond the limits."""
    texts, described = [], robot.robot
    for drive, q in zip(described.drives, poses.q[poses.stands].T, strict=True):
        limits = described.drive_limits.get(drive)
        if limits is None or limits.range is None or not q.size:
            continue
        if q.min() < limits.range[0] or q.max() > limits.range[1]:
            linear = described.is_linear(drive)
            low, high = (value if linear else np.rad2deg(value) for value in (q.min(), q.max()))
            texts.append(f"{drive} {low:.3g} … {high:.3g}{' m' if linear else '°'}")
    return f" (it needs {', '.join(texts)})" if texts else ""


def _held(dynamics: Dynamics, poses: Poses) -> Iterable[Verdict]:
    """Whether drives can hold the robot, by its prior: gravity and springs against the limits."""
    robot, limits = dynamics.robot, torque_limits(dynamics.robot)
    if not limits or not np.any(poses.stands):
        return
    torque = np.abs(poses.torque[poses.stands])[:, list(limits)]
    largest = np.array(list(limits.values()))
    use = torque.max(axis=0) / largest
    drives = [robot.drives[i] for i in limits]
    k = int(np.argmax(use))
    first, units = drives[k], robot.units(drives[k])
    if use[k] <= 1:
        seen = f"at rest at most {percent(use[k])} of the limit, of {first}"
        yield Verdict("torque-limit", Grade.GOOD, seen, number=float(use[k]), unit="of the limit")
        return
    above = np.any(torque > largest, axis=1)
    weak = [drive for drive, share in zip(drives, use, strict=True) if share > 1]
    yield Verdict(
        "torque-limit",
        Grade.WRONG if np.mean(above) > 0.5 else Grade.DOUBTFUL,
        f"{first} must hold up to {torque[:, k].max():.3g} {units.force} at rest, by the prior, "
        f"and may do {largest[k]:.3g} {units.force}; in {percent(float(np.mean(above)))} of the "
        "workspace the robot would sink",
        listed(weak),
        f"a {units.effort} limit of the motor's side of the gear or in another unit, or masses "
        "that are too large",
        f"give {units.effort} in drive_limits in {units.force} at the joint; check the masses",
        number=float(use[k]),
        unit="of the limit",
    )
