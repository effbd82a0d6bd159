"""A drive whose gear gives way: motor with its friction on one side, all bodies on the other.

With θ the motor's coordinate seen from the joint, I its inertia, k and d the gear's stiffness and
damping, and x what the gear carries,

    x = k (θ − q) + d (θ̇ − q̇)
    I θ̈ + f(θ̇, x) + x = τ        M_l q̈ + C q̇ + g + passive joints = x

where M_l has no rotors and f is the drives' friction. Friction at rest is that of one joint alone:
the impulse within its bounds that brings θ̇ nearest to zero.
"""

from functools import lru_cache

import casadi as ca
import numpy as np

from deltaid.dynamics.joint_columns import columns_of_drives, rotor_inertia
from deltaid.dynamics.parameters import Parameters, parameter_layout
from deltaid.dynamics.task_dynamics import FrictionLaws
from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.kinematics import Samples
from deltaid.robot.description import RobotDescription


def link_side(robot: RobotDescription, p: Parameters) -> Parameters:
    """p without the drives' friction and rotors."""
    p = p.copy()
    for k, _, column in columns_of_drives(robot):
        if column.parameter.kind != "spring":
            p[k] = 0.0
    return p


def motor_inertia(robot: RobotDescription, p: Parameters) -> np.ndarray:
    """I of every drive [kg m² or kg]."""
    symbols = ca.SX.sym("p", len(p))
    found = ca.Function("I", [symbols], [rotor_inertia(robot, symbols)])(p)
    return np.asarray(found).ravel()


def motor_speeds(
    robot: RobotDescription,
    p: Parameters,
    speeds: Samples,
    tau: Samples,
    carried: Samples,
    duration: float,
) -> Samples:
    """θ̇ one time step later, under motor torques τ and what gears carry, one state a row."""
    x = np.hstack([speeds, tau, carried]).T
    return _kernel(robot.model_dump_json())(x, uniform=np.append(p, duration)).T


@lru_cache(maxsize=8)
def _kernel(description: str) -> BatchKernel:
    robot = RobotDescription.model_validate_json(description)
    drives, joints = robot.drives, robot.friction_joints
    v, tau, load = (ca.SX.sym(name, len(drives)) for name in ("v", "tau", "x"))
    p, h = ca.SX.sym("p", len(parameter_layout(robot).names)), ca.SX.sym("h")
    at = [v[drives.index(joint)] if joint in drives else ca.SX(0) for joint in joints]
    laws = FrictionLaws(robot, ca.vertcat(*at), load, p)
    smooth, low, high = laws.smooth, -laws.step(1), -laws.step(-1)
    places = [(j, drives.index(joint)) for j, joint in enumerate(joints) if joint in drives]
    inertia, force = rotor_inertia(robot, p), tau - load
    for j, i in places:
        force[i] -= smooth[j]
    end = v + h * force / inertia
    for j, i in places:
        impulse = ca.fmax(h * low[j], ca.fmin(h * high[j], -inertia[i] * end[i]))
        end[i] += impulse / inertia[i]
    return BatchKernel(ca.vertcat(v, tau, load), end, uniform=ca.vertcat(p, h))
