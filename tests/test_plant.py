"""What a simulated robot does beyond its model: loads, current loop, elastic gears, ripple."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from deltaid.control.controllers import Controller, ControlModel, tuned
from deltaid.control.plant import Held, Payload, Plant, Running, point_mass
from deltaid.control.tracking import Drives, track
from deltaid.control.trajectory import MotionTrajectory, SampledTrajectory
from deltaid.dynamics.forward_dynamics import link_side, motor_inertia, motor_speeds
from deltaid.errors import DescriptionError
from deltaid.model.model import Model, load
from deltaid.motion.random_motion import random_motion
from deltaid.robot.load import load_robot

STIFFNESS, ROTOR = 2e4, 0.15


@pytest.fixture(scope="module")
def robot() -> Model:
    """Clavel's Delta with motors of their own, whose gears may wind up."""
    drives = ("drive1", "drive2", "drive3")
    changed = {"gear_stiffness": STIFFNESS, "rotor_inertia": dict.fromkeys(drives, ROTOR)}
    return load(load_robot("clavel-delta3").changed(**changed))


@pytest.fixture(scope="module")
def motion(robot: Model) -> MotionTrajectory:
    made = random_motion(robot.forward.kinematics, np.random.default_rng(0))
    return MotionTrajectory(robot.forward.kinematics, made, 0.6)


def followed(plant: Model | Plant, motion: MotionTrajectory, model: Model, **drives: float):
    """By feed-forward and PD."""
    known = ControlModel(model.robot, model.p)
    law = tuned("pd-feedforward", known.mass_diagonal(motion.desired(np.zeros(1)).q), 10.0)
    return track(plant, law, known, motion, Drives(**drives))


def test_a_plant_that_does_nothing_else_is_the_model(
    robot: Model, motion: MotionTrajectory
) -> None:
    assert (followed(robot, motion, robot).z == followed(Plant(robot), motion, robot).z).all()


def test_a_load_pulls_until_it_is_let_go_or_known(robot: Model, motion: MotionTrajectory) -> None:
    held = Held(point_mass(2.0), start=0.2, end=0.4)
    plant = Plant(robot, loads=(held,))
    blind = followed(plant, motion, robot)
    free = followed(robot, motion, robot)
    before = blind.time <= 0.2
    assert (blind.z[before] == free.z[before]).all()
    during = (blind.time > 0.25) & (blind.time < 0.4)
    assert blind.platform_error[during].mean() > 5 * free.platform_error[during].mean()
    without, own = ControlModel(robot.robot, robot.p), robot.with_load(point_mass(2.0)).p
    assert (without.holding(2.0).p == own).all()

    def known_model(time: float) -> ControlModel:
        return without.holding(2.0) if 0.2 <= time < 0.4 else without

    law = tuned("pd-feedforward", without.mass_diagonal(motion.desired(np.zeros(1)).q), 10.0)
    known = track(plant, law, known_model, motion, Drives())
    assert known.error.platform_rms < 0.1 * blind.error.platform_rms


def test_uncertain_loads_have_ends() -> None:
    assert Payload(1.0).ends == ()
    assert Payload(1.5, 0.1).ends == pytest.approx((1.3, 1.7))
    assert Payload(1.0, 0.8).ends == pytest.approx((0.0, 2.6))


@pytest.mark.parametrize("bandwidth", [100.0, 1000.0])
def test_a_current_loop_is_a_lag_of_first_order(robot: Model, bandwidth: float) -> None:
    """The momentum that a step of torque leaves behind lacks torque times the time constant."""
    model, tau = robot.without_friction(), np.array([[40.0, 0.0, 0.0]])
    q, still = model.forward.drive_coordinates(model.home[None]), np.zeros((1, 3))
    speeds = []
    for torque, loop in ((0 * tau, np.inf), (tau, np.inf), (tau, bandwidth)):
        running = Running(Plant(model), q, still, 4000.0, loop)
        running.hold(0 * tau, 0.0)
        for k in range(1, 9):
            running.hold(torque, k / 4000.0)
        speeds.append(running.qd[0, 0])
    share = (speeds[2] - speeds[0]) / (speeds[1] - speeds[0])
    w, t = 2 * np.pi * bandwidth, 8 / 4000.0
    assert share == pytest.approx(1 - (1 - np.exp(-w * t)) / (w * t), abs=0.005)


def test_ripple_pulls_by_place(robot: Model) -> None:
    """Where its phase is a quarter of a turn it takes its whole amplitude from the torque."""
    model = robot.without_friction()
    q, still = model.forward.drive_coordinates(model.home[None]), np.zeros((1, 3))

    def ripple(at: np.ndarray) -> np.ndarray:
        return np.array([3.0, 0, 0]) * np.cos(6.0 * (at - q[0]) * [1, 0, 0])

    ends = []
    for plant, tau in ((Plant(model, ripple=ripple), 5.0), (Plant(model), 2.0)):
        running = Running(plant, q, still, 4000.0, np.inf)
        running.hold(np.array([[tau, 0.0, 0.0]]), 0.0)
        ends.append(running.qd[0])
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)


def test_gears_wind_up_by_what_they_carry(robot: Model) -> None:
    """At rest under control: motors where they should be, links behind them by x / k."""
    q = robot.forward.drive_coordinates(robot.home[None])
    still = SampledTrajectory(
        robot.forward.kinematics, np.linspace(0, 0.5, 8), np.repeat(q, 8, axis=0)
    )
    law = Controller("pd-feedforward", np.full(3, 2000.0), np.full(3, 60.0))
    done = track(Plant(robot, elastic=True), law, ControlModel(robot.robot, robot.p), still,
                 Drives(encoder_step=0.0))  # fmt: skip
    link = robot.forward.drive_coordinates(done.z[-1:])[0]
    gravity = robot.dynamics.inverse_dynamics(
        link[None], 0 * q, 0 * q, link_side(robot.robot, robot.p)
    )[0]
    assert done.q[-1] - link == pytest.approx(gravity / STIFFNESS, rel=1e-3)
    assert np.abs(gravity / STIFFNESS).min() > 1e-4


def test_motor_and_link_swing_as_two_inertias_do(robot: Model) -> None:
    """A motor let go while its link stands (heavy): frequency and energy over many swings."""
    model = Model(robot.robot, robot.p).without_friction()
    plant = Plant(model, elastic=True, damping=0.0)
    q, still = model.forward.drive_coordinates(model.home[None]), np.zeros((1, 3))
    tau = np.full((1, 3), 5.0)
    running = Running(plant, q, still, 4000.0, np.inf)
    seen = [running.encoders[0]]
    for k in range(400):
        running.hold(tau, k / 4000.0)
        seen.append(running.encoders[0])
    inertia, p = motor_inertia(robot.robot, model.p), link_side(robot.robot, model.p)
    forward = model.forward

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        theta, w, z, qd = np.split(x, 4)
        link = forward.drive_coordinates(z[None])[0]
        x_gear = STIFFNESS * (theta - link)
        qdd = forward.drive_acceleration(link[None], qd[None], x_gear[None], p)[0]
        zd = forward.task_velocity(z[None], qd[None])[0]
        return np.concatenate([w, (tau[0] - x_gear) / inertia, zd, qdd])

    start = Running(plant, q, still, 4000.0, np.inf)
    x = np.concatenate([start.encoders[0], np.zeros(3), start.z[0], np.zeros(3)])
    times = np.arange(401) / 4000.0
    exact = solve_ivp(rate, (0, 0.1), x, rtol=1e-9, atol=1e-11, t_eval=times).y[:3].T
    line = np.polynomial.Polynomial.fit(times, exact[:, 0], 3)(times)
    swing = np.abs(exact[:, 0] - line).max()  # about the way that the robot falls
    assert np.abs(np.array(seen) - exact).max() < 0.1 * swing


def test_a_motor_sticks_below_its_friction(robot: Model) -> None:
    loss = robot.value("coulomb.drive1")
    tau = np.array([[0.9, 1.1, -1.1]]) * loss
    speeds = motor_speeds(robot.robot, robot.p, np.zeros((1, 3)), tau, np.zeros((1, 3)), 1e-3)
    assert speeds[0] == pytest.approx([0.0, 1e-4 * loss / ROTOR, -1e-4 * loss / ROTOR], abs=1e-12)


def test_gears_that_cannot_wind_up_are_reported() -> None:
    model = load("clavel-delta3")
    with pytest.raises(DescriptionError, match="how stiff the gear of drive1"):
        Plant(model, elastic=True)
    stiff = load(load_robot("clavel-delta3").changed(gear_stiffness=1e4, rotor_inertia={}))
    with pytest.raises(DescriptionError, match="what inertia the motor of drive"):
        Plant(stiff, elastic=True)


def test_stiff_gears_are_no_gears(robot: Model, motion: MotionTrajectory) -> None:
    stiff = load(robot.robot.changed(gear_stiffness=1e6))
    motion = replace(motion, duration=0.2)
    law, known = Controller("computed-torque", bandwidth=60.0), ControlModel(robot.robot, robot.p)
    rigid = track(robot, law, known, motion, Drives())
    elastic = track(Plant(stiff, elastic=True, damping=0.1), law, known, motion, Drives())
    assert elastic.ended is None
    assert np.abs(elastic.z - rigid.z).max() < 1e-4
