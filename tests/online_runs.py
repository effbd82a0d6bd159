"""Robots that run with loads: torques by inverse dynamics, and the cycle as CasADi evaluates it."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from deltaid.model.model import Model, load
from deltaid.online.cycle import step_graph
from deltaid.online.graph import StepGraph
from deltaid.online.instant import UNKNOWN
from deltaid.online.settings import OnlineSettings
from support import along

RATE = 1000.0
# Little noise, for three drives.
QUIET = OnlineSettings(noise=(0.1,) * 3, unmodelled=(0.1,) * 3, largest_mass=3.0)
# A load of 1 kg that is consistent and has no symmetry.
LOAD = np.array([1.0, 0.03, -0.02, 0.05, 0.006, 0.007, 0.005, 0.0006, 0.001, -0.0015])


@dataclass(frozen=True, eq=False)
class Running:
    """A motion and its torques, and whether the load is held."""

    z: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    held: np.ndarray


@cache
def robot(name: str) -> tuple[Model, StepGraph]:
    """A robot at its prior, and its cycle with little noise."""
    model = load(name)
    dof = model.dynamics.dof
    settings = replace(QUIET, noise=(0.1,) * dof, unmodelled=(0.1,) * dof)
    return model, step_graph(model, settings)


def running(
    model: Model,
    cycles: int,
    held: slice,
    noise: float = 0.0,
    load: np.ndarray = LOAD,
    rate: float = RATE,
    period: float = 3.0,
) -> Running:
    """Along a random motion, with a load held in some of the cycles."""
    rng, dynamics = np.random.default_rng(6), model.dynamics
    z, q, qd, qdd = along(dynamics.kinematics, rng, np.arange(cycles) / rate, period=period)
    tau, holds = dynamics.torque(z, qd, qdd), np.zeros(cycles, dtype=bool)
    holds[held] = True
    loaded = model.with_load(load).p
    tau[held] = dynamics.torque(z[held], qd[held], qdd[held], loaded)
    return Running(z, q, qd, tau + noise * rng.standard_normal(tau.shape), holds)


def outputs(
    graph: StepGraph, run: Running, gripper: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """All outputs by name, and the states, cycle by cycle."""
    signal = np.full(len(run.q), UNKNOWN) if gripper is None else gripper.astype(float)
    return outputs_of(graph, run.q, run.qd, run.tau, signal)


def outputs_of(graph: StepGraph, *inputs: np.ndarray) -> dict[str, np.ndarray]:
    """Of rows without stamps."""
    u = np.column_stack([*inputs, np.full(len(inputs[0]), UNKNOWN)])
    states, y = graph.function.mapaccum(len(u))(graph.state.initial, u.T)
    return graph.outputs.split(np.array(y).T) | {"state": np.array(states).T}
