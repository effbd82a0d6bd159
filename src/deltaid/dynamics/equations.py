"""Equations of motion (1)–(7) of a robot as CasADi graphs, in drive coordinates.

Inputs are the task coordinates z and the drive velocities and accelerations q̇, q̈, so forward
kinematics is never differentiated. Forces on the mechanism's generalised speeds u become drive
torques by Nᵀ, N = ∂u/∂q̇ (`dynamics.speed_forces`).
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Int

from deltaid.dynamics.joint_columns import Sign, carried, joint_columns, with_load_friction
from deltaid.dynamics.parameters import prior_parameters
from deltaid.dynamics.speed_forces import SpeedForces
from deltaid.levels import ROUNDING
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.rotation import skew
from deltaid.mechanism.speeds import Along
from deltaid.robot.description import RobotDescription

# Number of generic states in which entries are tested for zero.
_GENERIC = 64


@dataclass(frozen=True)
class Equations:
    """Symbolic equations of motion of one robot.

    Attributes:
        z, qd, qdd: inputs, δ each.
        load: torques that the drives' gears carry, δ; input of load-dependent friction in Y.
        p: the parameters [bodies · 10, friction terms, springs, rotor inertias].
        J, T: ∂q/∂z and ∂z/∂q, δ×δ.
        Y: the full regressor, τ = Y p, δ × len(p), structurally sparse.
        torque: τ(z, q̇, q̈, p).
        carried: the load of this torque, τ without the motors' own friction and rotors.
        M, C, g, f: the terms of (1) in drive coordinates; C from Christoffel symbols; f without
            the friction that depends on load.
    """

    z: ca.SX
    qd: ca.SX
    qdd: ca.SX
    load: ca.SX
    p: ca.SX
    J: ca.SX
    T: ca.SX
    Y: ca.SX
    torque: ca.SX
    carried: ca.SX
    M: ca.SX
    C: ca.SX
    g: ca.SX
    f: ca.SX


def build_equations(robot: RobotDescription, mechanism: Mechanism) -> Equations:
    """Derive the equations of motion of a mechanism."""
    forces, speeds = SpeedForces(robot, mechanism), mechanism.speeds
    N, motion, p = speeds.drives_to_all, speeds.by_drives(), forces.p
    load, layout = ca.SX.sym("load", mechanism.dof), forces.layout
    joints, qd, qdd = joint_columns(robot), speeds.q.u, speeds.q.ud
    Y = N.T @ motion(ca.horzcat(forces.body_columns(), forces.joint_columns(joints, load)))
    alone = motion(forces.joint_columns(joints, ca.SX.zeros(mechanism.dof)))
    of_joints, at = N.T @ alone, layout.coefficients
    torque = N.T @ motion(forces.of_bodies()) + of_joints @ p[at]
    f = of_joints[:, : layout.friction.stop - at.start] @ p[layout.friction]
    return Equations(
        z=mechanism.z,
        qd=qd,
        qdd=qdd,
        load=load,
        p=p,
        J=speeds.jacobian,
        T=speeds.inverse_jacobian,
        Y=Y,
        torque=with_load_friction(robot, torque, qd, qdd, p),
        carried=carried(robot, torque, qd, qdd, p),
        M=forces.mass_matrix(N),
        C=_coriolis(forces, motion, N),
        g=N.T @ forces.at_rest(),
        f=f,
    )


def _coriolis(forces: SpeedForces, motion: Along, N: ca.SX) -> ca.SX:
    """C of (1) from Christoffel symbols.

    Accelerations at q̈ = 0 are quadratic in q̇. For the origin of a body, half their slope ∂a/∂q̇ is
    the rate of the partial velocities ∂v/∂q̇. For its angular acceleration half the slope falls
    short of the rate of ∂ω/∂q̇ by ½ ω × ∂ω/∂q̇, because ω is no derivative of coordinates.
    """
    speeds, bodies = forces.mechanism.speeds, forces.mechanism.bodies
    accelerations = [ca.vertcat(body.origin.acceleration, body.rotation.alpha) for body in bodies]
    slopes = 0.5 * ca.jacobian(motion(ca.vertcat(*accelerations)), speeds.q.u)
    rates, spins = [], []
    for k, body in enumerate(bodies):
        spin = ca.jacobian(body.rotation.w, speeds.u) @ N
        turned = slopes[6 * k + 3 : 6 * k + 6, :] - 0.5 * skew(body.rotation.w) @ spin
        rates.append((slopes[6 * k : 6 * k + 3, :], turned))
        spins.append(spin)
    return N.T @ motion(forces.coriolis(rates, spins))


@dataclass(frozen=True)
class TaskMotion:
    """Regressor along a motion in task coordinates.

    Attributes:
        z, zd, zdd: inputs, δ each.
        q, qd, qdd: drive motion, functions of the inputs.
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
    """The regressor as a function of z, ż, z̈; `sign` may be a smooth substitute for optimisation.

    Load-dependent friction uses the torques that gears carry with the prior parameters.
    """
    forces, speeds = SpeedForces(robot, mechanism), mechanism.speeds
    motion, N, load = speeds.by_task(), speeds.drives_to_all, ca.SX.sym("load", mechanism.dof)
    columns = forces.joint_columns(joint_columns(robot), load, sign)
    Y = N.T @ motion(ca.horzcat(forces.body_columns(), columns))
    task = (mechanism.z, speeds.z.u, speeds.z.ud)
    drive = (mechanism.q, motion(speeds.q.u), motion(speeds.q.ud))
    if robot.load_drives:
        prior = ca.SX(prior_parameters(robot))
        unloaded = ca.substitute(Y, load, ca.SX.zeros(mechanism.dof)) @ prior
        Y = ca.substitute(Y, load, carried(robot, unloaded, *drive[1:], prior))
    return TaskMotion(*task, *drive, Y, mechanism.condition)


def beyond_rounding(
    kinematics: Kinematics, inputs: ca.SX, entries: ca.SX
) -> Int[np.ndarray, " entries"]:
    """Entries that are nonzero beyond rounding, in generic states.

    Args:
        kinematics: of the robot.
        inputs: z and all other inputs of the entries.
        entries: a dense column.
    """
    robot, rng, dof = kinematics.robot, np.random.default_rng(0), kinematics.dof
    half = robot.within(0.0, 0.5 * (robot.turn.high - robot.turn.low))[1]
    z = kinematics.home + 0.5 * half * rng.uniform(-1, 1, (_GENERIC, dof))
    others = rng.standard_normal((_GENERIC, inputs.numel() - dof))
    values = ca.Function("entries", [inputs], [entries])(np.hstack([z, others]).T)
    largest = np.nanmax(np.abs(np.array(values)), axis=1, initial=0.0)  # poses out of reach are NaN
    return np.flatnonzero(~(largest <= ROUNDING * largest.max(initial=0.0)))
