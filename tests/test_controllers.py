"""Controllers: the model of a law, their energy balances, one linear feedback near the motion."""

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from deltaid.control.controllers import (
    CONTROLLERS,
    Controller,
    ControlModel,
    Desired,
    tuned,
)
from deltaid.control.simulation import integrate
from deltaid.control.trajectory import MotionTrajectory
from deltaid.dynamics.dynamics import compiled, compiled_as
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from support import along
from sweeps import swept

ROBOT = "clavel-delta3"
LAWS = dict(
    zip(("pd", "feed-forward", "computed", "augmented", "slotine-li"), CONTROLLERS, strict=True)
)


def motion(forward: ForwardDynamics, duration: float = 2.0) -> MotionTrajectory:
    made = random_motion(forward.kinematics, np.random.default_rng(0))
    return MotionTrajectory(forward.kinematics, made, duration)


def resting(trajectory: MotionTrajectory, time: np.ndarray) -> Desired:
    """The first pose, held."""
    d = trajectory.desired(np.zeros(len(time)))
    return Desired(d.z, d.q, 0 * d.qd, 0 * d.qdd)


# --- the model of a law -------------------------------------------------------------------------


def test_model_of_a_law_has_the_torques_of_inverse_dynamics_with_all_friction() -> None:
    """Friction that depends on load too: each way more torque when driving, less when driven."""
    data = load_robot(ROBOT).model_dump(mode="json", exclude_none=True)
    shares, rotor = np.array([0.07, 0.11, 0.16]), 0.05
    data["rotor_inertia"] = {f"drive{i + 1}": rotor for i in range(3)}
    for i, share in enumerate(shares):
        data["friction"][f"drive{i + 1}"] |= {"load": share, "offset": 0.4}
    robot = RobotDescription.model_validate(data)
    dynamics, p = compiled(robot), prior_parameters(robot)
    z, q, qd, qdd = along(dynamics.kinematics, np.random.default_rng(0), 200)
    model, unloaded = ControlModel(robot, p), p.copy()
    unloaded[[dynamics.layout.names.index(f"load.drive{i + 1}") for i in range(3)]] = 0
    for rubbing in (qd, -qd):
        found = model.torque(z, q, qd, qd, qdd, rubbing)
        without = ControlModel(robot, unloaded).torque(z, q, qd, qd, qdd, rubbing)
        own = dynamics.terms(q, rubbing, unloaded).f + rotor * qdd  # of the motors alone
        lost = shares * np.sign(rubbing) * np.abs(without - own)
        np.testing.assert_allclose(found, without + lost, rtol=1e-9, atol=1e-9)
    expected = dynamics.torque(z, qd, qdd, p)
    found = model.torque(z, q, qd, qd, qdd, qd)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


# --- laws -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", swept([ROBOT, "irb360-6-1600", "i4-linear"], ROBOT))
@pytest.mark.parametrize("law", LAWS)
def test_storage_grows_by_supplied_work_less_what_the_law_dissipates(law: str, name: str) -> None:
    """An equality, so a C that is not Christoffel's or a wrong sign shows.

    Storage, supplied power and dissipation of each law with the exact model, viscous friction and
    a disturbance d at the drives; see the text of `controllers`.
    """
    robot = load_robot(name)
    p, layout = prior_parameters(robot), parameter_layout(robot)
    p[layout.coulomb] = 0
    if law in ("pd", "feed-forward", "computed"):
        p[layout.viscous] = 0
    forward, model, dynamics = (
        compiled_as(ForwardDynamics, robot),
        ControlModel(robot, p),
        compiled(robot),
    )
    trajectory = motion(forward)
    # Gains of every drive another share of its inertia.
    mass = model.mass_diagonal(trajectory.desired(np.zeros(1)).q)
    K = 700 * mass * np.array([1.0, 0.8, 1.3, 0.7])[: len(mass)]
    D = 14 * mass * np.array([1.2, 0.9, 0.7, 0.5])[: len(mass)]
    w = 15.0
    held, controller = law in ("pd", "feed-forward"), Controller(LAWS[law], K, D, w)

    def desired(t: np.ndarray) -> Desired:
        return resting(trajectory, t) if held else trajectory.desired(t)

    def disturbance(t: np.ndarray) -> np.ndarray:
        return 5 * mass * np.array([1.0, -0.7, 0.5, 0.6])[: len(mass)] * np.sin(17 * t[:, None])

    def torque(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        at = np.array([t])
        return controller.torque(model, q, qd, desired(at)) + disturbance(at)

    time = np.linspace(0, 0.3, 301)
    first = desired(time[:1])
    z0 = first.z + np.array([0.02, -0.015, 0.01, 0.1])[: len(mass)]
    path = integrate(forward, p, z0, forward.task_velocity(z0, first.qd), time, torque)
    z, zd = path.z[:, 0], path.zd[:, 0]
    q, qd = forward.drive_motion(z, zd)
    d, e = desired(time), q - desired(time).q
    ed = qd - d.qd
    M, push = dynamics.mass_matrix(q, p), disturbance(time)
    friction = np.einsum("sij,si,sj->s", _viscous(dynamics, q, p), ed, ed)

    def form(A: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.einsum("sij,si,sj->s", np.broadcast_to(A, (len(x), *A.shape[-2:])), x, x)

    if held:
        kinetic, potential = forward.energy(z, zd, p)
        weight = dynamics.torque(d.z, d.qd, d.qd, p) if law == "feed-forward" else 0 * e
        storage = kinetic + potential + 0.5 * e**2 @ K - np.sum(weight * e, axis=1)
        supplied, lost = np.sum(push * qd, axis=1), qd**2 @ D
    elif law == "computed":
        storage = 0.5 * np.sum(ed**2 + w**2 * e**2, axis=1)
        supplied = np.sum(np.linalg.solve(M, push[:, :, None])[:, :, 0] * ed, axis=1)
        lost = 2 * w * np.sum(ed**2, axis=1)
    elif law == "augmented":
        storage = 0.5 * form(M, ed) + 0.5 * e**2 @ K
        supplied, lost = np.sum(push * ed, axis=1), ed**2 @ D + friction
    else:
        s = ed + w * e
        storage = 0.5 * form(M, s)
        supplied, lost = np.sum(push * s, axis=1), s**2 @ D + form(_viscous(dynamics, q, p), s)
    assert lost.min() > -1e-12
    work = cumulative_simpson(supplied, x=time, initial=0)
    gone = cumulative_simpson(lost, x=time, initial=0)
    size = np.ptp(storage)
    np.testing.assert_allclose(storage - storage[0], work - gone, atol=1e-5 * size)
    assert np.all(storage - storage[0] <= work + 1e-5 * size)
    assert gone[-1] > 0.05 * size


def _viscous(dynamics, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """∂f/∂q̇ of viscous friction: f is linear in q̇."""
    units = (np.broadcast_to(unit, q.shape) for unit in np.eye(dynamics.dof))
    return np.stack([dynamics.terms(q, unit, p).f for unit in units], axis=2)


def test_what_the_model_gives_is_inverse_dynamics_and_finds_the_pose_itself() -> None:
    robot = load_robot("irb360-6-1600")
    p, dynamics = prior_parameters(robot), compiled(robot)
    d = motion(compiled_as(ForwardDynamics, robot)).desired(np.linspace(0, 2, 20))
    near = d.z + 0.01 * np.random.default_rng(0).uniform(-1, 1, d.z.shape)
    found = ControlModel(robot, p).torque(near, d.q, d.qd, d.qd, d.qdd, d.qd)
    expected = dynamics.torque(d.z, d.qd, d.qdd, p)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_all_laws_are_one_linear_feedback_near_the_motion() -> None:
    """On a robot whose M is diagonal and constant the tuned laws are the same to first order."""
    robot = load_robot("linear-delta")
    p = prior_parameters(robot)
    p[:10] *= 1e-6
    p[10:30] *= 1e-6  # carriages, struts and platform weigh nothing, so that rotors are all of M
    model = ControlModel(robot, p)
    d = motion(compiled_as(ForwardDynamics, robot)).desired(np.array([0.3]))
    e, ed = 1e-6 * np.array([[1.0, -2.0, 3.0]]), 1e-4 * np.array([[2.0, 1.0, -1.0]])
    mass = model.mass_diagonal(d.q)
    at = [(d.q + k * e, d.qd + k * ed) for k in (0, 1)]
    viscous = np.array([40.0, 40.0, 40.0])
    answers = {
        name: np.subtract(*(tuned(name, mass, 5.0).torque(model, *m, d) for m in reversed(at)))
        for name in CONTROLLERS
    }
    # The friction that Slotine-Li compensates is that of q̇_r.
    answers["slotine-li"] = answers["slotine-li"] + viscous * 2 * np.pi * 5.0 * e
    for name in CONTROLLERS:
        np.testing.assert_allclose(answers[name], answers["pd"], rtol=2e-3, err_msg=name)
