"""Checks of a description: units of lengths, missing friction and limits, reach, holding torque.

Units of lengths are judged from the plain data of the file: most robots in millimetres are larger
than any description may be, so loading their file fails.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import WRONG_SCALE
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.limits import AtRest, Poses, kind_of_limit, torque_limits
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.windings import SOFTEST, UNITS_OF_STIFFNESS
from deltaid.errors import KinematicsError
from deltaid.model.verdict import Fault, Grade, Proposal, Verdict, listed, percent
from deltaid.recording.proposed_mapping import MOST_METRES
from deltaid.robot.description import GRAVITY, RobotDescription
from deltaid.robot.friction import Friction

# Start values of unmeasured friction: Coulomb friction as a share of the gravity torque, and the
# speed [rad/s or m/s] at which viscous friction equals it.
_SHARE, _SPEED = 0.1, {False: 3.0, True: 0.5}
_DEFAULTS = {"platform_speed": "m/s", "platform_acceleration": "m/s²"}
# Poses evaluated, and the share of them that may violate a limit at the workspace's edge.
_POINTS, _EDGE = 4096, 0.01
_FRICTION = Fault(
    "friction",
    "drives",
    "missing from the description; a fit then puts that friction into masses and inertias",
    "describe it; its size is only a start, as the recording decides it",
)
_LIMITS = Fault(
    "limits",
    "limits",
    "missing from the description",
    "give what the machine may do before `deltaid excite` plans a motion: it goes to the limits "
    "that it knows; identification does not depend on them",
)
_CUT = Fault(
    "workspace",
    "share",
    "a workspace that is larger than what the machine can do, or a limit, a zero or a length that "
    "is wrong",
)
_HOLDS = Fault("torque-limit", "of the limit")
_STUCK = Fault("friction-scale", "of the limit", "friction in another unit or of the motor's side")
_GEARS = Fault("gear-stiffness", "of the range", "a stiffness in another unit")
# Least length of arm and strut together [m]: the smallest Deltas have some 20 mm.
_DWARF = 0.005
# Largest ratio of a limb's length to another length of the robot.
_SMALL = 250.0
# Least number that is a length in millimetres: no part of a robot is shorter.
_MILLIMETRE = 1.0
_METRES = Fault("length-unit", "m")
# Sizes of a gravity that is given in g, not in m/s²: no place on a planet or moon has them.
_IN_G = (0.9, 1.1)

# Keys of lengths, by part of the description.
_LIMBS = (
    "base_radius", "platform_radius", "base_points", "platform_points", "upper_arm", "strut",
    "strut_spacing",
)  # fmt: skip
_OTHERS = {
    "platform": ("half_length", "length", "tool"),
    "telescope": ("base_joint", "platform_joint", "stroke"),
    "workspace": ("radius", "x", "y", "z", "top"),
}
_SHAPE = ("length", "outer_radius", "inner_radius", "centre")

Length = tuple[str, float]  # path and number


def checked_lengths(data: dict[str, Any]) -> Verdict:
    """The verdict on all lengths of a description.

    Limbs too long for any robot are in millimetres, too short ones were divided by 1000 once too
    often. Their corrected size is the scale for all lengths: limbs one by one, other parts as a
    whole.
    """
    limbs, groups = _lengths(data.get("limbs"), _LIMBS, "limbs"), list(_groups(data))
    arms = [length for length in limbs if length[0].startswith("limbs.upper_arm")]
    struts = [length for length in limbs if length[0].partition("[")[0] == "limbs.strut"]
    # A user's own mechanism has no limbs.
    space = _lengths(data.get("workspace"), _OTHERS["workspace"], "workspace")
    size = _longest(arms) + _longest(struts) or _longest(space)
    small, large = size < _DWARF, size > MOST_METRES
    factor, unit = (1e3, "divided by 1000 once too often") if small else (1e-3, "in millimetres")
    size *= factor if small or large else 1.0
    least = 0.0 if small or large else _MILLIMETRE  # limbs in metres: most numbers are
    groups = [group for group in groups if _longest(group) > 0] + [[length] for length in limbs]
    low, high = (size / _SMALL, np.inf) if small else (0.0, WRONG_SCALE * size)
    wrong = [
        length for group in groups if not low <= _longest(group) <= high
        for length in group if abs(length[1]) >= least
    ]  # fmt: skip
    if not wrong:
        return _METRES.good(f"limbs of {size:.3g} m; all lengths go with it", size)
    path, value = max(wrong, key=lambda length: abs(length[1]))
    others = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
    changes = tuple((place, float(f"{value * factor:.12g}")) for place, value in wrong if value)
    return _METRES.judged(
        f"{path} is {value:g} m{others}, where limbs of about {size:.3g} m are likely",
        path.partition(".")[0],
        abs(value),
        grade=Grade.WRONG,
        cause=f"lengths {unit}; those of a description are in metres",
        cure=f"multiply these lengths by {factor:g}",
        proposals=(Proposal("robot", changes),),
    )


def checked_gravity(robot: RobotDescription) -> Iterator[Verdict]:
    """A verdict on gravity that is given in g."""
    if _IN_G[0] < (size := float(np.linalg.norm(robot.gravity))) < _IN_G[1]:
        gravity = [float(f"{GRAVITY * g:.12g}") for g in robot.gravity]
        yield Verdict(
            "gravity",
            Grade.WRONG,
            f"gravity is {size:.3g} m/s², and {GRAVITY} m/s² on Earth",
            cause="it is given in g; that of a description is in m/s²",
            cure=f"multiply it by {GRAVITY}",
            proposals=(Proposal("robot", (("gravity", gravity),)),),
            number=size,
            unit="m/s²",
        )


def _longest(group: Iterable[Length]) -> float:
    return max((abs(value) for _, value in group), default=0.0)


def _groups(data: dict[str, Any]) -> Iterator[list[Length]]:
    """Lengths of all parts except limbs, a list for each part."""
    for part, keys in _OTHERS.items():
        yield _lengths(data.get(part), keys, part)
    for name, body in _mapping(data.get("bodies")).items():
        prior = _mapping(body).get("prior")
        for k, shape in enumerate(prior if isinstance(prior, list | tuple) else ()):
            yield _lengths(shape, _SHAPE, f"bodies.{name}.prior[{k}]")
    for drive, limits in _mapping(data.get("drive_limits")).items():
        yield _lengths(limits, ("position",), f"drive_limits.{drive}")


def _lengths(part: Any, keys: tuple[str, ...], path: str) -> list[Length]:
    return [length for key in keys for length in _numbers(_mapping(part).get(key), f"{path}.{key}")]


def _mapping(part: Any) -> dict[str, Any]:
    """A part of an unchecked description as a mapping; empty if it is none."""
    return part if isinstance(part, dict) else {}


def _numbers(value: object, path: str) -> Iterator[Length]:
    if isinstance(value, list | tuple):
        for k, entry in enumerate(value):
            yield from _numbers(entry, f"{path}[{k}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, float(value)


def checked_friction(robot: RobotDescription) -> Verdict:
    """Verdict on drives without a friction law."""
    missing = [drive for drive in robot.drives if drive not in robot.friction]
    if not missing:
        return _FRICTION.good(f"described of {listed(robot.friction_joints)}")
    changes = tuple(
        (f"friction.{drive}.{key}", value)
        for drive in missing
        for key, value in _law(robot, drive).items()
    )
    return _FRICTION.judged(
        f"no friction is described of {listed(missing)}",
        listed(missing),
        float(len(missing)),
        proposals=(Proposal("robot", changes),),
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


def _law(robot: RobotDescription, drive: str) -> dict[str, float]:
    """Friction of a drive of the same kind; otherwise from the gravity torque."""
    slides = robot.is_linear(drive)
    for other in robot.drives:
        same_kind = robot.is_linear(other) == slides and (other == "drive4") == (drive == "drive4")
        if other in robot.friction and (same_kind or robot.platform_turns):
            law = robot.friction[other]
            return {"viscous": law.viscous, "coulomb": law.coulomb}
    dynamics = compiled(robot)
    home, still = dynamics.kinematics.home[None], np.zeros((1, dynamics.dof))
    torque = np.abs(dynamics.torque(home, still, still, prior_parameters(robot))[0]).max()
    coulomb = float(f"{_SHARE * torque:.2g}") or 0.1
    return {"viscous": float(f"{coulomb / _SPEED[slides]:.2g}"), "coulomb": coulomb}


def checked_limits(robot: RobotDescription) -> Verdict:
    """Verdict on missing limits, and on defaults that apply instead."""
    defaults, limits = [k for k in _DEFAULTS if k not in robot.model_fields_set], robot.drive_limits
    seen = [f"{k} is not given: {getattr(robot, k):g} {_DEFAULTS[k]} acts" for k in defaults]
    free = [drive for drive in robot.drives if drive not in limits or not limits[drive].effort]
    if free:
        efforts = {robot.units(drive).effort for drive in free}
        seen.append(f"no {' or '.join(sorted(efforts))} limit of {listed(free)}")
    if not seen:
        return _LIMITS.good(
            f"platform {robot.platform_speed:g} m/s, {robot.platform_acceleration:g} m/s²; effort "
            "of all drives"
        )
    subject = listed(defaults + ["drive_limits"] * bool(free))
    return _LIMITS.judged("; ".join(seen), subject, float(len(seen)))


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
            yield held
            if held.grade is Grade.GOOD:  # else the limit is too low
                yield from _stuck(description, limits)
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
        cure=f"shrink the workspace or widen the limits{needed}, and check the lengths",
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
