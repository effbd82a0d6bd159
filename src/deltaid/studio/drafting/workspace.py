"""Largest workspace of a robot with given lengths: a cylinder within its reach."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.limits import AtRest, torque_limits
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DeltaidError, KinematicsError
from deltaid.robot.description import RobotDescription
from deltaid.robot.limits import Cylinder
from deltaid.studio.drafting.questions import LINEAR

# Ratio of the cylinder's height to its radius; largest and smallest radius, as shares of the
# struts' length; ratio of consecutive radii; directions and levels of checked points; largest use
# of limits.
_TALL, _LARGEST, _SMALLEST, _STEP, _AROUND, _LEVELS, _SHARE = 0.7, 0.8, 0.03, 0.94, 24, 5, 0.97
# Growth of the cylinder's height per step, as a share of the struts' length.
_GROWN = 0.05
# Shifts of the cylinder's middle from the first guess, as shares of the struts' length.
_SHIFTS = (0.0, 0.05, -0.05, 0.1, -0.1, 0.15, -0.15, 0.2, -0.2, 0.25, 0.3)
# Angles of the arms below horizontal that are tried [deg]; factor by which struts must exceed the
# horizontal distance of their joints.
_ANGLES, _SPARE = (30.0, 45.0, 60.0, 75.0), 1.02
_LENGTHS = ("--arm", "--strut", "--base-radius", "--platform-radius")


def height(kind: str, a: Mapping[str, float]) -> float:
    """Distance of the platform below the base with arms 30° down, or carriages halfway [m].

    Raises:
        DeltaidError: the struts are too short to reach the platform from there, or the rails meet.
    """
    if kind in LINEAR:
        tilt, along = np.deg2rad(a["tilt"]), 0.5 * (a["rail_low"] + a["rail_high"])
        out, down = a["base_radius"] + along * np.sin(tilt), along * np.cos(tilt)
        where, ends = "with the carriages halfway", a["base_radius"] + a["rail_high"] * np.sin(tilt)
        if ends <= 0:
            raise DeltaidError(
                f"the rails lean inwards by {-a['tilt']:g}° and meet before their lower ends",
                where="--tilt",
                cure=f"--tilt {-a['tilt']:g} if they lean outwards; else a smaller --rail-high",
            )
    else:
        angle = _angle(a)
        out, down = a["base_radius"] + a["arm"] * np.cos(angle), a["arm"] * np.sin(angle)
        where = f"with the arms {np.rad2deg(angle):.3g}° down"
    wide = abs(out - a.get("platform_radius", 0.0))
    if a["strut"] <= _SPARE * wide:
        raise DeltaidError(
            f"a strut of {1e3 * a['strut']:.4g} mm cannot reach the platform: {where} its joints "
            f"are {1e3 * wide:.4g} mm apart sideways alone",
            where="--strut",
            cure="a longer strut, a shorter arm, a smaller base or a larger platform"
            if kind not in LINEAR
            else "a longer strut, a smaller base or a larger platform; --tilt is negative if the "
            "rails lean inwards",
        )
    return float(down + np.sqrt(a["strut"] ** 2 - wide**2))


def _angle(a: Mapping[str, float]) -> float:
    """30° below horizontal, or more if struts are too short for that [rad]."""
    tried = [float(np.deg2rad(np.clip(x, a["angle_low"], a["angle_high"]))) for x in _ANGLES]
    inner = a.get("platform_radius", 0.0)
    fits = (
        angle
        for angle in tried
        if a["strut"] > _SPARE * abs(a["base_radius"] + a["arm"] * np.cos(angle) - inner)
    )
    return next(fits, tried[0])


def find_space(robot: RobotDescription, middle: float, strut: float) -> Cylinder:
    """The widest cylinder about height −`middle` within the robot's reach and its limits at rest.

    Raises:
        DeltaidError: there is none.
    """
    try:
        at_rest = AtRest(compiled(robot), prior_parameters(robot))
    except KinematicsError as error:
        raise DeltaidError(
            f"the robot cannot stand {1e3 * middle:.4g} mm below its base, where its workspace "
            f"should be: {error.what}",
            where="--strut",
            cure=_cure(robot),
        ) from None
    radius = _LARGEST * strut
    while radius > _SMALLEST * strut:
        for shift in _SHIFTS:
            space = _cylinder(-middle - shift * strut, radius)
            if space.z[1] < 0 and _holds(at_rest, space):
                return _rounded(_taller(at_rest, space, _GROWN * strut))
        radius *= _STEP
    raise DeltaidError(
        "no place was found where the robot stands well: everywhere near the middle "
        f"{_worst(at_rest, _cylinder(-middle, _SMALLEST * strut))}",
        where="the lengths",
        cure=_cure(robot),
    )


def _cylinder(middle: float, radius: float) -> Cylinder:
    low = middle - 0.5 * _TALL * radius
    return Cylinder(shape="cylinder", radius=radius, z=(low, low + _TALL * radius))


def _taller(at_rest: AtRest, space: Cylinder, step: float) -> Cylinder:
    """The highest cylinder of the same radius: rails reach farther than arms."""
    for down, up in ((step, 0.0), (0.0, step)):
        grown = space
        while grown.z[1] < 0 and _holds(at_rest, grown):
            space, grown = grown, grown.changed(z=(grown.z[0] - down, grown.z[1] + up))
    return space


def _cure(robot: RobotDescription) -> str:
    linear = robot.is_linear("drive1")
    lengths = ", ".join(_LENGTHS[1 if linear else 0 :])
    ends = "--rail-low and --rail-high" if linear else "--angle-low and --angle-high"
    return (
        f"check the lengths ({lengths}), the ends {ends}, and --swing; most machines have a base "
        "wider than the platform" + ("" if linear else ", and arms of a third to a half of a strut")
    )


def _rounded(space: Cylinder) -> Cylinder:
    """The cylinder rounded inwards to millimetres, or finer if it is small."""
    unit = 10.0 ** min(-3, np.floor(np.log10(space.radius)) - 2)
    radius, low, high = (
        round(float(inwards(value / unit) * unit), round(-np.log10(unit)))
        for inwards, value in (
            (np.floor, space.radius),
            (np.ceil, space.z[0]),
            (np.floor, space.z[1]),
        )
    )
    return space.changed(radius=radius, z=(low, high))


def _pose_limits(at_rest: AtRest) -> list[int]:
    """Indices of limits of the pose, without those of workspace, torque and the tool's range."""
    last = len(at_rest.limits) - len(torque_limits(at_rest.robot))
    return [i for i in range(at_rest.of_workspace, last) if at_rest.limits[i] != "tool angle"]


def _holds(at_rest: AtRest, space: Cylinder) -> bool:
    """Whether the robot reaches the whole cylinder within its limits of pose."""
    poses = at_rest(_points(at_rest, space))
    return bool(poses.stands.all() and (poses.shares[:, _pose_limits(at_rest)] <= _SHARE).all())


def _worst(at_rest: AtRest, space: Cylinder) -> str:
    poses = at_rest(_points(at_rest, space))
    if not poses.stands.all():
        return at_rest.why_not(poses.z[int(np.argmin(poses.stands))])
    limits = _pose_limits(at_rest)
    shares = poses.shares[:, limits].max(axis=0)
    return f"the limit “{at_rest.limits[limits[int(shares.argmax())]]}” is at {shares.max():.0%}"


def _points(at_rest: AtRest, space: Cylinder) -> Float[np.ndarray, "samples dof"]:
    """Points on the cylinder's axis, on its rim and halfway, with extreme and middle tool
    angles."""
    angles = np.arange(_AROUND) * 2 * np.pi / _AROUND
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    flat = np.concatenate([np.zeros((1, 2)), 0.5 * circle, circle]) * space.radius
    levels = np.linspace(*space.z, _LEVELS)
    points = np.array([[*xy, z] for xy in flat for z in levels])
    if at_rest.robot.task.turn is None:
        return points
    turn = at_rest.robot.turn
    turned = (turn.low, 0.5 * (turn.low + turn.high), turn.high)
    ends = turned if at_rest.robot.platform_turns else (0.0,)
    return np.concatenate([np.insert(points, 3, psi, axis=1) for psi in ends])
