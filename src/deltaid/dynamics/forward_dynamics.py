"""Forward dynamics in batches: acceleration, a time step with friction, energy, and motors behind
elastic gears.

Such a gear has the motor with the drive's friction on one side and all bodies on the other. With
θ the motor's coordinate in units of the joint, I its inertia, k and d the gear's stiffness and
damping, and x the torque that the gear carries,

    x = k (θ − q) + d (θ̇ − q̇)
    I θ̈ + f(θ̇, x) + x = τ        M_l q̈ + C q̇ + g + passive joints = x

where M_l has no rotors and f is the drives' friction. Friction of a motor at rest is the impulse
within its bounds that brings θ̇ nearest to zero.
"""

from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import WithParameters
from deltaid.dynamics.joint_columns import carried, columns_of_drives, losses, rotor_inertia
from deltaid.dynamics.parameters import Parameters, parameter_layout
from deltaid.dynamics.task_dynamics import (
    ROUNDS,
    FrictionLaws,
    TaskDynamics,
    build_task_dynamics,
    cholesky_solve,
    friction_impulses,
)
from deltaid.kernel.batch import RowKernel, row_kernel
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.one_or_many import one_or_many
from deltaid.robot.description import RobotDescription
from deltaid.shown import Plotted


class ForwardDynamics(WithParameters, Plotted):
    """Forward dynamics of a described robot. Arrays have one sample a row; kernels compile on first
    use.

    States are task coordinates and velocities (z, ż), which close the loops exactly. Accelerations
    solve (1) by a Cholesky factorisation of the mass matrix; where M is not positive definite they
    are NaN.

    Parameters p are optional where they have a default, as in `Dynamics`.
    """

    @cached_property
    def equations(self) -> TaskDynamics:
        """The symbolic equations."""
        return build_task_dynamics(self.robot, self.kinematics.mechanism)

    @one_or_many("z", "zd", "tau")
    def acceleration(
        self, z: Samples, zd: Samples, tau: Samples, p: Parameters | None = None
    ) -> Samples:
        """z̈ at states (z, ż) under drive torques τ; NaN out of reach.

        The friction of a joint at rest is only its offset: sign(0) = 0, as in inverse dynamics.
        """
        return self.task_acceleration(z, zd, tau, self._parameters(p))

    def task_acceleration(self, z: Samples, zd: Samples, tau: Samples, p: Parameters) -> Samples:
        """The same for rows; NaN where a state is, as in the steps of a solver that go too far."""
        return self._acceleration_kernel.rows(z, zd, tau, uniform=p)[0]

    @one_or_many("q", "qd", "tau")
    def drive_acceleration(
        self, q: Samples, qd: Samples, tau: Samples, p: Parameters | None = None
    ) -> Samples:
        """q̈ at drive coordinates and velocities (q, q̇) under torques τ.

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        z = self.kinematics.forward(q)
        return self._drive_kernel.rows(z, qd, tau, uniform=self._parameters(p))[0]

    @one_or_many("z", "zd")
    def energy(
        self, z: Samples, zd: Samples, p: Parameters | None = None
    ) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
        """Kinetic and potential energy [J]; the latter has an arbitrary constant."""
        kinetic, potential = self._energy_kernel.rows(z, zd, uniform=self._parameters(p))
        return kinetic[:, 0], potential[:, 0]

    def drive_coordinates(self, z: Samples) -> Samples:
        """q(z); NaN out of reach."""
        return self._drive_coordinates_kernel.rows(z)[0]

    def drive_motion(self, z: Samples, zd: Samples) -> tuple[Samples, Samples]:
        """q(z) and q̇ = J ż; NaN out of reach."""
        q, qd = self._drive_motion_kernel.rows(z, zd)
        return q, qd

    def task_velocity(self, z: Samples, qd: Samples) -> Samples:
        """ż = J⁻¹ q̇."""
        return self._task_velocity_kernel.rows(z, qd)[0]

    def step(
        self, z: Samples, qd: Samples, tau: Samples, p: Parameters, duration: float
    ) -> tuple[Samples, Samples]:
        """(z, q̇) one time step later under constant torques, friction at rest included.

        The explicit midpoint rule with the impulses of `task_dynamics.friction_impulses` in both
        stages; of second order where no joint starts or stops sticking. Drives at rest keep q̇ = 0
        to rounding. NaN out of reach, and where J is singular.
        """
        given = np.append(self._parameters(p), duration)
        z_end, qd_end = self._step_kernel.rows(z, qd, tau, uniform=given)
        return z_end, qd_end

    def reach(self, z: Samples) -> Float[np.ndarray, " samples"]:
        """Distance of each pose from the nearest edge of a limb's reach [m]; NaN out of it."""
        return self._reach_kernel.rows(z)[0][:, 0]

    def is_smooth(self, p: Parameters) -> bool:
        """Whether friction is continuous at rest with these coefficients."""
        pairs = zip(self.robot.friction_terms, p[self.layout.friction], strict=True)
        return all(term.continuous or coefficient == 0 for term, coefficient in pairs)

    @cached_property
    def _acceleration(self) -> ca.SX:
        e = self.equations
        losing = [self.robot.drives.index(drive) for drive in self.robot.load_drives]
        force = e.J.T @ e.tau - e.h - e.R.T @ e.friction
        responses = cholesky_solve(e.M, ca.horzcat(force, e.J.T[:, losing]))
        if not losing:
            return responses
        zdd, G, qd = responses[:, 0], responses[:, 1:], e.J @ e.zd
        x = carried(self.robot, e.tau, qd, e.J @ zdd + e.J_dot_zd, e.p)
        return zdd - G @ losses(self.robot, x, e.J @ G, qd, e.p)

    @cached_property
    def _acceleration_kernel(self) -> RowKernel:
        e = self.equations
        return RowKernel((e.z, e.zd, e.tau), [self._acceleration], e.p)

    @cached_property
    def _drive_kernel(self) -> RowKernel:
        e, qd = self.equations, ca.SX.sym("qd", self.dof)
        qdd = ca.substitute(e.J @ self._acceleration + e.J_dot_zd, e.zd, e.T @ qd)
        return RowKernel((e.z, qd, e.tau), [qdd], e.p)

    _energy_kernel = row_kernel("equations", lambda e: ((e.z, e.zd), (e.kinetic, e.potential), e.p))
    _drive_coordinates_kernel = row_kernel("equations", lambda e: ([e.z], [e.q]))
    _reach_kernel = row_kernel("kinematics.mechanism", lambda m: ([m.z], [ca.mmin(m.reach)]))
    _task_velocity_kernel = row_kernel(
        "kinematics.mechanism",
        lambda m: ((m.z, m.speeds.q.u), [m.speeds.inverse_jacobian @ m.speeds.q.u]),
    )
    _drive_motion_kernel = row_kernel("equations", lambda e: ((e.z, e.zd), (e.q, e.J @ e.zd)))

    @cached_property
    def _step_kernel(self) -> RowKernel:
        e, z, qd = self.equations, ca.SX.sym("z0", self.dof), ca.SX.sym("qd0", self.dof)
        h = ca.SX.sym("h")
        change = ca.Function("change", *self.velocity_change())
        T = ca.Function("T", [e.z], [e.T])
        middle = z + 0.5 * h * T(z) @ qd
        qd_middle = qd + change(z, qd, qd, e.tau, e.p, 0.5 * h)
        qd_end = qd + change(middle, qd_middle, qd, e.tau, e.p, h)
        z_end = z + 0.5 * h * T(middle) @ (qd + qd_end)
        z_end = ca.if_else(self.ahead(middle, T(middle) @ qd_middle, h) > 0, z_end, np.nan)
        return RowKernel((z, qd, e.tau), (z_end, qd_end), ca.vertcat(e.p, h))

    def ahead(self, z: ca.SX, zd: ca.SX, h: ca.SX) -> ca.SX:
        """Negative where a limb would be stretched within h.

        A stretched limb can turn back or go on in its other working mode, and z does not
        distinguish these. The distance r to the edge falls to zero with the square of time, so its
        root s is linear in time: s + h ṡ < 0 is r + h ṙ/2 < 0 for r = s².
        """
        m, zd_0 = self.kinematics.mechanism, self.equations.zd
        rate = ca.jacobian(m.reach, m.z) @ zd_0
        reach, rate = ca.Function("reach", [m.z, zd_0], [m.reach, rate])(z, zd)
        return ca.mmin(reach + 0.5 * h * rate)

    def velocity_change(self) -> tuple[list[ca.SX], list[ca.SX]]:
        """Change of q̇ over h by forces at one state (z, q̇): inputs and output of a function.

        Steps pass on q̇ instead of ż, so that a drive at rest keeps its position while others move.
        Friction has its size at q̇ and acts on the speeds that start from q̇_0.

        Where friction depends on load, impulses depend on the torques that gears carry, and these
        on impulses. Each of `ROUNDS` iterations reduces the error to a share μ.
        """
        e, robot = self.equations, self.robot
        qd, qd_0, h = ca.SX.sym("qd", self.dof), ca.SX.sym("qd0", self.dof), ca.SX.sym("h")
        responses = cholesky_solve(e.M, ca.horzcat(e.J.T @ e.tau - e.h - e.R.T @ e.smooth, e.R.T))
        free = h * (e.J @ responses[:, 0] + e.J_dot_zd)
        change = free
        if robot.friction_joints:
            to_joints, loads = e.R @ e.T, e.tau
            drives = sum(joint in robot.drives for joint in robot.friction_joints)
            for _ in range(ROUNDS if robot.load_drives else 1):
                low, high = ca.substitute([-e.forwards, e.backwards], [e.load], [loads])
                impulses = friction_impulses(
                    A=e.R @ responses[:, 1:],
                    v=to_joints @ (qd_0 + free),
                    low=h * low,
                    high=h * high,
                    drives=drives,
                )
                change = free + e.J @ responses[:, 1:] @ impulses
                loads = self._loads(impulses / h, change / h)
        change = ca.substitute(change, e.zd, e.T @ qd)
        return [e.z, qd, qd_0, e.tau, e.p, h], [change]

    def _loads(self, dry: ca.SX, acceleration: ca.SX) -> ca.SX:
        """Torques that gears carry: τ without the motors' friction and rotors.

        Args:
            dry: discontinuous part of the friction that acts on each joint.
            acceleration: q̈.
        """
        e, robot = self.equations, self.robot
        loads = e.tau - rotor_inertia(robot, e.p) * acceleration
        for j, joint in enumerate(robot.friction_joints):
            if joint in robot.drives:
                loads[robot.drives.index(joint)] += dry[j] - e.smooth[j]
        return loads


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
    inertia = ca.Function("I", [symbols], [rotor_inertia(robot, symbols)])(p)
    return np.asarray(inertia).ravel()


def motor_speeds(
    robot: RobotDescription,
    p: Parameters,
    speeds: Samples,
    tau: Samples,
    carried: Samples,
    duration: float,
) -> Samples:
    """θ̇ one time step later, under motor torques τ and carried torques, one state a row."""
    kernel = _motor_kernel(robot.model_dump_json())
    return kernel.rows(speeds, tau, carried, uniform=np.append(p, duration))[0]


@lru_cache(maxsize=8)
def _motor_kernel(description: str) -> RowKernel:
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
    return RowKernel((v, tau, load), [end], ca.vertcat(p, h))
