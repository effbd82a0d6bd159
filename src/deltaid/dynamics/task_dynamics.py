"""Equations of motion in task coordinates, solved for acceleration, as CasADi graphs.

With J = ∂q/∂z and the joints' partial velocities R = ∂ϑ/∂z,

    M(z) z̈ + h(z, ż) = Jᵀ τ − Rᵀ f(Rż, load),

where h holds Coriolis forces, gravity and springs, and the load is the torque that gears carry. A
state (z, ż) always closes the loops, so neither forward kinematics nor J⁻¹ is needed. Drive
coordinates follow as q(z), J ż, J z̈ + J̇ ż.

Friction at rest is modelled by impulses of all friction joints over one time step. Over a step of
length h the friction of joint j gives an impulse λ_j of any size within [−h F_j⁺, h F_j⁻]; F⁺ and
F⁻ are its friction while it moves forwards and backwards. With the speeds v⁰ that the joints would
have without friction, and their response A = R M⁻¹ Rᵀ to impulses, the speeds after the step are v
= v⁰ + A λ, and λ is the minimiser of

    ½ λᵀ A λ + λᵀ v⁰   over the box.

Its optimality conditions are Coulomb's law: a joint inside its bounds rests, a joint that moves is
at the bound against its motion (Moreau's and Jean's scheme). A is singular if more joints than
drives have friction; v is still unique.

The algorithm has no branches, so that a vector register evaluates several states at once:
1. Start with the impulses at which all drives rest, moved into the box.
2. A sweep of projected Gauss–Seidel starts or stops joints.
3. Newton steps on the joints inside their bounds, as far as the nearest bound; exact once the set
   of resting joints is correct. One step, and one more for each passive joint with friction.
Steps 2 and 3 lower the objective, so they cannot cycle. Five rounds of both reach rounding if at
most one passive joint has friction, as in all robots of the catalogue. With two such joints one
random state in a thousand keeps an error of some per cent of the impulses of that step.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from deltaid.dynamics.joint_columns import JointMotion, Sign, friction_columns, joint_columns
from deltaid.dynamics.parameters import parameter_layout
from deltaid.dynamics.speed_forces import SpeedForces
from deltaid.levels import ROUNDING
from deltaid.mechanism.mechanism import Mechanism
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction_terms import FrictionTerm


@dataclass(frozen=True)
class TaskDynamics:
    """Symbolic equations of motion of one robot in task coordinates.

    Attributes:
        z, zd, tau, load, p: inputs; p as in `ParameterLayout`.
        q: drive coordinates.
        J, T: ∂q/∂z and ∂z/∂q.
        J_dot_zd: J̇ ż.
        M: task-space mass matrix, rotors included; δ×δ, symmetric.
        h: Coriolis forces, gravity, springs, rotors; δ.
        R: ∂ϑ/∂z of the friction joints, joints × δ.
        smooth: part of each joint's friction that is continuous at rest.
        friction: friction of each joint except load-dependent friction, sign(0) = 0.
        forwards, backwards: size of the friction outside of `smooth` while a joint moves with
            positive and with negative speed; bounds of the friction at rest.
        kinetic, potential: energy [J].
    """

    z: ca.SX
    zd: ca.SX
    tau: ca.SX
    load: ca.SX
    p: ca.SX
    q: ca.SX
    J: ca.SX
    T: ca.SX
    J_dot_zd: ca.SX
    M: ca.SX
    h: ca.SX
    R: ca.SX
    smooth: ca.SX
    friction: ca.SX
    forwards: ca.SX
    backwards: ca.SX
    kinetic: ca.SX
    potential: ca.SX


def build_task_dynamics(robot: RobotDescription, mechanism: Mechanism) -> TaskDynamics:
    """The equations of a robot, derived from its mechanism."""
    forces, speeds = SpeedForces(robot, mechanism), mechanism.speeds
    p, zd, dof = forces.p, speeds.z.u, mechanism.dof
    tau, load = ca.SX.sym("tau", dof), ca.SX.sym("load", dof)
    N, motion, own = speeds.task_to_all, speeds.by_task(), forces.layout.coefficients
    others = [c for c in joint_columns(robot) if c.parameter.kind != "friction"]
    of_joints = forces.joint_columns(others, load) @ p[own.stop - len(others) : own.stop]
    at_rest = ca.SX.zeros(dof)  # z̈ = 0
    h, J_dot_zd = ca.substitute(
        [N.T @ motion(forces.of_bodies() + of_joints), motion(speeds.q.ud)],
        [speeds.z.ud],
        [at_rest],
    )
    M = forces.mass_matrix(N)
    R = ca.vertcat(ca.SX(0, dof), *[forces.joint(j).partial @ N for j in robot.friction_joints])
    laws = FrictionLaws(robot, R @ zd, load, p)
    return TaskDynamics(
        z=mechanism.z,
        zd=zd,
        tau=tau,
        load=load,
        p=p,
        q=mechanism.q,
        J=speeds.jacobian,
        T=speeds.inverse_jacobian,
        J_dot_zd=J_dot_zd,
        M=M,
        h=h,
        R=R,
        smooth=laws.smooth,
        friction=laws.sum(ca.sign, lambda term: not term.of_load),
        forwards=laws.step(1),
        backwards=-laws.step(-1),
        kinetic=0.5 * ca.dot(zd, M @ zd),
        potential=forces.potential(),
    )


@dataclass(frozen=True)
class FrictionLaws:
    """Friction of all joints at speeds v, with the loads of the drives' gears."""

    robot: RobotDescription
    v: ca.SX
    loads: ca.SX
    p: ca.SX

    @property
    def smooth(self) -> ca.SX:
        """The part that is continuous at rest."""
        return self.sum(ca.sign, lambda term: term.continuous)

    def step(self, side: int) -> ca.SX:
        """The discontinuous part while joints move forwards, 1, or backwards, −1."""
        return self.sum(lambda v: ca.SX(side), lambda term: not term.continuous)

    def sum(self, sign: Sign, wanted: Callable[[FrictionTerm], bool]) -> ca.SX:
        """Σ coefficient · h(v) of the selected terms, joint by joint."""
        robot, joints = self.robot, self.robot.friction_joints
        at, total = parameter_layout(robot).friction.start, ca.SX.zeros(len(joints))
        for k, column in enumerate(friction_columns(robot.friction_terms)):
            if wanted(column.term):
                i, is_drive = joints.index(column.joint), column.joint in robot.drives
                load = self.loads[robot.drives.index(column.joint)] if is_drive else ca.SX(0)
                motion = JointMotion(ca.SX(0), self.v[i], ca.SX(0), load, sign)
                total[i] += self.p[at + k] * column.effort(motion)
        return total


def cholesky_solve(A: ca.SX, B: ca.SX) -> ca.SX:
    """A⁻¹ B for a small symmetric positive definite A, by A = L Lᵀ without branches.

    NaN where A is not positive definite.
    """
    n = A.shape[0]
    L, share = ca.SX(n, n), ca.SX(n, 1)
    for j in range(n):
        rest = A[j, j] - ca.sumsqr(L[j, :j])
        share[j] = ca.sqrt(rest) / rest  # 1 / L_jj
        for i in range(j + 1, n):
            L[i, j] = (A[i, j] - ca.dot(L[i, :j], L[j, :j])) * share[j]
    X = ca.densify(B)
    for i in range(n):
        X[i, :] = (X[i, :] - L[i, :i] @ X[:i, :]) * share[i]
    for i in reversed(range(n)):
        X[i, :] = (X[i, :] - L[i + 1 :, i].T @ X[i + 1 :, :]) * share[i]
    return X


# Number of rounds of an unrolled iteration: Newton's method and active sets converge in fewer, and
# the error of carried torques falls with the fifth power of a gear's loss.
ROUNDS = 5


def friction_impulses(A: ca.SX, v: ca.SX, low: ca.SX, high: ca.SX, drives: int) -> ca.SX:
    """The minimiser of ½ λᵀ A λ + λᵀ v over low ≤ λ ≤ high.

    Args:
        A: response of the joints' speeds to impulses, symmetric, positive semidefinite.
        v: speeds without friction.
        low, high: bounds of the impulses, low ≤ 0 ≤ high.
        drives: number of drives; they are the first joints, and their part of A is regular.
    """
    n = v.numel()
    impulse = ca.SX.zeros(n)
    if drives:
        impulse[:drives] = cholesky_solve(A[:drives, :drives], -v[:drives])
    impulse = _into(impulse, low, high)
    for _ in range(ROUNDS):
        impulse = _sweep(A, v, low, high, impulse)
        for _ in range(1 + n - drives):
            impulse = _newton(A, v, low, high, impulse)
    return impulse


def _sweep(A: ca.SX, v: ca.SX, low: ca.SX, high: ca.SX, impulse: ca.SX) -> ca.SX:
    """Sweep of projected Gauss–Seidel: bring one joint after another to rest within its bounds."""
    impulse = ca.SX(impulse)
    for j in range(v.numel()):
        speed = v[j] + A[j, :] @ impulse
        impulse[j] = _into(impulse[j] - speed / A[j, j], low[j], high[j])
    return impulse


def _newton(A: ca.SX, v: ca.SX, low: ca.SX, high: ca.SX, impulse: ca.SX) -> ca.SX:
    """Newton step that brings all joints inside their bounds to rest, up to the nearest bound."""
    n, edge = v.numel(), ROUNDING * (high - low)
    inside = (impulse > low + edge) * (impulse < high - edge)
    free = A * (inside @ inside.T)
    for j in range(n):
        free[j, j] = inside[j] * A[j, j] * (1 + ROUNDING) + (1 - inside[j])
    step = inside * cholesky_solve(free, -inside * (v + A @ impulse))
    share = ca.SX(1)
    for j in range(n):
        room = ca.if_else(step[j] > 0, high[j] - impulse[j], impulse[j] - low[j])
        blocks = ca.fabs(step[j]) > room
        share = ca.fmin(share, ca.if_else(blocks, room / ca.fabs(step[j]), 1))
    return _into(impulse + share * step, low, high)


def _into(x: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    return ca.fmax(low, ca.fmin(high, x))
