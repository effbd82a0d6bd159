"""What models lack, learnt while a robot runs: friction near rest and by load, and what else."""

from dataclasses import replace

import numpy as np
import pytest

from deltaid.model.model import Model
from deltaid.online.contact_part import contact_of
from deltaid.online.cycle import step_graph
from deltaid.online.graph import StepGraph
from deltaid.online.knowledge import OnlineKnowledge, knowledge
from deltaid.online.settings import OnlineSettings
from online_runs import Running, outputs, robot, running

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
        outputs(graph, one, np.zeros(CYCLES))["state"][-1, graph.state.places["moving_level"]]
        for one in (run, pulled)
    ]
    assert np.all(levels[0] < 0.98)
    assert np.all(levels[1] > 1.3)


@pytest.mark.parametrize("early", [0, 4])
def test_taking_and_leaving_a_load_is_no_contact(early: int) -> None:
    """Also where the gripper opens some milliseconds before the load is gone."""
    model, _ = robot("clavel-delta3")
    settings = OnlineSettings(noise=(0.1,) * 3, unmodelled=(0.1,) * 3, largest_mass=3.0)
    graph = step_graph(model, settings, more=(contact_of,))
    run = running(model, 600, slice(250, 400), noise=0.1)
    y = outputs(graph, run, np.roll(run.held, -early))
    assert not np.any(y["contact"])
    late = outputs(graph, run, np.zeros(600))
    assert np.any(late["contact"][250:290])


def test_noise_of_speeds_that_nobody_told_is_learnt() -> None:
    """From positions in steps, speeds have noise, and it is no contact."""
    model, _ = robot("clavel-delta3")
    settings = OnlineSettings(
        noise=(0.1,) * 3, unmodelled=(0.1,) * 3, largest_mass=3.0, speed="differenced"
    )
    graph = step_graph(model, settings, more=(contact_of,))
    run = running(model, CYCLES, slice(0, 0), noise=0.1)
    u = np.column_stack([np.round(run.q / 2e-5) * 2e-5, run.tau, np.zeros(CYCLES)])
    y = graph.outputs.split(
        np.array(graph.function.mapaccum(CYCLES)(graph.state.initial, u.T)[1]).T
    )
    assert not np.any(y["contact"])
    assert 1 / 3 < np.quantile(y["contact_size"][2000:], 0.99) < 1
