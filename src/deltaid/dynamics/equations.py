"""The equations of motion (1)–(7) of a whole robot as CasADi graphs, from its mechanism alone.

Inputs are the task coordinates z and the drive velocities and accelerations q̇, q̈. With J = ∂q/∂z
and T = J⁻¹, ż = T q̇ and z̈ = T (q̈ − J̇ ż), so forward kinematics is never differentiated. Forces
along z become drive torques by Tᵀ.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.dynamics.joint_columns import (
    JointColumn,
    JointMotion,
    Sign,
    joint_columns,
    with_load_friction,
)
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.dynamics.rigid_body import body_mass_matrix, body_motion, body_regressor
from deltaid.mechanism.mechanism import Mechanism, MovingBody
from deltaid.mechanism.vectors import inverse
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class Equations:
    """Symbolic equations of motion of one robot.

    Attributes:
        z, qd, qdd: inputs, δ each.
        tau: drive torques, δ; Y depends on them only through friction terms that depend on load.
        p: the parameters [bodies · 10, friction terms, springs, rotor inertias].
        J: ∂q/∂z, δ×δ.
        zd, zdd: task velocity and acceleration as functions of the inputs.
        Y: the full regressor, τ = Y p, δ × len(p), structurally sparse.
        torque: τ(z, q̇, q̈, p), solved for τ where friction depends on it.
        M, C, g, f: the terms of (1) in drive coordinates; C from Christoffel symbols; f without
            the friction that depends on load.
    """

    z: ca.SX
    qd: ca.SX
    qdd: ca.SX
    tau: ca.SX
    p: ca.SX
    J: ca.SX
    zd: ca.SX
    zdd: ca.SX
    Y: ca.SX
    torque: ca.SX
    M: ca.SX
    C: ca.SX
    g: ca.SX
    f: ca.SX


def build_equations(robot: RobotDescription, mechanism: Mechanism) -> Equations:
    """Derive the equations of motion of a mechanism by automatic differentiation."""
    z, dof = mechanism.z, mechanism.dof
    qd, qdd = ca.SX.sym("qd", dof), ca.SX.sym("qdd", dof)
    tau = ca.SX.sym("tau", dof)
    layout = parameter_layout(robot)
    p = ca.SX.sym("p", len(layout.names))
    J = ca.jacobian(mechanism.q, z)
    T = inverse(J)
    zd = T @ qd
    J_dot = _directional(J, z, zd)
    zdd = T @ (qdd - J_dot @ zd)
    Y = _regressor(robot, mechanism, T, (z, zd, zdd), (qd, qdd), tau)
    M, C, g = _terms(robot, mechanism, T, J_dot, (z, zd), p)
    without_load = ca.substitute(Y, tau, ca.SX.zeros(dof)) if robot.load_drives else Y
    torque = without_load @ p
    torque = with_load_friction(robot, torque, qd, p)
    f = without_load[:, layout.friction] @ p[layout.friction]
    return Equations(z, qd, qdd, tau, p, J, zd, zdd, Y, torque, M, C, g, f)


@dataclass(frozen=True)
class TaskMotion:
    """The regressor along a motion that is given in task coordinates.

    Attributes:
        z, zd, zdd: inputs, δ each.
        q, qd, qdd: drive motion as functions of the inputs.
        Y: the full regressor, τ = Y p.
        condition: of J, see `Mechanism.condition`.
    """

    z: ca.SX
    zd: ca.SX
    zdd: ca.SX
    q: ca.SX
    qd: ca.SX
    qdd: ca.SX
    Y: ca.SX
    condition: ca.SX


def build_task_motion(
    robot: RobotDescription, mechanism: Mechanism, sign: Sign = ca.sign
) -> TaskMotion:
    """The regressor as a function of z, ż, z̈; `sign` may be a smooth stand-in for optimisation.

    Friction that depends on load sees the torques at the prior.
    """
    z, dof = mechanism.z, mechanism.dof
    zd, zdd = ca.SX.sym("zd", dof), ca.SX.sym("zdd", dof)
    J = ca.jacobian(mechanism.q, z)
    T = inverse(J)
    qd = J @ zd
    qdd = J @ zdd + _directional(J, z, zd) @ zd
    tau = ca.SX.sym("tau", dof)
    Y = _regressor(robot, mechanism, T, (z, zd, zdd), (qd, qdd), tau, sign)
    if robot.load_drives:
        at_prior = ca.substitute(Y, tau, ca.SX.zeros(dof)) @ prior_parameters(robot)
        Y = ca.substitute(Y, tau, at_prior)
    return TaskMotion(z, zd, zdd, mechanism.q, qd, qdd, Y, mechanism.condition)


def _regressor(
    robot: RobotDescription,
    mechanism: Mechanism,
    T: ca.SX,
    task: tuple[ca.SX, ca.SX, ca.SX],
    drive: tuple[ca.SX, ca.SX],
    tau: ca.SX,
    sign: Sign = ca.sign,
) -> ca.SX:
    """Y of (2)–(7): ten columns a body (identical limbs summed), friction, rotor inertias."""
    z, zd, zdd = task
    qd, qdd = drive
    gravity = np.array(robot.gravity)
    columns = {name: ca.SX(mechanism.dof, 10) for name in robot.body_names}
    # Differentiated with ż and z̈ as symbols of their own: they depend on z through T.
    v, a = ca.SX.sym("v", mechanism.dof), ca.SX.sym("a", mechanism.dof)
    for body in mechanism.bodies:
        columns[body.name] += body.count * body_regressor(body_motion(body, z, v, a, gravity))
    inertial = ca.substitute([ca.horzcat(*columns.values())], [v, a], [zd, zdd])[0]
    forces = generalised_forces(robot, mechanism, T, (qd, qdd, tau), joint_columns(robot), sign)
    return ca.horzcat(T.T @ inertial, forces)


def generalised_forces(
    robot: RobotDescription,
    mechanism: Mechanism,
    T: ca.SX,
    drive: tuple[ca.SX, ca.SX, ca.SX],
    columns: Sequence[JointColumn],
    sign: Sign = ca.sign,
) -> ca.SX:
    """One column of Y for each of `columns`: its effort along ∂ϑ/∂q; `drive` is q̇, q̈, τ."""
    qd, qdd, tau = drive
    found = [ca.SX(mechanism.dof, 0)]
    for column in columns:
        velocity, partial = joint_motion(mechanism, column.joint, T, qd)
        position = mechanism.joints[column.joint]
        is_drive = column.joint in robot.drives
        i = robot.drives.index(column.joint) if is_drive else 0
        own = (qdd[i], tau[i]) if is_drive else (ca.SX(0), ca.SX(0))
        found.append(column.effort(JointMotion(position, velocity, *own, sign)) * partial)
    return ca.horzcat(*found)


def joint_motion(mechanism: Mechanism, joint: str, T: ca.SX, qd: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Velocity ϑ̇ of a friction joint and its partial derivatives ∂ϑ̇/∂q̇ (a column)."""
    names = list(mechanism.joints)
    if joint in names[: mechanism.dof]:  # a drive: ϑ = q_i, exactly
        partial = ca.SX(ca.DM.eye(mechanism.dof)[:, names.index(joint)])
    else:
        partial = (ca.jacobian(mechanism.joints[joint], mechanism.z) @ T).T
    return ca.dot(partial, qd), partial


def _terms(
    robot: RobotDescription,
    mechanism: Mechanism,
    T: ca.SX,
    J_dot: ca.SX,
    task: tuple[ca.SX, ca.SX],
    p: ca.SX,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """M, C and g in drive coordinates, from kinetic and potential energy.

    In task coordinates C_z follows from the Christoffel symbols of M_z,
    C_z = ½ (Ṁ_z + A − Aᵀ) with A = ∂(M_z ż)/∂z at constant ż; then M = Tᵀ M_z T and
    C = Tᵀ (C_z T + M_z Ṫ) with Ṫ = −T J̇ T, the Christoffel form in q.
    """
    z, zd = task
    v = ca.SX.sym("v", mechanism.dof)
    still = ca.SX(mechanism.dof, 1)
    gravity = np.array(robot.gravity)
    M_z, V = ca.SX(mechanism.dof, mechanism.dof), ca.SX(0)
    for body in mechanism.bodies:
        p_b = _parameters_of(robot, body, p)
        motion = body_motion(body, z, still, still, gravity)
        M_z += body.count * body_mass_matrix(p_b, motion)
        first_moment = p_b[0] * body.r_LB + body.R_LB @ p_b[1:4]
        V -= body.count * ca.dot(ca.DM(body.R_WL.T @ gravity), first_moment)
    coefficients = p[parameter_layout(robot).coefficients]
    for k, column in enumerate(joint_columns(robot)):
        V += coefficients[k] * column.potential(mechanism.joints[column.joint])
    A = ca.jacobian(M_z @ v, z)
    C_z = 0.5 * (_directional(M_z, z, v) + A - A.T)
    C_z = ca.substitute([C_z], [v], [zd])[0]
    C = T.T @ (C_z @ T - M_z @ T @ J_dot @ T)
    M = T.T @ M_z @ T
    for k, column in enumerate(joint_columns(robot)):
        if column.inertia:
            _, partial = joint_motion(mechanism, column.joint, T, T @ zd)
            M += coefficients[k] * column.inertia * partial @ partial.T
    return M, C, T.T @ ca.jacobian(V, z).T


def _parameters_of(robot: RobotDescription, body: MovingBody, p: ca.SX) -> ca.SX:
    start = 10 * robot.body_names.index(body.name)
    return p[start : start + 10]


def _directional(A: ca.SX, z: ca.SX, zd: ca.SX) -> ca.SX:
    """dA/dt = Σ ∂A/∂z_i ż_i of a matrix."""
    return ca.reshape(ca.jtimes(ca.vec(A), z, zd), A.shape[0], A.shape[1])
