"""Loads estimated while a robot runs: found, weighed, consistent, always finite; late signals."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from deltaid.online.cycle import step_graph
from deltaid.online.entries import LoadEntries
from deltaid.online.instant import UNKNOWN
from deltaid.online.online import Online
from deltaid.robot.inertia import consistency
from online_runs import LOAD, QUIET, outputs, robot, running
from shuttling import shuttle
from sweeps import swept


@pytest.mark.parametrize(
    "name", swept(["clavel-delta3", "irb360-6-1600", "linear-delta", "h4"], "irb360-6-1600", "h4")
)
def test_a_load_that_the_gripper_tells_is_weighed(name: str) -> None:
    model, graph = robot(name)
    run = running(model, 600, slice(200, 500), noise=0.1)
    y = outputs(graph, run, run.held)
    assert np.all(y["status"][5:] == 0)  # Newton's steps begin at home
    assert np.array_equal(y["held"][:, 0] > 0, run.held)
    mass, std = y["load"][:, 0], y["load_std"][:, 0]
    late = slice(400, 500)
    assert np.abs(mass[late] - LOAD[0]).max() < max(3 * std[late].max(), 0.02)
    assert std[late].max() < 0.18  # friction at rest is no measurement in each row
    assert np.all(y["load"][~run.held] == 0)


@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600"])
def test_a_load_is_found_and_its_release_too(name: str) -> None:
    model, graph = robot(name)
    run = running(model, 900, slice(300, 600), noise=0.1)
    held = outputs(graph, run)["held"][:, 0] > 0
    assert not held[:300].any()
    assert held[400:600].all()
    assert not held[700:].any()


def test_moments_of_a_load_show_where_it_turns() -> None:
    model, graph = robot("irb360-6-1600")
    run = running(model, 1200, slice(200, 1200), noise=0.05)
    y = outputs(graph, run, run.held)
    shown = LOAD[[0, 1, 2, 6]]
    assert np.all(np.abs(y["load"][-1] - shown) < 4 * y["load_std"][-1])
    assert np.abs(y["load"][-1, 1:3] - shown[1:3]).max() < 0.01


@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600"])
def test_every_cycle_gives_a_load_that_exists(name: str) -> None:
    model, graph = robot(name)
    rng = np.random.default_rng(1)
    for load in (LOAD, 0.02 * LOAD):
        run = running(model, 400, slice(100, 400), load=load)
        wild = replace(run, tau=run.tau + 5 * rng.standard_normal(run.tau.shape))
        y = outputs(graph, wild, run.held)
        entries = y["load"][run.held]
        assert entries[:, 0].min() > 0
        if entries.shape[1] == 4:
            m, x, y_, turned = entries.T
            assert np.all(turned > (x**2 + y_**2) / m)
            assert np.all(np.hypot(x, y_) <= 0.15 * m * (1 + 1e-9))


def test_a_wild_load_of_ten_entries_becomes_one_that_exists() -> None:
    x, P = ca.SX.sym("x", 10), ca.SX.sym("P", 10, 10)
    entries = LoadEntries("P", tuple(range(10)), None)
    near = ca.Function("f", [x, P], [entries.consistent(x, P, entries.scales(2.0, 0.1), 0.1)])
    rng = np.random.default_rng(2)
    for _ in range(20):
        root = rng.standard_normal((10, 10))
        found = np.array(near(rng.standard_normal(10), root @ root.T)).ravel()
        assert consistency(found) > 0
    known = LOAD / np.array(entries.scales(2.0, 0.1))
    kept = np.array(near(known, 1e-8 * np.eye(10))).ravel()
    assert np.allclose(kept, LOAD, atol=1e-5)


def test_bad_cycles_say_so_and_leave_estimates_alone() -> None:
    model, graph = robot("clavel-delta3")
    run = running(model, 500, slice(100, 500), noise=0.1)
    q, qd, tau = run.q.copy(), run.qd.copy(), run.tau.copy()
    q[300] = np.nan
    qd[310, 1] = np.inf
    tau[320, 0] = -np.inf
    q[330:340] = (3.0, -3.0, 3.0)
    y = outputs(graph, replace(run, q=q, qd=qd, tau=tau), run.held)
    bad = np.zeros(500, dtype=bool)
    bad[[300, 310, 320, *range(330, 340)]] = True
    assert np.flatnonzero(y["status"][:, 0]).tolist() == [300, 310, 320]
    assert np.flatnonzero(y["skipped"][:, 0]).tolist() == list(range(330, 340))
    assert np.isfinite(y["state"]).all()
    assert y["held"][bad].all()
    assert np.abs(y["load"][330:340] - y["load"][329]).max() < 1e-6
    assert abs(y["load"][-1, 0] - 1.0) < 0.1


@pytest.mark.parametrize("name", swept(["clavel-delta3", "irb360-6-1600"], "clavel-delta3"))
def test_at_rest_nothing_is_learnt_and_nothing_grows(name: str) -> None:
    """Friction at rest may take any torque within its bounds."""
    model, graph = robot(name)
    run = running(model, 3000, slice(0, 0))
    still = replace(run, q=run.q[:1].repeat(3000, 0), qd=0 * run.qd)
    g = model.dynamics.terms(run.q[:1], 0 * run.qd[:1]).g
    tau = g + 0.3 * np.random.default_rng(0).standard_normal((1, g.shape[1]))
    y = outputs(graph, replace(still, tau=tau.repeat(3000, 0)))
    assert np.isfinite(y["state"]).all()
    assert not y["held"].any()
    friction, first = y["friction"], y["friction"][0]
    assert np.abs(friction / first - 1).max() < 0.05


def test_torques_at_their_limits_say_little() -> None:
    model, graph = robot("irb360-6-1600")
    run = running(model, 300, slice(0, 0))
    limit = model.robot.drive_limits["drive1"].effort
    assert limit is not None
    tau = run.tau.copy()
    tau[150:180, 0] = limit
    y = outputs(graph, replace(run, tau=tau))
    assert np.isfinite(y["state"]).all()
    assert y["held"][150:180].sum() == 0


def test_covariances_stay_between_nothing_and_the_prior() -> None:
    model, graph = robot("irb360-6-1600")
    run = running(model, 700, slice(200, 500), noise=0.3)
    y = outputs(graph, run, run.held)
    n = graph.state.places["x"].stop - graph.state.places["x"].start
    for k in (0, 199, 201, 350, 499, 501, 699):
        P = np.zeros((n, n))
        P[np.triu_indices(n)] = y["state"][k, graph.state.places["P"]]
        P = P + np.triu(P, 1).T
        values = np.linalg.eigvalsh(P)
        assert values[0] > -1e-9
        assert np.diag(P).max() < 1 + 1e-9


def test_noise_of_speeds_does_not_make_loads_lighter() -> None:
    """Momentum and the load's columns have the same noise, as errors in variables have."""
    model, _ = robot("clavel-delta3")
    graph = step_graph(model, replace(QUIET, unmodelled=(1.0,) * 3))
    run = running(model, 900, slice(100, 900))
    noise = 0.005 * np.random.default_rng(4).standard_normal(run.qd.shape)
    y = outputs(graph, replace(run, qd=run.qd + noise), run.held)
    assert np.abs(y["load"][-1, 0] - 1.0) < 0.03


def test_torques_that_are_held_act_until_the_next_cycle() -> None:
    """Along the motion's own torque, what is held for a cycle is its mean over that cycle."""
    model, _ = robot("clavel-delta3")
    fine = running(model, 2401, slice(400, 2401), rate=4000.0)
    mean = np.stack([fine.tau[k : k + 2400].reshape(600, 4, 3).mean(1) for k in (0, 1)]).mean(0)
    z, q, qd, held = (x[:2400:4] for x in (fine.z, fine.q, fine.qd, fine.held))
    run = type(fine)(z, q, qd, mean, held)
    found = {}
    for torque in ("held", "sampled"):
        y = outputs(step_graph(model, replace(QUIET, torque=torque)), run, run.held)
        assert np.abs(y["load"][300:, 0] - 1.0).max() < 0.015
        found[torque] = np.abs(y["residual"][20:95]).max()  # empty, the model is exact
    assert found["sampled"] > 3 * found["held"]


def test_what_a_change_did_to_other_estimates_is_taken_back() -> None:
    """A load that is found late leaves the friction where it was."""
    model, graph = robot("clavel-delta3")
    run = running(model, 500, slice(300, 500), noise=0.05)
    y = outputs(graph, run)
    empty = outputs(graph, running(model, 500, slice(0, 0), noise=0.05))
    found = int(np.argmax(y["held"][:, 0] > 0))
    assert 300 < found < 400
    size = model.p[model.layout.friction]
    off = np.abs(y["friction"] - empty["friction"]) / size
    assert off[found - 1].max() > 0.2
    assert off[-1].max() < 0.15
    assert abs(y["load"][-1, 0] - 1.0) < 0.1


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
