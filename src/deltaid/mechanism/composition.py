"""The mechanism of a described robot: drive × parallelogram limb × platform (× telescope)."""

import casadi as ca
import numpy as np

from deltaid.mechanism.limb import Limb, build_limb, elbow, mode_margin
from deltaid.mechanism.mechanism import ClosedForm, LimbBodies, Mechanism, MovingBody
from deltaid.mechanism.own import build_own
from deltaid.mechanism.platform import PlatformParts, build_platform
from deltaid.mechanism.spheres import meeting_point
from deltaid.mechanism.telescope import build_telescope
from deltaid.mechanism.vectors import unit
from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import H4Platform, RigidPlatform


def build_mechanism(robot: RobotDescription) -> Mechanism:
    """The mechanism of a described robot.

    Raises:
        DescriptionError: the function of a mechanism of the user's own fails.
    """
    if robot.mechanism is not None:
        return build_own(robot, robot.mechanism)
    z = ca.SX.sym("z", len(robot.drives))
    q_symbols = ca.SX.sym("q", len(robot.drives))
    geometry, platform = robot.limb_geometry, build_platform(robot, z)
    limbs = tuple(
        _limb_bodies(robot, i, g, p) for i, (g, p) in enumerate(_held(geometry, platform))
    )
    solved = [build_limb(p, g) for g, p in _held(geometry, platform)]
    bodies = [body for limb in limbs for body in (limb.driven, limb.strut)]
    bodies += [MovingBody(b.name, b.count, np.eye(3), b.R_WB, b.r_WB) for b in platform.bodies]
    q = ca.vertcat(*[limb.q for limb in solved])
    closure, modes = _closure(q_symbols, geometry, platform)
    joints = {f"drive{i + 1}": limb.q for i, limb in enumerate(solved)}
    if platform.joint is not None:
        joints["platform"] = platform.joint
    if robot.telescope is not None:
        psi = z[3]
        bar = build_telescope(z[:3], psi, robot.telescope)
        bodies += [
            MovingBody("TU", 1, np.eye(3), bar.R_WT, bar.r_WTU),
            MovingBody("TL", 1, np.eye(3), bar.R_WT, bar.r_WTL),
            MovingBody("EE", 1, np.eye(3), bar.R_WE, z[:3]),
        ]
        q, closure = ca.vertcat(q, psi), ca.vertcat(closure, psi - q_symbols[3])
        joints |= {"drive4": psi, "slide": bar.length}
    return Mechanism(
        z=z,
        q=q,
        bodies=tuple(bodies),
        limbs=limbs,
        joints={name: joints[name] for name in robot.joints},
        reach=ca.vertcat(*[limb.reach for limb in solved]),
        q_symbols=q_symbols,
        closure=closure,
        modes=modes,
        hold=_hold(robot, limbs),
        forward=_closed_form(robot, (z, q), q_symbols),
        lengths=(1.0, 1.0, 1.0, *([platform.length or 1.0] if len(robot.drives) > 3 else [])),
        period=platform.period,
    )


def _held(
    geometry: tuple[LimbGeometry, ...], platform: PlatformParts
) -> list[tuple[LimbGeometry, ca.SX]]:
    return list(zip(geometry, platform.points, strict=True))


def _limb_bodies(
    robot: RobotDescription, i: int, geometry: LimbGeometry, held: ca.SX
) -> LimbBodies:
    driven, strut = robot.limb_bodies(i)
    limb: Limb = build_limb(held, geometry)
    return LimbBodies(
        driven=MovingBody(driven, 1, limb.R_WL, limb.R_LD, limb.r_LD),
        strut=MovingBody(strut, geometry.struts, limb.R_WL, limb.R_LS, limb.r_LS),
        held=held,
    )


def _closure(
    q: ca.SX, geometry: tuple[LimbGeometry, ...], platform: PlatformParts
) -> tuple[ca.SX, ca.SX]:
    """(|a_i − E_i(q_i)|² − l_i²) / (2 l_i) of each limb [m], and the limbs' mode margins [m]."""
    closure, modes = [], []
    for i, (limb, point) in enumerate(_held(geometry, platform)):
        gap = ca.sumsqr(point - elbow(q[i], limb)) - limb.strut**2
        closure.append(gap / (2 * limb.strut))
        modes.append(mode_margin(q[i], point, limb))
    return ca.vertcat(*closure), ca.vertcat(*modes)


def _hold(robot: RobotDescription, limbs: tuple[LimbBodies, ...]) -> ca.SX:
    """Axes n = x_S × y_L (unit vectors, world): a parallelogram has no rotation about its normal.

    Parts that joints keep parallel share all three rotations. The side bars of an H4 hang on a
    middle bar that turns about z, so each has a rotation about z of its own.
    """
    rows = []
    for i, limb in enumerate(limbs):
        x_S = limb.strut.R_LB[:, 0]
        n = ca.SX(ca.DM(limb.strut.R_WL)) @ unit(ca.cross(x_S, ca.DM([0, 1, 0])))
        if isinstance(robot.platform, H4Platform):
            first = robot.platform.on_first(i)
            n = ca.vertcat(n[:2], n[2] if first else 0, 0 if first else n[2])
        rows.append(n.T)
    return ca.vertcat(*rows)


def _closed_form(robot: RobotDescription, task: tuple[ca.SX, ca.SX], q: ca.SX) -> ClosedForm | None:
    """Three spheres that meet, on the side of the elbows on which the home pose is."""
    geometry = robot.limb_geometry
    if not isinstance(robot.platform, RigidPlatform) or len(geometry) != 3:
        return None
    sides = [meeting_point(q[:3], geometry, below=below) for below in (True, False)]
    home = np.append(robot.workspace.inner_box[0], np.zeros(q.numel() - 3))
    at_home = ca.Function("sides", [q], [point for point, _, _ in sides])
    ends = at_home(ca.Function("q", list(task[:1]), list(task[1:]))(home))
    below, above = (np.linalg.norm(np.asarray(end)[:, 0] - home[:3]) for end in ends)
    point, margin, modes = sides[1 if above < below else 0]
    return ClosedForm(ca.vertcat(point, q[3:]), margin, geometry[0].strut, modes)
