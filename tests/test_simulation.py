"""Time steps with friction: sticking and letting go as Coulomb says, second order, energy."""

import casadi as ca
import numpy as np
import pytest

from deltaid.control.simulation import integrate, step_through
from deltaid.dynamics.dynamics import compiled, compiled_as
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.dynamics.task_dynamics import friction_impulses
from deltaid.errors import DeltaidError, DescriptionError, KinematicsError
from deltaid.kernel.batch import BatchKernel
from deltaid.motion.fourier import FourierMotion
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction, Stribeck
from deltaid.robot.load import load_robot
from support import KINDS
from sweeps import swept

FEW = ("clavel-delta3", "irb360-6-1600", "i4")
every_robot = pytest.mark.parametrize("name", swept(KINDS, *FEW))


def poses(forward: ForwardDynamics, n: int) -> np.ndarray:
    motion = random_motion(forward.kinematics, np.random.default_rng(2))
    return motion.evaluate(np.linspace(0, motion.period, n))[0]


def started(robot: RobotDescription | str) -> tuple[ForwardDynamics, np.ndarray, np.ndarray]:
    """Its forward dynamics, its prior and its home pose."""
    forward = compiled_as(ForwardDynamics, load_robot(robot) if isinstance(robot, str) else robot)
    return forward, prior_parameters(forward.robot), forward.kinematics.home[None]


def holding(forward: ForwardDynamics, z: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Torques that hold the robot without friction."""
    still = np.zeros_like(z)
    return compiled(forward.robot).torque(z, still, still, p)


def drive_friction(forward: ForwardDynamics, p: np.ndarray) -> np.ndarray:
    names = forward.layout.names
    return np.array([p[names.index(f"coulomb.{drive}")] for drive in forward.robot.drives])


# --- the impulses ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("joints", "drives", "exceptions"), [(3, 3, 0), (5, 4, 0), (2, 0, 0), (6, 4, 0.01)]
)
def test_impulses_are_the_minimiser_over_the_box(
    joints: int, drives: int, exceptions: float
) -> None:
    """Its conditions: each joint rests, or has the bound against its speed.

    Impulses drawn beyond the box make some joints move; joints beside the drives make A singular.
    """
    rng = np.random.default_rng(joints)
    W = rng.standard_normal((joints, max(drives, 2)))
    W[:drives] = np.eye(drives, W.shape[1])
    W = W @ (rng.standard_normal((W.shape[1], W.shape[1])) + 2 * np.eye(W.shape[1]))
    A = W @ W.T
    v, low, high = (ca.SX.sym(name, joints) for name in ("v", "low", "high"))
    impulses = friction_impulses(ca.SX(ca.DM(A)), v, low, high, drives)
    bounds = rng.uniform(0, 1, (2, 2000, joints))
    free = -1.5 * rng.uniform(-1, 1, (2000, joints)) @ A
    x = np.hstack([free, -bounds[0], bounds[1]])
    found = BatchKernel(ca.vertcat(v, low, high), impulses)(x.T).T
    assert np.all(found >= -bounds[0])
    assert np.all(found <= bounds[1])
    speed = free + found @ A
    moving = np.abs(speed) > 1e-9
    against = np.where(speed > 0, -bounds[0], bounds[1])
    wrong = np.any(moving & (np.abs(found - against) > 1e-9), axis=1)
    assert wrong.mean() <= exceptions
    assert 0.1 < moving.mean() < 0.9


# --- at rest --------------------------------------------------------------------------------------


@every_robot
def test_below_its_friction_a_robot_stays_where_it_is(name: str) -> None:
    """Twenty poses at once, each pushed against all drives by up to 90 % of their friction."""
    forward, p, _ = started(name)
    z, rng = poses(forward, 20), np.random.default_rng(3)
    tau = holding(forward, z, p) + rng.uniform(-0.9, 0.9, z.shape) * drive_friction(forward, p)
    path = step_through(forward, p, z, np.zeros_like(z), 0.1, lambda t, q, qd: tau)
    assert np.abs(path.z - z).max() < 1e-12
    assert np.abs(path.zd).max() < 1e-12


def test_at_rest_for_ever() -> None:
    """Nothing adds up over five thousand steps."""
    forward, p, start = started("clavel-delta3")
    tau = holding(forward, start, p) + 0.8 * drive_friction(forward, p)
    z, qd = start, 0 * start
    for _ in range(5000):
        z, qd = forward.step(z, qd, tau, p, 0.01)
    assert np.abs(z - start).max() < 1e-12


def test_one_drive_pushed_beyond_its_friction_moves_alone() -> None:
    """What the others feel of its acceleration stays below their friction."""
    forward, p, z = started("irb360-6-1600")
    push = 1.05 * drive_friction(forward, p) * np.array([0, 1, 0, 0])
    # The slide, which moves with every arm, has friction too.
    push[1] += 10.0
    tau = holding(forward, z, p) + push
    path = step_through(forward, p, z, 0 * z, 0.05, lambda t, q, qd: tau)
    q = forward.drive_coordinates(path.z[:, 0])
    assert q[-1, 1] - q[0, 1] > 1e-3
    assert np.all(np.diff(q[:, 1]) > 0)
    others = np.delete(q, 1, axis=1)
    assert np.abs(others - others[0]).max() < 1e-8  # what the arms' curves leave of second order


def test_breakaway_takes_the_friction_of_rest() -> None:
    """With Stribeck's term a drive holds 1.3 of what keeps it moving, once it moves."""
    robot = load_robot("linear-delta")
    law = Friction(viscous=40, coulomb=30, stribeck=Stribeck(coefficient=15, speed=0.02))
    forward, p, z = started(robot.changed(friction=dict.fromkeys(robot.drives, law)))
    tau, unit = holding(forward, z, p), np.ones((1, 3))

    def pushed(force: float, speed: float) -> np.ndarray:
        zd = forward.task_velocity(z, speed * unit)
        return step_through(forward, p, z, zd, 0.2, lambda t, q, qd: tau + force * unit).z[:, 0]

    assert np.abs(np.diff(pushed(44.0, 0.0), axis=0)).max() < 1e-12
    assert np.all(np.diff(pushed(46.0, 0.0)[:, 2]) < 0)
    assert np.all(np.diff(pushed(40.0, 0.2)[:, 2]) < 0)


def test_friction_of_load_holds_a_share_of_what_the_gear_carries() -> None:
    """μ |τ_holding| is added to Coulomb's: |τ − τ_holding| up to c + μ |τ_holding| is held."""
    robot = load_robot("linear-delta")
    laws = {drive: Friction(viscous=40, coulomb=30, load=0.2) for drive in robot.drives}
    forward, p, z = started(robot.changed(friction=laws))
    tau = holding(forward, z, p)
    most = 30 + 0.2 * np.abs(tau)
    for edge in (tau - most, tau + most):
        for share, moves in ((0.99, False), (1.01, True)):
            push = tau + share * (edge - tau)
            path = step_through(forward, p, z, 0 * z, 0.01, lambda t, q, qd, tau=push: tau)
            assert (np.abs(path.z[-1] - z).max() > 1e-12) == moves


# --- in motion ------------------------------------------------------------------------------------


def test_steps_are_of_second_order_where_all_joints_slide() -> None:
    """Against the adaptive solver on the smooth law that the jumping one is while nobody stops."""
    forward, p, z = started("irb360-6-1600")
    qd, tau = np.array([[1.0, 1.2, 0.9, 5.0]]), np.array([[30.0, 35.0, 25.0, 2.0]])
    coulomb, sliding = forward.layout.coulomb, p.copy()
    force = p[coulomb]
    sliding[coulomb] = 0
    time = np.array([0.0, 0.1])
    e = forward.equations
    partial = ca.Function("w", [e.z], [e.R @ ca.inv_minor(e.J)])

    def less(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        W = np.asarray(partial(forward.kinematics.forward(q)[0]))
        return tau - (np.sign(W @ qd[0]) * force) @ W

    zd = forward.task_velocity(z, qd)
    exact = integrate(forward, sliding, z, zd, time, less).z[-1]
    errors = []
    for steps in (100, 200, 400):
        at, speed = z, qd
        for _ in range(steps):
            at, speed = forward.step(at, speed, tau, p, 0.1 / steps)
        errors.append(np.abs(at - exact).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all(ratios > 3.5), errors
    assert errors[-1] < 1e-5


@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600", "i4"])
def test_energy_never_grows_without_input(name: str) -> None:
    """Thrown states under holding torques of home, which have a potential: friction stops all."""
    n, (forward, p, home) = 16, started(name)
    z = np.repeat(home, n, axis=0)
    zd = 0.3 * np.random.default_rng(4).standard_normal(z.shape)
    tau, q_home = holding(forward, home, p), forward.drive_coordinates(home)
    path = step_through(forward, p, z, zd, 1.0, lambda t, q, qd: np.repeat(tau, n, axis=0))
    energy = np.array([
        sum(forward.energy(path.z[k], path.zd[k], p))
        - (forward.drive_coordinates(path.z[k]) - q_home) @ tau[0]
        for k in range(len(path.time))
    ])  # fmt: skip
    kinetic = forward.energy(path.z[0], path.zd[0], p)[0]
    assert np.diff(energy, axis=0).max() < 1e-5 * kinetic.max()
    assert np.all(energy[-1] < energy[0])
    resting = np.abs(path.zd[-1]).max(axis=1) < 1e-12
    assert resting.sum() >= n // 2
    assert np.array_equal(path.z[-1][resting], path.z[-2][resting])


def test_a_batch_is_its_single_runs() -> None:
    forward, p, _ = started("clavel-delta3")
    z, zd = poses(forward, 5), np.full((5, 3), 0.2)
    tau = holding(forward, z, p)
    together = step_through(forward, p, z, zd, 0.05, lambda t, q, qd: tau)
    for k in range(5):
        part = slice(k, k + 1)
        alone = step_through(forward, p, z[part], zd[part], 0.05, lambda t, q, qd, s=part: tau[s])
        assert np.array_equal(alone.z, together.z[:, part])


def test_a_single_state_is_a_vector_or_a_row() -> None:
    forward, p, _ = started("clavel-delta3")
    z, rest = poses(forward, 1), np.zeros((1, 3))
    row, vector = (step_through(forward, p, *state, 0.01) for state in ((z, rest), (z[0], rest[0])))
    np.testing.assert_array_equal(row.z, vector.z)
    p = np.where(["coulomb" in name for name in forward.layout.names], 0.0, p)
    time = np.linspace(0, 0.01, 3)
    row, vector = (integrate(forward, p, *state, time) for state in ((z, rest), (z[0], rest[0])))
    np.testing.assert_array_equal(row.z, vector.z)
    for wrong in (z[:, :2], np.zeros((2, 3))):
        with pytest.raises(KinematicsError, match="z"):
            step_through(forward, p, wrong, rest, 0.01)
        with pytest.raises(KinematicsError, match="z"):
            integrate(forward, p, wrong, rest, time)


def test_who_falls_until_a_limb_is_stretched_ends_there_and_the_others_go_on() -> None:
    forward, p, home = started("clavel-delta3")
    z = np.repeat(home, 2, axis=0)
    tau = holding(forward, z, p)
    tau[0] = 40.0
    path = step_through(forward, p, z, 0 * z, 2.0, lambda t, q, qd: tau)
    ended = np.isnan(path.z[:, 0]).any(axis=1)
    assert ended[-1]
    assert not ended[0]
    assert np.all(np.diff(ended.astype(int)) >= 0)
    assert np.isfinite(path.z[:, 1]).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("solver", ["integrate", "step_through"])
def test_what_is_not_finite_is_named(solver: str, value: float) -> None:
    forward, p, z = started("clavel-delta3")
    p = np.where(["coulomb" in name for name in forward.layout.names], 0.0, p)
    wrong, span = np.array([[0.0, value, 0.0]]), np.linspace(0, 0.01, 3)

    def run(p: np.ndarray, z: np.ndarray, zd: np.ndarray, tau: np.ndarray) -> None:
        if solver == "integrate":
            integrate(forward, p, z, zd, span, lambda t, q, qd: tau)
        else:
            step_through(forward, p, z, zd, 0.01, lambda t, q, qd: tau)

    for state, name in (((z, wrong, 0 * z), "zd"), ((z, 0 * z, wrong), "tau")):
        with pytest.raises(KinematicsError, match=rf"{name}\[0, 1\]: is {value:g}, not a finite"):
            run(p, *state)
    with pytest.raises(DescriptionError, match=rf"p\[3\]: is {value:g}, but .* must be a finite"):
        run(np.where(np.arange(len(p)) == 3, value, p), z, 0 * z, 0 * z)
    with pytest.raises(DeltaidError, match=rf"sine\[1, 0\]: is {value:g}, not a finite"):
        FourierMotion(1.0, z[0], wrong.T, np.zeros((3, 1)))
