"""Forces of bodies and joints on the generalised speeds u of a mechanism.

A force Q on u has the power Qᵀu; on y it is Nᵀ Q with N = ∂u/∂ẏ (`mechanism.speeds`). A body with
the velocity (V u, W u) contributes Vᵀ force + Wᵀ moment (Jourdain's principle), a joint its effort
along ∂ϑ/∂y.

All of a robot's dynamics comes from `wrench`, Newton's and Euler's laws of one rigid body. It is
linear in the body's ten parameters and, for given ω, in accelerations. So the same function gives
the forces of a motion, and with partial velocities, their rates or −g in place of accelerations,
the mass matrix, the Coriolis matrix and gravity.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.dynamics.joint_columns import JointColumn, JointMotion, Sign, joint_columns
from deltaid.dynamics.parameters import ParameterLayout, parameter_layout
from deltaid.mechanism.mechanism import Mechanism, MovingBody
from deltaid.mechanism.rotation import Path, along, fixed, skew
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class Wrench:
    """Force and moment that a body's motion needs, one column for each acceleration.

    Attributes:
        push: m a, in the body's inertial frame L [N].
        swing: force due to rotation, in the link frame B [N].
        moment: about the origin of B, in B [N m].
    """

    push: ca.SX
    swing: ca.SX
    moment: ca.SX


def wrench(
    R: ca.SX, p: ca.SX, a: ca.SX, alpha: ca.SX, w: ca.SX, spin: ca.SX | None = None
) -> Wrench:
    """Force and moment about the origin of a link frame B,

        push   = m a,   swing = ω̇ × mc + ω × (ω × mc),
        moment = mc × Rᵀa + Θ ω̇ + ω × Θ ω.

    With `spin` in place of the second ω, both are bilinear in ω and `spin`, and partial velocities
    and their rates give the Coriolis matrix of Christoffel symbols: with Σ = ½ tr(Θ) − Θ,

        swing  = ω̇ × mc + ω × (spin × mc),   moment = mc × Rᵀa + Θ ω̇ + Σω × spin.

    Args:
        R: from B to L.
        p: the body's ten parameters.
        a: acceleration of the origin less gravity, in L; 3 × n.
        alpha: ω̇ in B; 3 × n.
        w: ω in B.
        spin: 3 × n.
    """
    mc, W = p[1:4], skew(w)
    Theta = ca.vertcat(
        ca.horzcat(p[4], p[7], p[9]), ca.horzcat(p[7], p[5], p[8]), ca.horzcat(p[9], p[8], p[6])
    )
    second = w if spin is None else spin
    swing = -skew(mc) @ alpha - W @ (skew(mc) @ second)
    moment = skew(mc) @ (R.T @ a) + Theta @ alpha - skew(Theta @ w) @ second
    if spin is not None:
        moment += 0.5 * ca.trace(Theta) * (W @ spin)
    return Wrench(p[0] * a, swing, moment)


class SpeedForces:
    """Forces on the speeds u of a robot, as functions of z, u, u̇ and p.

    Args:
        gravity: in the world; that of the description if None.

    Attributes:
        p: symbols of the parameters.
    """

    def __init__(
        self, robot: RobotDescription, mechanism: Mechanism, gravity: ca.SX | None = None
    ) -> None:
        self.robot, self.mechanism, self._gravity = robot, mechanism, gravity
        self.layout: ParameterLayout = parameter_layout(robot)
        self.p = ca.SX.sym("p", len(self.layout.parameters))
        self._u = mechanism.speeds.u

    def gravity(self, body: MovingBody) -> ca.SX:
        """Gravity in the inertial frame of a body."""
        if self._gravity is None:
            return fixed(body.R_WL.T @ np.array(self.robot.gravity))
        return fixed(body.R_WL.T) @ self._gravity

    def wrench(self, body: MovingBody) -> Wrench:
        """Wrench that joints exert on one of `body.count` bodies along the motion."""
        turned = body.rotation
        a = body.origin.acceleration - self.gravity(body)
        return wrench(turned.R, self._inertia_of(body), a, turned.alpha, turned.w)

    def body_columns(self) -> ca.SX:
        """Columns of Y on u of all bodies' parameters, identical bodies summed."""
        columns = {name: ca.SX(self._u.numel(), 10) for name in self.layout.bodies}
        for body in self.mechanism.bodies:
            forces = body.count * self.on_speeds(body, self.wrench(body))
            columns[body.name] += ca.jacobian(forces, self._inertia_of(body))
        return ca.horzcat(*columns.values())

    def of_bodies(self) -> ca.SX:
        """Inertia and gravity along the motion, without rotors."""
        return self._sum(self.wrench)

    def mass_matrix(self, N: ca.SX) -> ca.SX:
        """M on y with u = N ẏ, including rotors; one triangle is computed and mirrored."""
        M = self._sum(self._mass)
        for k, column in self._coefficients():
            if column.inertia:
                row = self.joint(column.joint).partial
                M += self.p[k] * column.inertia * row.T @ row
        M = ca.tril2symm(ca.tril(M))
        return ca.tril2symm(ca.tril(N.T @ (M @ N)))

    def coriolis(self, rates: Sequence[tuple[ca.SX, ca.SX]], spins: Sequence[ca.SX]) -> ca.SX:
        """Columns C with forces C ẏ, from Christoffel symbols.

        Rotors contribute none, because ∂q/∂q is constant.

        Args:
            rates: for each body the rates of its partial velocities, ∂v/∂ẏ in L and ∂ω/∂ẏ in B.
            spins: for each body ∂ω/∂ẏ.
        """
        C = ca.SX(self._u.numel(), spins[0].shape[1])
        for body, (V, W), spin in zip(self.mechanism.bodies, rates, spins, strict=True):
            turned = body.rotation
            forces = wrench(turned.R, self._inertia_of(body), V, W, turned.w, spin)
            C += body.count * self.on_speeds(body, forces)
        return C

    def at_rest(self) -> ca.SX:
        """Forces of gravity and springs on u."""
        g = self._sum(self._weight)
        for k, column in self._coefficients():
            joint, x = self.joint(column.joint), ca.SX.sym("x")
            slope = ca.substitute(ca.gradient(column.potential(x), x), x, joint.path.at)
            g += self.p[k] * slope * joint.partial.T
        return g

    def potential(self) -> ca.SX:
        """Energy −gᵀ (m r + R mc) in gravity, and that in springs [J]."""
        V = ca.SX(0)
        for body in self.mechanism.bodies:
            p = self._inertia_of(body)
            moment = p[0] * body.origin.at + body.rotation.R @ p[1:4]
            V += body.count * -ca.dot(self.gravity(body), moment)
        for k, column in self._coefficients():
            V += self.p[k] * column.potential(self.mechanism.joints[column.joint])
        return V

    def joint_columns(
        self, columns: Sequence[JointColumn], loads: ca.SX, sign: Sign = ca.sign
    ) -> ca.SX:
        """Columns of joints, each with its effort along its joint.

        Args:
            loads: torques that the drives' gears carry.
        """
        efforts, drives = [ca.SX(self._u.numel(), 0)], self.robot.drives
        for column in columns:
            joint, drive = self.joint(column.joint), column.joint
            load = loads[drives.index(drive)] if drive in drives else ca.SX(0)
            efforts.append(column.effort(joint.motion(load, sign)) * joint.partial.T)
        return ca.horzcat(*efforts)

    def effort(self, name: str) -> ca.SX:
        """Torque or force of a passive joint's friction and spring."""
        motion, total = self.joint(name).motion(ca.SX(0)), ca.SX(0)
        for k, column in self._coefficients():
            if column.joint == name:
                total += self.p[k] * column.effort(motion)
        return total

    def joint(self, name: str) -> "Joint":
        """Motion of a joint and its partial speeds."""
        speeds, at = self.mechanism.speeds, self.mechanism.joints[name]
        if name in self.robot.drives:
            i = self.robot.drives.index(name)
            path = Path(at, speeds.q.u[i], speeds.q.ud[i])
        else:
            path = along(at, Path(self.mechanism.z, speeds.z.u, speeds.z.ud))
        return Joint(path, ca.jacobian(path.rate, self._u))

    def _coefficients(self) -> Iterator[tuple[int, JointColumn]]:
        return enumerate(joint_columns(self.robot), start=self.layout.coefficients.start)

    def _inertia_of(self, body: MovingBody) -> ca.SX:
        return self.p[self.layout.body(body.name)]

    def _mass(self, body: MovingBody) -> Wrench:
        V, W = self._partials(body)
        return wrench(body.rotation.R, self._inertia_of(body), V, W, ca.SX(3, 1))

    def _weight(self, body: MovingBody) -> Wrench:
        still = ca.SX(3, 1)
        return wrench(body.rotation.R, self._inertia_of(body), -self.gravity(body), still, still)

    def _partials(self, body: MovingBody) -> tuple[ca.SX, ca.SX]:
        """∂v/∂u in L and ∂ω/∂u in B."""
        return ca.jacobian(body.origin.rate, self._u), ca.jacobian(body.rotation.w, self._u)

    def on_speeds(self, body: MovingBody, wrenches: Wrench) -> ca.SX:
        """A body's wrenches as forces on u, one column for each wrench."""
        V, W = self._partials(body)
        turned = body.rotation.R.T @ V
        return V.T @ wrenches.push + turned.T @ wrenches.swing + W.T @ wrenches.moment

    def _sum(self, of: Callable[[MovingBody], Wrench]) -> ca.SX:
        parts = [body.count * self.on_speeds(body, of(body)) for body in self.mechanism.bodies]
        return sum(parts[1:], parts[0])


@dataclass(frozen=True)
class Joint:
    """A joint's coordinate ϑ along the motion and ∂ϑ̇/∂u, a row."""

    path: Path
    partial: ca.SX

    def motion(self, load: ca.SX, sign: Sign = ca.sign) -> JointMotion:
        """The joint's motion with the load of its drive's gear."""
        path = self.path
        return JointMotion(path.at, path.rate, path.acceleration, load, sign)
