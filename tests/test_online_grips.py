"""Gripper signals that come before or after the load: reported, and masses hold."""

import numpy as np
import pytest

from deltaid.online.instant import UNKNOWN
from deltaid.online.online import Online
from online_runs import LOAD, QUIET, outputs, robot, running
from shuttling import shuttle

TAKEN, LEFT, CYCLES = 400, 900, 1300


def gripper_signal(late: int) -> np.ndarray:
    """A signal that comes so many cycles after the load."""
    rows = np.arange(CYCLES)
    return (rows >= TAKEN + late) & (rows < LEFT + late)


@pytest.mark.parametrize("late", [-150, -100, -45, 0, 45, 100, 150])
def test_a_signal_at_the_wrong_time_is_reported_and_masses_hold(late: int) -> None:
    model, graph = robot("clavel-delta3")
    run = running(model, CYCLES, slice(TAKEN, LEFT), noise=0.1)
    y = outputs(graph, run, gripper_signal(late))
    known = TAKEN + max(late, 0) + 100
    # Known within a step of the times that are kept.
    assert y["grip_offset"][known, 0] == pytest.approx(1e-3 * late, abs=0.01)
    rows = slice(known, LEFT + min(late, 0))
    mass, half = y["load"][rows, 0], 1.96 * y["load_std"][rows, 0]
    assert np.abs(mass - LOAD[0]).max() < 0.12
    # Without contacts and with hardly any noise, late ones leave a few per cent in friction.
    assert late > 0 or np.mean(np.abs(mass - LOAD[0]) <= half) >= 0.9
    assert np.array_equal(y["held"][:, 0] > 0, gripper_signal(late))


def test_a_load_that_is_still_to_come_is_unknown() -> None:
    model, graph = robot("clavel-delta3")
    run = running(model, CYCLES, slice(TAKEN, LEFT), noise=0.1)
    y = outputs(graph, run, gripper_signal(-150))
    before = slice(TAKEN - 145, TAKEN)
    high = y["load"][before, 0] + 1.96 * y["load_std"][before, 0]
    assert high.min() > LOAD[0]
    assert np.all(y["grip_offset"][before] == UNKNOWN)


def test_an_offset_is_unknown_where_nothing_is_held() -> None:
    model, graph = robot("clavel-delta3")
    run = running(model, CYCLES, slice(0, 0), noise=0.1)
    y = outputs(graph, run, gripper_signal(0))
    assert np.all(y["grip_offset"] == UNKNOWN)


def test_python_gives_the_offset_in_seconds_or_nan() -> None:
    model, _ = robot("clavel-delta3")
    run = running(model, CYCLES, slice(TAKEN, LEFT), noise=0.1)
    found = Online(model, QUIET).run(run.q, run.qd, run.tau, gripper_signal(50).astype(float))
    assert np.isnan(found.grip_offset[: TAKEN + 40]).all()
    assert found.grip_offset[LEFT - 1] == pytest.approx(0.05, abs=0.01)


def test_a_load_that_rests_for_long_leaves_other_estimates_as_they_are() -> None:
    """At rest friction hides it: no covariance is larger than its prior when it moves off."""
    shuttle_robot = shuttle(dwell=280)
    online = shuttle_robot.online(speed_noise=None)
    rng = np.random.default_rng(0)
    q, tau, held = shuttle_robot.rounds(rng.uniform(0.2, 1.0, 20))
    tau += online.known.noise * rng.standard_normal(tau.shape)
    places = online.graph.state.places
    n = places["x"].stop - places["x"].start
    corner = np.cumsum(np.arange(n, 0, -1)) - np.arange(n, 0, -1)
    rows, largest = len(shuttle_robot.q), list[float]()
    before = shuttle_robot.grips[0] + 270
    for start in range(0, len(q), rows):
        for part in (slice(start, start + before), slice(start + before, start + rows)):
            online.run(q[part], None, tau[part], held[part])
            largest.append(float(online.state[places["P"]][corner].max()))
    assert max(largest) < 1.05
