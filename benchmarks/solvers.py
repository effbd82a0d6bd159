"""Solvers for forward dynamics without friction: time and energy kept over ten seconds.

    python benchmarks/solvers.py

Clavel's Delta swings about its home pose on springs at its drives, under torques that hold its
weight there; so energy is a number that an exact solution keeps. Counted is the largest deviation
of that energy, as a share of the largest kinetic energy, and the CPU time of one call:

DOP853  `deltaid.control.simulation.integrate`
LSODA   SciPy's, on the same function of the state
CVODES  SUNDIALS through CasADi, on the package's graph (Adams or BDF); it evaluates one state

All are asked for the relative tolerance of `integrate`, 1e-10, and LSODA and CVODES for tighter and
looser ones too. Beside them the time of all constraint forces of the 4-DOF Delta in a batch.
"""

import time
from collections.abc import Callable

import _alone  # noqa: F401
import casadi as ca
import numpy as np
from _timing import machine, measure
from scipy.integrate import solve_ivp

from deltaid.control.simulation import integrate
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.robot.load import load_robot
from support import along

Array = np.ndarray
TIME = np.linspace(0.0, 10.0, 101)
REPEATS, CPU = 3, time.process_time


class Swing:
    def __init__(self) -> None:
        robot = load_robot("clavel-delta3")
        self.forward, self.p = ForwardDynamics(robot), prior_parameters(robot)
        self.p[parameter_layout(robot).friction] = 0.0
        self.home = self.forward.kinematics.home[None]
        self.q_home = self.forward.drive_coordinates(self.home)
        dynamics, still = Dynamics(robot), np.zeros((1, 3))
        self.held = dynamics.torque(self.home, still, still, self.p)
        self.stiffness = 40 * np.diagonal(dynamics.mass_matrix(self.q_home, self.p)[0])
        self.zd = np.array([[0.2, -0.15, 0.1]])

    def torque(self, _: float, q: Array, qd: Array) -> Array:
        return self.held - self.stiffness * (q - self.q_home)

    def rate(self, _: float, x: Array) -> Array:
        z, zd = x[None, :3], x[None, 3:]
        tau = self.torque(0.0, self.forward.drive_coordinates(z), zd)
        return np.append(zd, self.forward.acceleration(z, zd, tau, self.p))

    def drift(self, z: Array, zd: Array) -> float:
        """Largest deviation of the energy, as a share of the largest kinetic one."""
        away = self.forward.drive_coordinates(z) - self.q_home
        kinetic, potential = self.forward.energy(z, zd, self.p)
        energy = kinetic + potential - away @ self.held[0] + 0.5 * away**2 @ self.stiffness
        return float(np.abs(energy - energy[0]).max() / kinetic.max())


def main() -> None:
    swing = Swing()
    start = np.append(swing.home, swing.zd)
    print(f"{machine()}\n")
    report("DOP853 1e-10", swing, lambda: _dop853(swing))
    for tolerance in (1e-8, 1e-10, 1e-12):
        report(f"LSODA {tolerance:.0e}", swing, lambda rtol=tolerance: _lsoda(swing, start, rtol))
    for method in ("adams", "bdf"):
        for tolerance in (1e-10, 1e-12):
            run = _cvodes(swing, method, tolerance)
            report(f"CVODES {method} {tolerance:.0e}", swing, lambda f=run: _split(f(start)))
    print(f"\nconstraint forces of the 4-DOF Delta, a state of a batch: {1e6 * forces():.3f} µs")


def report(name: str, swing: Swing, run: Callable[[], tuple[Array, Array]]) -> None:
    seconds, drift = measure(run, REPEATS, CPU), swing.drift(*run())
    print(f"{name:22}{seconds:8.3f} s   energy {drift:8.1e}")


def _dop853(swing: Swing) -> tuple[Array, Array]:
    path = integrate(swing.forward, swing.p, swing.home, swing.zd, TIME, swing.torque)
    return path.z[:, 0], path.zd[:, 0]


def _lsoda(swing: Swing, start: Array, rtol: float) -> tuple[Array, Array]:
    solved = solve_ivp(
        swing.rate, (0.0, TIME[-1]), start, method="LSODA", t_eval=TIME, rtol=rtol, atol=rtol / 100
    )
    return _split(solved.y.T)


def _cvodes(swing: Swing, method: str, rtol: float) -> Callable[[Array], Array]:
    e = swing.forward.equations
    q = swing.forward.kinematics.mechanism.q
    at = ca.Function("q", [swing.forward.kinematics.mechanism.z], [q])(e.z)
    tau = ca.DM(swing.held[0]) - ca.DM(swing.stiffness) * (at - ca.DM(swing.q_home[0]))
    zdd = ca.Function("zdd", [e.z, e.zd, e.tau, e.p], [swing.forward._acceleration])
    problem = {
        "x": ca.vertcat(e.z, e.zd),
        "ode": ca.vertcat(e.zd, zdd(e.z, e.zd, tau, ca.DM(swing.p))),
    }
    options = {
        "reltol": rtol,
        "abstol": rtol / 100,
        "linear_multistep_method": method,
        "max_num_steps": 1_000_000,
    }
    solver = ca.integrator("F", "cvodes", problem, 0.0, TIME[1:], options)
    return lambda x: np.vstack([x, np.asarray(solver(x0=x)["xf"]).T])


def _split(x: Array) -> tuple[Array, Array]:
    return np.ascontiguousarray(x[:, :3]), np.ascontiguousarray(x[:, 3:])


def forces() -> float:
    """CPU time of all constraint forces for one of 100,000 states [s]."""
    robot = load_robot("irb360-6-1600")
    assert robot.limbs is not None
    limbs = robot.limbs.changed(strut_spacing=0.1)
    computed, p = (ConstraintForces(robot.changed(limbs=limbs)), prior_parameters(robot))
    z, _, qd, qdd = along(computed.kinematics, np.random.default_rng(0), 100_000)
    return measure(lambda: computed.evaluate(z, qd, qdd, p), REPEATS, CPU) / len(z)


if __name__ == "__main__":
    main()
