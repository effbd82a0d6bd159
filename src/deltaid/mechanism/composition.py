"""Composition of a described robot's mechanism: drive × parallelogram limb × platform (×
telescope)."""

import casadi as ca
import numpy as np

from deltaid.mechanism.forward import meeting_point
from deltaid.mechanism.growth import LengthGrowth
from deltaid.mechanism.limb import LimbMotion, build_limb, elbow, limb_motion, mode_margin
from deltaid.mechanism.mechanism import ClosedForm, Mechanism, MovingBody
from deltaid.mechanism.platform import PlatformParts, build_platform, build_telescope
from deltaid.mechanism.rotation import Path, fixed
from deltaid.mechanism.speeds import Speed, Speeds
from deltaid.mechanism.user_code import build_own
from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import H4Platform, RigidPlatform

# Range of a drive to either side of home where none is described, and the largest angle for which
# its coordinate keeps the jump at ±180° [rad].
_QUARTER, _CLEAR = np.deg2rad(90.0), np.deg2rad(170.0)


def build_mechanism(robot: RobotDescription, growth: LengthGrowth | None = None) -> Mechanism:
    """The mechanism of a described robot.

    With `growth`, all lengths in q(z) and in the motion of bodies exceed the described ones by its
    symbols; `closure` and `modes` do not include all of them, and `forward` is None.

    Raises:
        DescriptionError: the function of a user-defined mechanism fails.
    """
    if robot.mechanism is not None:
        return build_own(robot, robot.mechanism)
    dof, n = len(robot.drives), len(robot.limb_geometry)
    z, q_symbols = ca.SX.sym("z", dof), ca.SX.sym("q", dof)
    drives, task = Speed.named("qd", dof), Speed.named("zd", dof)
    motion = Path(z, task.u, task.ud)
    described = build_platform(robot, motion)
    middles = [_middle(robot, i, z, point.at) for i, point in enumerate(described.points)]
    platform = build_platform(robot, motion, growth.half) if growth else described
    limbs = _limbs(robot, platform.points, drives, middles, growth)
    bodies = [body for limb in limbs for body in (limb.bodies.driven, limb.bodies.strut)]
    bodies += platform.bodies
    q = ca.vertcat(*[limb.q for limb in limbs])
    closure, modes = _closure(q_symbols, robot.limb_geometry, platform)
    joints = {f"drive{i + 1}": limb.q for i, limb in enumerate(limbs)}
    if platform.joint is not None:
        joints["platform"] = platform.joint
    passive, bar = [limb.swing for limb in limbs], tuple[MovingBody, ...]()
    if robot.telescope is not None:
        higher = growth.telescope if growth else None
        spin = Speed.named("spin", 3)
        bar, length, spin = build_telescope(motion, robot.telescope, spin, higher)
        passive.append(spin)
        q, closure = ca.vertcat(q, z[3]), ca.vertcat(closure, z[3] - q_symbols[3])
        joints |= {"drive4": z[3], "slide": length}
    return Mechanism(
        z=z,
        q=q,
        speeds=Speeds(drives, task, Speed.joined(passive), *_loops(limbs, platform, motion)),
        bodies=(*bodies, *bar),
        limbs=tuple(limb.bodies for limb in limbs),
        platform=platform.bodies,
        telescope=bar,
        joints={name: joints[name] for name in robot.joints},
        reach=ca.vertcat(*[limb.reach for limb in limbs]),
        q_symbols=q_symbols,
        middles=(*middles, *[None] * (dof - n)),
        closure=closure,
        modes=modes,
        hold=_hold(robot, limbs),
        forward=None if growth else _closed_form(robot, (z, q), q_symbols),
        lengths=(1.0, 1.0, 1.0, *([platform.length or 1.0] if dof > 3 else [])),
        period=platform.period,
    )


def _limbs(
    robot: RobotDescription,
    points: tuple[Path, ...],
    drives: Speed,
    middles: list[float | None],
    growth: LengthGrowth | None,
) -> tuple[LimbMotion, ...]:
    return tuple(
        limb_motion(
            points[i],
            limb,
            robot.limb_bodies(i),
            drives[i : i + 1],
            Speed.named("w", 2),
            middles[i] or 0.0,
            growth.limb(i) if growth else None,
        )
        for i, limb in enumerate(robot.limb_geometry)
    )


def _middle(robot: RobotDescription, i: int, z: ca.SX, point: ca.SX) -> float | None:
    """Centre of the continuous range of a rotary drive's angle [rad]; None for a rail.

    Zero if the drive's range keeps away from ±180°, else the middle of this range, by default a
    quarter of a turn to either side of the home pose.
    """
    if robot.is_linear(robot.drives[i]):
        return None
    angle = ca.Function("q", [z], [build_limb(point, robot.limb_geometry[i]).q])
    home, limits = float(angle(robot.home)), robot.limits_of(f"drive{i + 1}")
    low, high = limits.range or (home - _QUARTER, home + _QUARTER)
    return 0.0 if max(-low, high) < _CLEAR or np.isnan(low) else 0.5 * (low + high)


def _loops(
    limbs: tuple[LimbMotion, ...], platform: PlatformParts, z: Path
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """A, B and c of the closed loops; the coordinate of a drive that only turns the tool is ψ."""
    n, dof = len(limbs), z.at.numel()
    A, B, c = ca.SX(dof, dof), ca.SX.eye(dof), ca.SX(dof, 1)
    for i, (limb, point) in enumerate(zip(limbs, platform.points, strict=True)):
        of_point = ca.substitute(point.acceleration, z.acceleration, ca.SX.zeros(dof))
        A[i, :] = ca.sparsify(limb.s.T @ ca.jacobian(point.at, z.at))
        B[i, i], c[i] = limb.gain, limb.bias - ca.dot(limb.s, of_point)
    if dof > n:
        A[n, n] = 1
    return A, B, c


def _closure(
    q: ca.SX, geometry: tuple[LimbGeometry, ...], platform: PlatformParts
) -> tuple[ca.SX, ca.SX]:
    """(|a_i − E_i(q_i)|² − l_i²) / (2 l_i) of each limb [m], and the limbs' mode margins [m]."""
    held = list(zip(ca.vertsplit(q[: len(geometry)]), platform.points, geometry, strict=True))
    closure = [
        (ca.sumsqr(point.at - elbow(q_i, limb)) - limb.strut**2) / (2 * limb.strut)
        for q_i, point, limb in held
    ]
    modes = [mode_margin(q_i, point.at, limb) for q_i, point, limb in held]
    return ca.vertcat(*closure), ca.vertcat(*modes)


def _hold(robot: RobotDescription, limbs: tuple[LimbMotion, ...]) -> ca.SX:
    """Axes n = x_S × y_L (unit vectors, world): a parallelogram prevents rotation about its normal.

    Parts that joints keep parallel share all three rotations. The side bars of an H4 hang on a
    middle bar that turns about z, so each may turn about z independently.
    """
    rows = []
    for i, limb in enumerate(limbs):
        strut = limb.bodies.strut
        n = fixed(strut.R_WL) @ strut.rotation.R[:, 2]
        if isinstance(robot.platform, H4Platform):
            first = robot.platform.on_first(i)
            n = ca.vertcat(n[:2], n[2] if first else 0, 0 if first else n[2])
        rows.append(n.T)
    return ca.vertcat(*rows)


def _closed_form(robot: RobotDescription, task: tuple[ca.SX, ca.SX], q: ca.SX) -> ClosedForm | None:
    """Intersection of three spheres, on the home pose's side of the elbows; None where it does not
    apply."""
    geometry = robot.limb_geometry
    if not isinstance(robot.platform, RigidPlatform) or len(geometry) != 3:
        return None
    sides = [meeting_point(q[:3], geometry, below=below) for below in (True, False)]
    home = robot.home
    at_home = ca.Function("sides", [q], [point for point, _, _ in sides])
    ends = at_home(ca.Function("q", list(task[:1]), list(task[1:]))(home))
    below, above = (np.linalg.norm(np.asarray(end)[:, 0] - home[:3]) for end in ends)
    point, margin, modes = sides[1 if above < below else 0]
    return ClosedForm(ca.vertcat(point, q[3:]), margin, geometry[0].strut, modes)
