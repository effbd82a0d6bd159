"""A mechanism as the rest of the package sees it: symbolic poses, drives, joints, reach.

Everything is a CasADi SX expression of the task coordinates z = [r; ψ] (r the platform point in
the world; ψ the tool's angle, where a telescope or a platform turns it). Velocities, accelerations,
Jacobians and all of the dynamics follow by automatic differentiation, so nothing here is ever
differentiated by hand.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.mechanism.limb import Limb, build_limb, elbow, mode_margin
from deltaid.mechanism.platform import PlatformParts, build_platform
from deltaid.mechanism.spheres import meeting_point
from deltaid.mechanism.telescope import build_telescope
from deltaid.mechanism.vectors import inverse
from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import RigidPlatform


@dataclass(frozen=True)
class MovingBody:
    """One moving rigid body: whose inertia parameters it has, how many of it, and where it is.

    Attributes:
        name: the body of the description whose ten parameters it carries.
        count: how many bodies share this very motion (2 for the struts of a parallelogram).
        R_WL: constant rotation from an inertial frame L to the world W. A limb's poses are
            simplest in a frame turned with the limb; its origin is the world's.
        R_LB: rotation from link frame B to L, 3×3, function of z.
        r_LB: origin of the link frame, resolved in L, 3, function of z [m].
    """

    name: str
    count: int
    R_WL: Float[np.ndarray, "3 3"]
    R_LB: ca.SX
    r_LB: ca.SX


@dataclass(frozen=True)
class LimbBodies:
    """One limb's bodies: the driven one (upper arm or carriage), the strut, and what it holds.

    Attributes:
        driven, strut: their poses.
        held: the middle of the strut joints at the platform, in the world [m].
    """

    driven: MovingBody
    strut: MovingBody
    held: ca.SX


@dataclass(frozen=True)
class ClosedForm:
    """Forward kinematics written out.

    Attributes:
        z: task coordinates as functions of the drive coordinates.
        margin: strut² less the square of the strut length that would just close the loops [m²].
        strut: that strut's length [m].
        modes: for each limb a distance in metres that is negative in the other working mode.
    """

    z: ca.SX
    margin: ca.SX
    strut: float
    modes: ca.SX


@dataclass(frozen=True)
class Mechanism:
    """The kinematics of one robot, symbolic.

    Attributes:
        z: task coordinates, δ symbols.
        q: drive coordinates as functions of z (inverse kinematics).
        bodies: all moving bodies.
        limbs: those of each limb, and what it holds.
        joints: friction joints' coordinates ϑ(z) by name, drives first.
        reach: for each limb, the distance in metres by which z is inside its reach, functions of z.
        q_symbols: δ symbols for the drive coordinates in what follows.
        closure: δ functions of z and `q_symbols` that are zero when the loops are closed [m, rad].
        modes: for each limb a distance in metres, function of z and `q_symbols`, that is negative
            when the limb is not in its described working mode.
        forward: forward kinematics in closed form; None where only iteration finds it.
        lengths: for each task coordinate what it moves the platform's parts by: 1 for r, for the ψ
            of a platform [m/rad] how far its parts move, 1 for the ψ of a telescope.
        period: turn of ψ [rad] that the drives do not show; None where they show every turn.
    """

    z: ca.SX
    q: ca.SX
    bodies: tuple[MovingBody, ...]
    limbs: tuple[LimbBodies, ...]
    joints: dict[str, ca.SX]
    reach: ca.SX
    q_symbols: ca.SX
    closure: ca.SX
    modes: ca.SX
    forward: ClosedForm | None
    lengths: tuple[float, ...]
    period: float | None = None

    @property
    def dof(self) -> int:
        """Number of drives δ."""
        return self.z.numel()

    @property
    def scaled_jacobian(self) -> ca.SX:
        """J = ∂q/∂z with ψ counted by the length that it moves a platform's part."""
        return ca.jacobian(self.q, self.z) @ ca.diag(1 / ca.DM(self.lengths))

    @property
    def condition(self) -> ca.SX:
        """‖J‖_F ‖J⁻¹‖_F / δ of the scaled Jacobian."""
        J = self.scaled_jacobian
        return ca.sqrt(ca.sumsqr(J) * ca.sumsqr(inverse(J))) / self.dof


def build_mechanism(robot: RobotDescription) -> Mechanism:
    """The mechanism of a described robot."""
    z = ca.SX.sym("z", len(robot.drives))
    q_symbols = ca.SX.sym("q", len(robot.drives))
    geometry, platform = robot.limbs.geometry(), build_platform(robot, z)
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


def _closed_form(robot: RobotDescription, task: tuple[ca.SX, ca.SX], q: ca.SX) -> ClosedForm | None:
    """Three spheres that meet, on the side of the elbows on which the home pose is."""
    geometry = robot.limbs.geometry()
    if not isinstance(robot.platform, RigidPlatform) or len(geometry) != 3:
        return None
    sides = [meeting_point(q[:3], geometry, below=below) for below in (True, False)]
    home = np.append(robot.workspace.inner_box[0], np.zeros(q.numel() - 3))
    at_home = ca.Function("sides", [q], [point for point, _, _ in sides])
    ends = at_home(ca.Function("q", list(task[:1]), list(task[1:]))(home))
    below, above = (np.linalg.norm(np.asarray(end)[:, 0] - home[:3]) for end in ends)
    point, margin, modes = sides[1 if above < below else 0]
    return ClosedForm(ca.vertcat(point, q[3:]), margin, geometry[0].strut, modes)
