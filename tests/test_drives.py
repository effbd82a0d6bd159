"""Recordings of real drives' kinds (`tests/drives`): the clean one is what the model says."""

from functools import cache

import numpy as np

from deltaid.dynamics.dynamics import compiled
from drives import Case, case
from drives.errors import friction_curve
from drives.judge import outside
from drives.noise import noise_limit
from support import assert_close, assert_torques


@cache
def clean() -> Case:
    return case("clean", "linear", 1)


def test_torques_are_those_of_the_true_robot() -> None:
    # The oracle knows nothing of the package: that both agree is physics.
    made = clean()
    assert_torques(made.robot, made.happenings[0].truth, made.machine.plant.p)


def test_noise_is_two_per_cent() -> None:
    made = clean()
    truth = made.happenings[0].truth.tau
    columns = [f"tau{i + 1}" for i in range(truth.shape[1])]
    error = made.logs[0].select(columns).to_numpy() - truth
    np.testing.assert_allclose(error.std(axis=0), 0.02 * np.abs(truth).max(axis=0), rtol=0.05)


def test_a_load_is_what_a_heavier_tool_is() -> None:
    made = case("load-half", "linear", 1)
    happening, machine = made.happenings[0], made.machine
    truth, load = happening.truth, happening.load
    assert load is not None
    part = machine.layout.body("P")
    p = machine.plant.p.copy()
    p[part][0] += load.mass
    assert_torques(made.robot, truth, p, since=happening.held[0][0])


def test_judged_beside_the_truth_the_truth_is_right() -> None:
    made = clean()
    happening, robot = made.happenings[0], made.robot
    machine = made.machine
    drive, v = robot.drives[1], np.array([-0.5, 0.7])
    curve = friction_curve(robot, machine.plant.p, drive, v, 0.0)
    np.testing.assert_allclose(curve, happening.friction.curve(v[:, None])[:, 1])
    q = compiled(robot).kinematics.inverse(machine.poses)
    M = compiled(robot).mass_matrix(q, machine.plant.p)
    assert_close(M, machine.M, 1e-9)
    assert all(1e-4 < limit < 1e-2 for limit in noise_limit(made))


def test_time_outside_contacts() -> None:
    assert outside((0.0, 10.0), [(1.0, 2.0), (9.0, 12.0)]) == 8.0
    assert outside((1.2, 1.8), [(1.0, 2.0)]) == 0.0
