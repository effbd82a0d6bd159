"""Friction that depends on load: a gear loses a share of what it carries.

With the torque x that the gear of a drive carries on its link's side, that is the drive's torque
without its motor's own friction and rotor,

    τ = x + f(q̇) + I_r q̈ + μ sign(q̇) |x|,    x = M_l q̈ + C q̇ + g + what passive joints take.

So inverse dynamics has τ by one line more. Forward dynamics knows τ and not x: losses ℓ = μ
sign(q̇) |x| slow the drives down by G ℓ, G = M⁻¹, of which the rotors feel I_r G ℓ, so that

    x = x⁰ − (1 − I_r G) ℓ

with x⁰ for no losses. With |μ| < 1 there is exactly one solution, because (1 ± μ) M_l + I_r is
positive definite whatever the signs.
"""

from collections.abc import Iterator

import casadi as ca

from deltaid.dynamics.joint_columns import JointColumn, JointMotion, joint_columns
from deltaid.robot.description import RobotDescription

# Newton steps on the signs of the loads: exact once these are right. They are those without losses
# but where next to nothing is carried.
_ROUNDS = 4


def with_load_friction(
    robot: RobotDescription, torque: ca.SX, speed: ca.SX, acceleration: ca.SX, p: ca.SX
) -> ca.SX:
    """τ of a motion, from the torque without the friction that depends on load.

    Args:
        torque: everything else.
        speed: q̇, or the direction in which friction acts.
        acceleration: q̈.
        p: the parameters.
    """
    total, x = ca.SX(torque), carried(robot, torque, speed, acceleration, p)
    for i, share in load_shares(robot, speed, p):
        total[i] += share * ca.fabs(x[i])
    return total


def carried(
    robot: RobotDescription, torque: ca.SX, speed: ca.SX, acceleration: ca.SX, p: ca.SX
) -> ca.SX:
    """x: torques without the drives' own friction and rotors; `torque` has no friction by load."""
    x, none = ca.SX(torque), ca.SX(0)
    for k, i, column in columns_of_drives(robot):
        if column.parameter.kind != "spring" and column.parameter.symbol != "load":
            x[i] -= p[k] * column.effort(JointMotion(none, speed[i], acceleration[i], none))
    return x


def rotor_inertia(robot: RobotDescription, p: ca.SX) -> ca.SX:
    """I_r of every drive."""
    inertia = ca.SX.zeros(len(robot.drives))
    for k, i, column in columns_of_drives(robot):
        inertia[i] += column.inertia * p[k]
    return inertia


def load_shares(robot: RobotDescription, speed: ca.SX, p: ca.SX) -> Iterator[tuple[int, ca.SX]]:
    """Drives whose friction depends on load, with μ sign(q̇) of each."""
    for k, i, column in columns_of_drives(robot):
        if column.parameter.symbol == "load":
            yield i, p[k] * ca.sign(speed[i])


def losses(robot: RobotDescription, x: ca.SX, response: ca.SX, speed: ca.SX, p: ca.SX) -> ca.SX:
    """ℓ of the drives in `RobotDescription.load_drives`, for forward dynamics.

    Args:
        x: x⁰ of all drives.
        response: G, accelerations of all drives for torques at those.
        speed: q̇.
        p: the parameters.
    """
    pairs, inertia = list(load_shares(robot, speed, p)), rotor_inertia(robot, p)
    at, share = [i for i, _ in pairs], ca.vertcat(*(share for _, share in pairs))
    felt = ca.SX.eye(len(at)) - ca.diag(inertia[at]) @ response[at, :]
    start = found = x[at]
    for _ in range(_ROUNDS):
        # No ca.sign: an export may put a smooth stand-in where the sign of a speed is meant.
        side = 1 - 2 * (found < 0)
        found = ca.inv_minor(ca.SX.eye(len(at)) + felt @ ca.diag(share * side)) @ start
    return share * ca.fabs(found)


def columns_of_drives(robot: RobotDescription) -> Iterator[tuple[int, int, JointColumn]]:
    """Coefficients along drives: place in p, number of the drive, column."""
    first = 10 * len(robot.body_names)
    for k, column in enumerate(joint_columns(robot), start=first):
        if column.joint in robot.drives:
            yield k, robot.drives.index(column.joint), column
