"""A mechanism as the rest of the package sees it: symbolic poses, drives, joints, reach.

Everything is a CasADi SX expression of the task coordinates z = [r; ψ] (r the platform point in
the world; ψ only with a telescope). Velocities, accelerations, Jacobians and all of the dynamics
follow by automatic differentiation, so nothing here is ever differentiated by hand.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.mechanism import delta
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class MovingBody:
    """One moving rigid body: whose inertia parameters it has, how many of it, and where it is.

    Attributes:
        name: the body of the description whose ten parameters it carries.
        count: how many bodies share this very pose (2 for the struts of a parallelogram).
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
class Mechanism:
    """The kinematics of one robot, symbolic.

    Attributes:
        z: task coordinates, δ symbols.
        q: drive coordinates as functions of z (inverse kinematics).
        bodies: all moving bodies.
        joints: friction joints' coordinates ϑ(z) by name, drives first.
        reach: for each limb, the distance in metres by which z is inside its reach, functions of z.
        q_symbols: δ symbols for the drive coordinates in `forward`.
        forward: z as a function of `q_symbols` (forward kinematics in closed form).
        forward_margin: squared length that is negative when no platform pose closes the loops at q.
        forward_elbows: for each limb, a distance in metres that is negative when its elbow points
            inwards at q; all else here has the elbows outwards.
    """

    z: ca.SX
    q: ca.SX
    bodies: tuple[MovingBody, ...]
    joints: dict[str, ca.SX]
    reach: ca.SX
    q_symbols: ca.SX
    forward: ca.SX
    forward_margin: ca.SX
    forward_elbows: ca.SX

    @property
    def dof(self) -> int:
        """Number of drives δ."""
        return self.z.numel()


def build_mechanism(robot: RobotDescription) -> Mechanism:
    """The mechanism of a described robot."""
    n_limbs = len(robot.limbs.azimuth_deg)
    dof = len(robot.drives)
    z = ca.SX.sym("z", dof)
    r = z[:3]
    limbs = [delta.limb(r, azimuth, robot.limbs) for azimuth in robot.limbs.azimuth_deg]
    bodies = [
        body
        for limb in limbs
        for body in (
            MovingBody("U", 1, limb.R_WL, limb.R_LU, limb.r_LU),
            MovingBody("S", robot.limbs.struts_per_limb, limb.R_WL, limb.R_LS, limb.r_LS),
        )
    ]
    bodies.append(MovingBody("P", 1, np.eye(3), ca.SX.eye(3), r))
    q = ca.vertcat(*[limb.q for limb in limbs])
    joints = {f"drive{i + 1}": limbs[i].q for i in range(n_limbs)}
    q_symbols = ca.SX.sym("q", dof)
    forward, margin, elbows = delta.forward_kinematics(q_symbols[:n_limbs], robot.limbs)
    if robot.telescope is not None:
        psi = z[3]
        bar = delta.telescope(r, psi, robot.telescope)
        bodies += [
            MovingBody("TU", 1, np.eye(3), bar.R_WT, bar.r_WTU),
            MovingBody("TL", 1, np.eye(3), bar.R_WT, bar.r_WTL),
            MovingBody("EE", 1, np.eye(3), bar.R_WE, r),
        ]
        q = ca.vertcat(q, psi)
        joints |= {"drive4": psi, "slide": bar.length}
        forward = ca.vertcat(forward, q_symbols[3])
    reach = ca.vertcat(*[limb.reach for limb in limbs])
    return Mechanism(z, q, tuple(bodies), joints, reach, q_symbols, forward, margin, elbows)
