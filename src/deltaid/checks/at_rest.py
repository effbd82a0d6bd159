"""Checks of a robot at rest in its workspace: reach, limits, and what gravity, friction and gears
ask of its motors."""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.limits import AtRest, Poses, kind_of_limit, torque_limits
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.windings import SOFTEST, UNITS_OF_STIFFNESS
from deltaid.errors import KinematicsError
from deltaid.model.verdict import Fault, Grade, Verdict, graded, listed, percent
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction

# Poses evaluated, and the share of them that may violate a limit, as those at the workspace's edge
# do; where no larger share keeps all limits, the description is wrong.
_POINTS, _EDGE = 4096, 0.01
_CUT = Fault(
    "workspace",
    "share",
    "a workspace that is larger than what the machine can do, or a limit, a zero, a length or a "
    "working mode that is wrong",
)
_HOLDS = Fault("torque-limit", "of the limit")
# Time in which no motor reaches its top speed: that of the current loops of fast drives [s].
_AT_ONCE = 1e-3
_STUCK = Fault("friction-scale", "of the limit", "friction in another unit or of the motor's side")
_GEARS = Fault("gear-stiffness", "of the range", "a stiffness in another unit")


def checked_workspace(description: RobotDescription) -> Iterable[Verdict]:
    """Verdicts on reach, limits of a pose and holding torque over the workspace."""
    dynamics = compiled(description)
    try:
        robot = AtRest(dynamics, prior_parameters(dynamics.robot))
    except KinematicsError as error:
        yield _CUT.judged(
            f"the robot cannot stand in the middle of its workspace: {error.what}",
            "workspace",
            0.0,
            grade=Grade.WRONG,
            cause="workspace, lengths or working mode do not go together",
            cure=error.cure,
        )
        return
    poses = robot(_points(description))
    yield _cut(robot, poses)
    limits = torque_limits(description)
    if np.any(poses.stands):
        if limits:
            held = _held(description, poses, limits)
            if held.grade is Grade.GOOD:
                yield _too_large(robot, limits) or held
                yield from _stuck(description, limits)
            else:  # the limit is too low
                yield held
        yield from _wound_up(description, poses, limits)


def _points(robot: RobotDescription) -> Float[np.ndarray, "points dof"]:
    rng, (low, high) = np.random.default_rng(0), robot.workspace.bounding_box
    inside = np.zeros((0, 3))
    while len(inside) < _POINTS:
        points = rng.uniform(low, high, (_POINTS, 3))
        inside = np.concatenate([inside, points[robot.workspace.contains(points)]])
    turns = robot.task.turn is not None
    angles = rng.uniform(robot.turn.low, robot.turn.high, (_POINTS, int(turns)))
    return np.hstack([robot.task.of_point(inside[:_POINTS]), angles])


def _cut(robot: AtRest, poses: Poses) -> Verdict:
    pose_limits = slice(robot.of_workspace, len(robot.limits) - len(torque_limits(robot.robot)))
    names = [kind_of_limit(name) for name in robot.limits[pose_limits]]
    broken = poses.shares[:, pose_limits] > 1.0  # not so where NaN: not reached
    lost = 1 - float(np.mean(poses.stands & ~np.any(broken, axis=1)))
    if lost <= _EDGE:
        seen = f"{percent(1 - lost)} of it lies within all limits of drives and joints"
        return _CUT.good(seen, lost)
    parts = {
        f"{name} cuts": float(np.mean(np.any(broken[:, [n == name for n in names]], axis=1)))
        for name in dict.fromkeys(names)
    }
    parts["out of reach are"] = 1 - float(np.mean(poses.stands))
    worst = sorted((name for name in parts if parts[name] > 0), key=lambda name: -parts[name])
    cuts = "; ".join(f"{name} {percent(parts[name])}" for name in worst[:3])
    needed = _needed(robot.robot, poses)
    return _CUT.judged(
        f"{percent(lost)} of the workspace cannot be used: {cuts}",
        "workspace",
        lost,
        grade=graded(lost, _EDGE, 1 - _EDGE),
        cure=f"shrink the workspace or widen the limits{needed}; check lengths and working_mode",
    )


def _needed(robot: RobotDescription, poses: Poses) -> str:
    texts = list[str]()
    for drive, q in zip(robot.drives, poses.q[poses.stands].T, strict=True):
        limits = robot.limits_of(drive)
        if limits.range is None or not q.size:
            continue
        if q.min() < limits.range[0] or q.max() > limits.range[1]:
            scale, unit = (1.0, " m") if robot.is_linear(drive) else (np.rad2deg(1.0), "°")
            texts.append(f"{drive} {scale * q.min():.3g} … {scale * q.max():.3g}{unit}")
    return f" (it needs {', '.join(texts)})" if texts else ""


def _held(robot: RobotDescription, poses: Poses, limits: dict[int, float]) -> Verdict:
    drives, largest = [robot.drives[i] for i in limits], np.array(list(limits.values()))
    torque = np.abs(poses.torque[poses.stands])[:, list(limits)]
    use = torque.max(axis=0) / largest
    k = int(np.argmax(use))
    first, units, number = drives[k], robot.units(drives[k]), float(use[k])
    if number <= 1:
        return _HOLDS.good(f"at rest at most {percent(number)} of the limit, of {first}", number)
    sinking = float(np.mean(np.any(torque > largest, axis=1)))
    return _HOLDS.judged(
        f"{first} must hold up to {torque[:, k].max():.3g} {units.force} at rest, by the prior, "
        f"and may do {largest[k]:.3g} {units.force}; in {percent(sinking)} of the workspace the "
        "robot would sink",
        listed([drive for drive, share in zip(drives, use, strict=True) if share > 1]),
        number,
        grade=Grade.WRONG if sinking > 0.5 else Grade.DOUBTFUL,
        cause=f"a {units.effort} limit of the motor's side of the gear or in another unit, or "
        "masses that are too large",
        cure=f"give {units.effort} in drive_limits in {units.force} at the joint; check the masses",
    )


def _too_large(robot: AtRest, limits: dict[int, float]) -> Verdict | None:
    """A verdict on a limit by which a drive would reach its top speed at once; None without."""
    dynamics, described = robot.dynamics, robot.robot
    M = dynamics.mass_matrix(dynamics.kinematics.inverse(described.home), robot.p)
    speeds = {i: described.limits_of(described.drives[i]).top_speed or np.inf for i in limits}
    times = {i: speeds[i] * float(M[i, i]) / limits[i] for i in limits}
    if not (fast := [i for i in limits if times[i] < _AT_ONCE]):
        return None
    i = min(fast, key=lambda i: times[i])
    units = described.units(described.drives[i])
    return _HOLDS.judged(
        f"{described.drives[i]} may do {limits[i]:.3g} {units.force}, by which the prior reaches "
        f"the top speed of {speeds[i]:.3g} {units.coordinate}/s in {1e3 * times[i]:.2g} ms; no "
        "motor does",
        listed([described.drives[i] for i in fast]),
        cause=f"a {units.effort} limit in another unit, or masses that are too small",
        cure=f"give {units.effort} in drive_limits in {units.force} at the joint; check the masses",
    )


def _starting(law: Friction) -> float:
    """Friction that a drive must overcome to start [N m or N]."""
    near_rest = (law.stribeck, law.hess_soom)
    coulomb = min(law.coulomb, law.coulomb if law.both_ways else law.coulomb_back or 0.0)
    return coulomb + sum(term.coefficient for term in near_rest if term is not None)


def _stuck(robot: RobotDescription, limits: dict[int, float]) -> Iterator[Verdict]:
    """A verdict on friction that no motor overcomes."""
    laws = {i: robot.friction.get(robot.drives[i]) for i in limits}
    use = {i: _starting(law) / limits[i] for i, law in laws.items() if law is not None}
    if stuck := [i for i in use if use[i] > 1]:
        i = max(stuck, key=lambda i: use[i])
        units = robot.units(robot.drives[i])
        yield _STUCK.judged(
            f"friction of {robot.drives[i]} is {use[i] * limits[i]:.3g} {units.force} at rest, and "
            f"the drive may do {limits[i]:.3g} {units.force}: it could not start",
            listed([robot.drives[k] for k in stuck]),
            use[i],
            grade=Grade.WRONG,
            cure=f"give friction in {units.force} at the joint; check the {units.effort} limit",
        )


def _wound_up(robot: RobotDescription, poses: Poses, limits: dict[int, float]) -> Iterator[Verdict]:
    """A verdict on gears that would wind up by a large part of their drives' ranges."""
    largest = np.abs(poses.torque[poses.stands]).max(axis=0)
    largest[list(limits)] = np.maximum(largest[list(limits)], list(limits.values()))
    stiffness = np.array([robot.stiffness(drive) for drive in robot.drives])
    windup, moves = largest / stiffness, np.ptp(poses.q[poses.stands], axis=0)
    soft = np.flatnonzero(windup > SOFTEST * moves)
    if soft.size:
        i = max(soft, key=lambda i: windup[i] / moves[i])
        drive, units = robot.drives[i], robot.units(robot.drives[i])
        yield _GEARS.judged(
            f"gear_stiffness of {drive} is {stiffness[i]:.3g} {units.stiffness}: "
            f"{largest[i]:.3g} {units.force} would wind the gear up by {windup[i]:.3g} "
            f"{units.coordinate}, and the drive moves by {moves[i]:.3g} {units.coordinate}",
            listed([robot.drives[k] for k in soft]),
            float(windup[i] / moves[i]),
            grade=Grade.WRONG,
            cure=UNITS_OF_STIFFNESS[robot.is_linear(drive)],
        )
