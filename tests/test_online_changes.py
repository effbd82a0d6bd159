"""What a cycle makes of measured signals, of a load that nobody told, and of what a model lacks."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from deltaid.dynamics.parameters import prior_parameters
from deltaid.model.model import Model
from deltaid.online.changes import Change, Onset, estimate_after
from deltaid.online.cycle import contact_of, step_graph
from deltaid.online.estimates import friction_bounds
from deltaid.online.graph import StepGraph
from deltaid.online.kalman import Estimate
from deltaid.online.settings import OnlineKnowledge, OnlineSettings, knowledge
from deltaid.robot.load import load_robot
from online_runs import LOAD, QUIET, Running, outputs, outputs_of, robot, running

ONE, NONE = ca.SX(1), ca.SX(0)


@pytest.mark.parametrize("free", [0.0, 0.1], ids=["empty", "held"])
def test_other_estimates_are_those_of_a_filter_that_knew(free: float) -> None:
    """Friction that was blamed for a load is what it would be had the load been taken off.

    A load that was held before, known to a variance, took a part of the change already.
    """
    rng, noise, mass = np.random.default_rng(0), ca.SX(0.01), 2.0
    shown, friction = rng.uniform(0.2, 0.6, 60), 0.3
    start = Estimate(ca.SX.zeros(2), ca.diag(ca.SX([free, 1.0])))
    blamed = knew = start
    onset = Onset(ca.SX.zeros(2), NONE, NONE, NONE, NONE)
    for k, psi in enumerate(shown):
        row, load = ca.SX([[psi, 1.0]]), mass * psi * (k >= 30)
        y = friction + load + 0.1 * rng.standard_normal()
        blamed, update = blamed.measured(row, ca.SX(y), noise, ONE)
        knew, _ = knew.measured(row, ca.SX(y - load), noise, ONE)
        if k >= 30:
            onset = onset.measured(0, ca.SX(psi), update)
    other = Change(changed=ONE, held=ONE, signalled=NONE, detected=ONE)
    found = estimate_after(blamed, onset, other, 1)
    wrong, right, mended = (float(ca.evalf(estimate.x)[1]) for estimate in (blamed, knew, found))
    assert abs(wrong - right) > 0.1
    assert (abs(float(ca.evalf(blamed.x)[0])) > 0.2 * mass) == (free > 0)
    assert abs(mended - right) < 0.1 * abs(wrong - right)
    assert abs(float(ca.evalf(found.x)[0]) - mass) < 0.1 * mass


def test_what_is_lighter_than_empty_is_no_release() -> None:
    """Torques of less than the empty robot's are no load that was put down."""
    model, graph = robot("clavel-delta3")
    run, empty = running(model, 400, slice(200, 400)), running(model, 400, slice(0, 0))
    run.tau[:] = 2 * empty.tau - run.tau
    y = outputs(graph, run)
    assert y["change_score"].min() < -10
    assert not y["changed"].any()
    assert not y["held"].any()


def test_a_gripper_that_takes_time_is_waited_for() -> None:
    """And a signal that is gone before that time is none."""
    model, _ = robot("clavel-delta3")
    graph = step_graph(model, OnlineSettings(largest_mass=3.0, grip_time=0.05))
    run = running(model, 300, slice(150, 300))
    signal = (np.arange(300) >= 100) | ((np.arange(300) >= 20) & (np.arange(300) < 60))
    held = outputs(graph, run, signal)["held"][:, 0]
    assert not held[:149].any()
    assert held[151:].all()


def test_a_load_of_which_a_part_is_put_down_is_still_held() -> None:
    model, graph = robot("clavel-delta3")
    whole, part = (running(model, 900, slice(200, 900), 0.05, x * LOAD) for x in (2.0, 1.4))
    run = replace(whole, tau=np.where(np.arange(900)[:, None] < 550, whole.tau, part.tau))
    y = outputs(graph, run)
    assert y["held"][540, 0] == 1
    assert y["load"][540, 0] == pytest.approx(2.0, abs=0.2)
    assert y["held"][550:].all()
    assert y["load"][-1, 0] == pytest.approx(1.4, abs=0.15)


CYCLES = 4000


def lacking(run: Running, known: OnlineKnowledge, falling: float, carried: float) -> Running:
    """With friction that the model has not: more at low speed, and a share of the torque."""
    slow = np.exp(-((run.qd / known.slow_speed) ** 2))
    more = falling * known.unmodelled_slow * slow + carried * np.abs(run.tau)
    return replace(run, tau=run.tau + np.sign(run.qd) * more)


@pytest.fixture(scope="module")
def delta() -> tuple[Model, StepGraph, OnlineKnowledge, Running]:
    model, graph = robot("clavel-delta3")
    run = running(model, CYCLES, slice(0, 0), noise=0.1, period=6.0)
    return model, graph, knowledge(model, OnlineSettings()), run


@pytest.mark.parametrize(("falling", "carried"), [(1.0, 0.02), (-0.8, 0.03), (0.0, 0.0)])
def test_friction_that_a_model_has_not_is_found(
    delta: tuple[Model, StepGraph, OnlineKnowledge, Running], falling: float, carried: float
) -> None:
    _, graph, known, run = delta
    y = outputs(graph, lacking(run, known, falling, carried), np.zeros(CYCLES))
    first = len(known.entries.shown) + known.directions.shape[1] + len(known.followed)
    state = graph.state.split(y["state"][-1])
    n = state["x"].size
    P = np.zeros((n, n))
    P.T[np.triu_indices(n)] = state["P"]
    x, std = state["x"][first : first + 2], np.sqrt(np.diag(P)[first : first + 2])
    off = x - np.array([falling, carried / 0.03])
    assert np.all(np.abs(off) < 3 * std)
    assert std[0] < 0.3
    assert std[1] < 0.7


def test_how_much_a_model_lacks_is_learnt(
    delta: tuple[Model, StepGraph, OnlineKnowledge, Running],
) -> None:
    _, graph, _, run = delta
    t = np.arange(CYCLES)[:, None] / 1000.0
    pulled = replace(run, tau=run.tau + 3.0 * np.sin(2 * np.pi * 5.0 * t + np.arange(3)))
    levels = [
        outputs(graph, result, np.zeros(CYCLES))["state"][-1, graph.state.places["moving_level"]]
        for result in (run, pulled)
    ]
    assert np.all(levels[0] < 0.98)
    assert np.all(levels[1] > 1.3)


@pytest.mark.parametrize("early", [0, 4])
def test_taking_and_leaving_a_load_is_no_contact(early: int) -> None:
    """Also where the gripper opens some milliseconds before the load is gone."""
    model, _ = robot("clavel-delta3")
    graph = step_graph(model, QUIET, more=(contact_of,))
    run = running(model, 600, slice(250, 400), noise=0.1)
    y = outputs(graph, run, np.roll(run.held, -early))
    assert not np.any(y["contact"])
    late = outputs(graph, run, np.zeros(600))
    assert np.any(late["contact"][250:290])


def test_noise_of_speeds_that_nobody_stated_is_learnt() -> None:
    """From positions in steps, speeds have noise, and it is no contact."""
    model, _ = robot("clavel-delta3")
    graph = step_graph(model, replace(QUIET, speed="differenced"), more=(contact_of,))
    run = running(model, CYCLES, slice(0, 0), noise=0.1)
    y = outputs_of(graph, np.round(run.q / 2e-5) * 2e-5, run.tau, np.zeros(CYCLES))
    assert not np.any(y["contact"])
    assert 1 / 3 < np.quantile(y["contact_size"][2000:], 0.99) < 1


def largest_unexplained(torque: str, rate: float) -> float:
    """What of the model's own torques, differenced speeds leave unexplained, largest [N m]."""
    model = robot("clavel-delta3")[0].without_friction()
    n = round(0.2 * rate)
    run = running(model, n + 1, slice(0, 0), rate=rate)
    # What is held from one position to the next is the torque in their middle.
    tau = 0.5 * (run.tau[1:] + run.tau[:-1]) if torque == "held" else run.tau[:n]
    graph = step_graph(model, replace(QUIET, rate=rate, speed="differenced", torque=torque))
    y = outputs_of(graph, run.q[:n], tau, np.zeros(n))
    return float(np.abs(y["residual"][20:]).max())


@pytest.mark.parametrize("torque", ["sampled", "held"])
def test_differenced_speeds_positions_and_torques_are_of_one_instant(torque: str) -> None:
    """The middle between two cycles: what differs is of second order in the period."""
    coarse, fine = largest_unexplained(torque, 1000.0), largest_unexplained(torque, 2000.0)
    assert coarse < 0.01
    assert fine < 0.3 * coarse


def test_friction_that_depends_on_load_is_explained() -> None:
    """Of gears that lose a tenth of what they carry nothing is left while they move."""
    described = load_robot("clavel-delta3")
    laws = {
        drive: type(law)(viscous=2.0, coulomb=1e-6, load=0.1)
        for drive, law in described.friction.items()
    }
    losing = described.changed(friction=laws)
    model = Model(losing, prior_parameters(losing), "losing")
    run = running(model, 400, slice(0, 0))
    left = np.abs(outputs(step_graph(model, QUIET), run, run.held)["residual"])
    # Where a drive has moved for so long that what its filter knows of a slower one is forgotten.
    slow = np.cumsum(np.abs(run.qd) < 0.3, axis=0)
    moved = np.vstack([np.zeros((60, 3), bool), slow[60:] == slow[:-60]])
    assert moved.sum() > 300
    assert left[moved].max() < 0.02


def test_torques_are_what_drives_report_times_their_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    gains, (model, _) = np.array([1.2, 0.8, 1.5]), robot("clavel-delta3")
    run = running(model, 300, slice(100, 300))
    monkeypatch.setattr(Model, "gains", property(lambda _: gains))
    y = outputs(step_graph(model, QUIET), replace(run, tau=run.tau / gains), run.held)
    assert y["load"][-1, 0] == pytest.approx(1.0, abs=0.02)


def test_an_offset_of_friction_near_zero_may_change_its_sign() -> None:
    """It moves by its deviations; coefficients of one sign by a share of themselves."""
    described = load_robot("clavel-delta3")
    law = described.friction["drive2"].changed(offset=0.01)
    offset = described.changed(friction=described.friction | {"drive2": law})
    model = Model(offset, prior_parameters(offset), "offset")
    known = knowledge(model, QUIET)
    low, high = friction_bounds(model, known, 0.3)
    for k, std, down, up in zip(known.followed, known.friction_std, low, high, strict=True):
        value = model.p[k]
        lowest, highest = value + std * down, value + std * up
        if model.layout.names[k] == "offset.drive2":
            assert lowest < -std
            assert highest > std
        else:
            assert (lowest, highest) == pytest.approx((0.7 * value, 1.3 * value))
    assert "offset.drive2" in [model.layout.names[k] for k in known.followed]
