"""Forward dynamics: inverse of inverse dynamics, energy, MuJoCo's projection, positive M."""

from functools import cache

import casadi as ca
import numpy as np
import pytest

from composed import Make, label, random_states, twin
from deltaid.control.simulation import integrate
from deltaid.dynamics.dynamics import Dynamics, compiled_as
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.errors import DeltaidError, KinematicsError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction, PowerLaw, Stribeck
from deltaid.robot.load import load_robot
from support import KINDS, assert_close, example
from sweeps import swept

MAKES = (
    Make(), Make(telescope=True, clockwise=True), Make("par4"), Make(linear=True, tilt=(15, 35)),
    Make("h4"), Make("h4", linear=True), Make("i4"), Make("i4", linear=True),
)  # fmt: skip
EVERY_TERM = Friction(
    viscous=1.1,
    coulomb=2.3,
    viscous_back=0.7,
    coulomb_back=3.1,
    power=PowerLaw(coefficient=0.8, exponent=0.4),
    stribeck=Stribeck(coefficient=1.7, speed=0.2, exponent=2.0),
    load=0.15,
)
OFFSET = Friction(viscous=1.1, coulomb=2.3, offset=0.9)
FEW = ("clavel-delta3", "irb360-6-1600", "h4-linear")
every_robot = pytest.mark.parametrize("name", swept(KINDS, *FEW))


def states(kinematics: Kinematics, n: int = 30) -> tuple[np.ndarray, ...]:
    """z, ż, z̈ of brisk motion all over the workspace."""
    motion = random_motion(kinematics, np.random.default_rng(4))
    return motion.evaluate(np.linspace(0.0, motion.period, n))


def with_offsets(robot: RobotDescription) -> np.ndarray:
    """The prior, and constant offsets that are not zero."""
    p, layout = prior_parameters(robot), parameter_layout(robot)
    p[list(layout.signed)] = 0.4
    return p


# --- forward and inverse --------------------------------------------------------------------------


def test_identity_in_drive_coordinates_with_every_friction_term() -> None:
    robot = load_robot("irb360-6-1600")
    laws = dict.fromkeys(("drive1", "drive4"), EVERY_TERM) | {"drive2": OFFSET}
    rotors = dict.fromkeys(robot.drives, 0.3)  # as heavy as the arms
    robot = robot.changed(friction=robot.friction | laws, rotor_inertia=rotors)
    dynamics, p = Dynamics(robot), with_offsets(robot)
    z, zd, zdd = states(dynamics.kinematics)
    q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.inverse_dynamics(q, qd, qdd, p)
    assert_close(ForwardDynamics(robot).drive_acceleration(q, qd, tau, p), qdd, 1e-9)


@every_robot
def test_mass_matrix_is_symmetric_and_positive_definite(name: str) -> None:
    robot = load_robot(name)
    e = compiled_as(ForwardDynamics, robot).equations
    of = ca.Function("M", [e.z, e.p], [e.M])
    for z in states(Kinematics(robot), 10)[0]:
        M = np.asarray(of(z, prior_parameters(robot)))
        np.testing.assert_allclose(M, M.T, rtol=1e-12, atol=1e-12)
        assert np.linalg.eigvalsh(M).min() > 0


def test_identity_for_a_mechanism_of_ones_own() -> None:
    robot = example("heli4")
    forward, dynamics, p = ForwardDynamics(robot), Dynamics(robot), prior_parameters(robot)
    z, zd, zdd = states(dynamics.kinematics)
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, p)
    assert_close(forward.acceleration(z, zd, tau, p), zdd, 1e-9)


# --- against MuJoCo's tree, projected -------------------------------------------------------------


@pytest.mark.parametrize("make", swept(MAKES, *MAKES[:4]), ids=label)
def test_accelerations_against_the_oracle(make: Make) -> None:
    """Springs, rotors, passive joints and gravity in any direction included."""
    t, rng = twin(make), np.random.default_rng(3)
    z, q, qd, _ = random_states(t.oracle, rng, 6)
    tau = rng.uniform(-50, 50, z.shape)
    bias = t.oracle.inverse_dynamics(z, qd, np.zeros_like(z))
    M = np.array([t.oracle.mass_matrix(row) for row in z])
    expected = np.linalg.solve(M, (tau - bias)[:, :, None])[:, :, 0]
    found = ForwardDynamics(t.robot).drive_acceleration(q, qd, tau, t.p)
    assert_close(found, expected, 1e-9)


# --- motion without friction ----------------------------------------------------------------------


@cache
def frictionless(name: str) -> tuple[ForwardDynamics, np.ndarray]:
    robot = load_robot(name)
    p = prior_parameters(robot)
    p[parameter_layout(robot).friction] = 0
    return compiled_as(ForwardDynamics, robot), p


@pytest.mark.parametrize("name", swept(["irb360-6-1600", "par4", "linear-delta"], "irb360-6-1600"))
def test_energy_is_kept_for_ten_seconds_and_loops_stay_closed(name: str) -> None:
    """Constant torques that hold the robot at home, and springs about it: a potential as well."""
    forward, p = frictionless(name)
    dynamics = Dynamics(forward.robot)
    home = forward.kinematics.home[None]
    q_home, still = forward.drive_coordinates(home), np.zeros_like(home)
    tau = dynamics.torque(home, still, still, p)
    stiffness = 40 * np.diagonal(dynamics.mass_matrix(q_home, p)[0])
    z = np.repeat(home, 3, axis=0)
    zd = np.random.default_rng(5).uniform(-0.3, 0.3, z.shape)
    time = np.linspace(0, 10, 21)
    path = integrate(forward, p, z, zd, time, lambda t, q, qd: tau - stiffness * (q - q_home))
    for k in range(len(z)):
        z, zd = path.z[:, k], path.zd[:, k]
        away = forward.drive_coordinates(z) - q_home
        kinetic, potential = forward.energy(z, zd, p)
        energy = kinetic + potential - away @ tau[0] + 0.5 * away**2 @ stiffness
        assert np.ptp(kinetic) > 0.3 * kinetic.max()
        assert np.abs(energy - energy[0]).max() < 1e-8 * kinetic.max()
        # q = q(z) closes the loops; forward kinematics, which solves them anew, finds z again.
        found = forward.kinematics.forward(forward.drive_coordinates(z))
        np.testing.assert_allclose(found, z, atol=1e-9)


def test_a_batch_is_its_single_runs() -> None:
    forward, p = frictionless("clavel-delta3")
    z = forward.kinematics.home + np.random.default_rng(0).uniform(-0.1, 0.1, (5, 3))
    zd, time = np.full_like(z, 0.2), np.array([0.0, 0.1, 0.2])
    together = integrate(forward, p, z, zd, time)
    alone = [integrate(forward, p, z[k : k + 1], zd[k : k + 1], time) for k in range(len(z))]
    np.testing.assert_allclose(together.z, np.concatenate([a.z for a in alone], axis=1), atol=1e-9)


def test_a_robot_that_falls_until_a_limb_is_stretched_is_reported() -> None:
    forward, p = frictionless("clavel-delta3")
    home = forward.kinematics.home[None]
    with pytest.raises(KinematicsError, match=r"stretched after 0\.\d* s"):
        integrate(forward, p, home, 0 * home, np.linspace(0, 5, 51))


def test_friction_that_jumps_is_refused_by_the_solver() -> None:
    forward, _ = frictionless("clavel-delta3")
    home, p = forward.kinematics.home[None], prior_parameters(forward.robot)
    with pytest.raises(DeltaidError, match="step_through"):
        integrate(forward, p, home, 0 * home, np.linspace(0, 1, 3))
