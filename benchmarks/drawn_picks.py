"""Simulated production: robots that pick and place unknown loads, and that somebody pushes.

    log = produced(kind, duration=20.0, seed=2, push=30.0)      # all robots of a kind at once

Plants have bodies and friction away from the description, and friction that no model of theirs
has: it falls with speed (Stribeck), grows with what gears carry, ripples with the angle, is higher
while the robot is cold, and a hose pulls; how much of each, and at what speed, is drawn for each
robot. Each has a model of its own, identified from a recording of it.
The drives follow cycles by feed-forward of that model, without the load, and PD; their torque is
measured with noise and their angle in steps. Friction at rest is that of `ForwardDynamics.step`.

A row of a log is what a drive knows at one instant: angle, and the torque between the one that it
has just held and the one that it sets now.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from _pick_cycles import RATE, Cycles, Pick, Push, draw_cycles, draw_picks, draw_pushes
from _pick_robots import ENCODER, NOISE, Production, Strange, lacking
from jaxtyping import Bool, Float, Int

from deltaid.control.controllers import ControlModel
from deltaid.control.plant import loaded
from deltaid.control.simulation import time_steps
from deltaid.dynamics.dynamics import compiled_as
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.limits import effort_limits
from deltaid.dynamics.task_dynamics import TaskDynamics
from deltaid.kernel.batch import BatchKernel
from deltaid.robot.description import RobotDescription
from plants import friction_of

_BANDWIDTH = 2 * np.pi * 20.0


@dataclass(frozen=True, eq=False)
class Produced:
    """What drives recorded (time, robots, drives), and the truth behind it.

    Attributes:
        q, tau: as measured.
        z: true pose.
        gripper: whether something is held.
        picks, pushes: of each robot.
    """

    time: Float[np.ndarray, " time"]
    q: Float[np.ndarray, "time robots dof"]
    tau: Float[np.ndarray, "time robots dof"]
    z: Float[np.ndarray, "time robots dof"]
    gripper: Bool[np.ndarray, "time robots"]
    picks: list[list[Pick]]
    pushes: list[list[Push]]
    lost: Bool[np.ndarray, " robots"]


def produced(kind: Production, duration: float, seed: int, push: float) -> Produced:
    """Production of all robots at once, from cold gears on; with pushes of a force [N], or zero."""
    models = kind.models
    each = [np.random.default_rng([seed, k]) for k in range(len(models))]
    ways = [
        draw_cycles(m, kind.payload, rng, duration) for m, rng in zip(models, each, strict=True)
    ]
    picks = [draw_picks(w, kind.payload, rng) for w, rng in zip(ways, each, strict=True)]
    pushes = [draw_pushes(m, duration, rng, push) if push else []
              for m, rng in zip(models, each, strict=True)]  # fmt: skip
    n = min(len(w.q) for w in ways)
    return _run(kind, ways, picks, pushes, np.arange(n) / RATE, np.random.default_rng(seed))


class _Plants:
    """Kernels in which every robot has parameters of its own."""

    def __init__(self, robot: RobotDescription) -> None:
        forward = compiled_as(ForwardDynamics, robot)
        e, known = forward.equations, forward._step_kernel  # pyright: ignore[reportPrivateUsage]
        x, p = ca.SX.sym("x", known.n_in), ca.SX.sym("p", known.n_uniform)
        self.step = BatchKernel(ca.vertcat(x, p), known.function(x, p))
        self.coordinates, self.pushed = (BatchKernel(e.z, y) for y in (e.q, _levers(robot, e)))


def _levers(robot: RobotDescription, e: TaskDynamics) -> ca.SX:
    """∂(platform point)/∂q (3 × δ), and the lever of each drive's elbow or carriage."""
    T, moves = e.T, robot.task.moves
    arms = [1.0 if limb.drive == "linear" else limb.upper_arm for limb in robot.limb_geometry]
    return ca.vertcat(ca.vec(ca.densify(T[moves, :])), ca.SX(np.array(arms)))


def _run(
    kind: Production,
    ways: list[Cycles],
    picks: list[list[Pick]],
    pushes: list[list[Push]],
    time: np.ndarray,
    rng: np.random.Generator,
) -> Produced:
    robot, count, n = kind.robot, len(ways), len(time)
    plants, dof = _Plants(robot), len(robot.drives)
    wanted = np.stack([w.q[:n] for w in ways], axis=1)
    speeds = np.stack([w.qd[:n] for w in ways], axis=1)
    ahead = np.stack([m.dynamics.torque(w.z, w.qd, w.qdd, m.p)[:n]
                      for m, w in zip(kind.models, ways, strict=True)], axis=1)  # fmt: skip
    mass = np.stack([ControlModel(robot, m.p).mass_diagonal(w.q[::200])
                     for m, w in zip(kind.models, ways, strict=True)])  # fmt: skip
    stiffness, damping = mass * _BANDWIDTH**2, 2 * mass * _BANDWIDTH
    p, held = _parameters(kind, picks, time)
    forces, limits = _Forces(robot, pushes), effort_limits(robot)
    known = np.stack([friction_of(robot, p)[:, :dof] for p in kind.truth], axis=1)
    strange = Strange.of_many(kind.strange)
    substeps, h = time_steps(RATE)
    z, qd = np.stack([w.z[0] for w in ways]), speeds[0]
    qs, taus, poses = (np.empty((n, count, dof)) for _ in range(3))
    last, rate_of_error, tau = np.zeros_like(qd), np.zeros_like(qd), ahead[0]
    share = 1 - np.exp(-2 * np.pi * 0.2)
    for k in range(n):
        q = plants.coordinates(z.T, threads=1).T
        qs[k], poses[k] = np.round(q / ENCODER) * ENCODER, z
        error = qs[k] - wanted[k]
        rate_of_error += share * ((error - last) * RATE - rate_of_error) if k else 0.0
        last = error
        command = ahead[k] - stiffness * error - damping * rate_of_error
        command = np.clip(command, -limits, limits)
        taus[k] = 0.5 * (tau + command)
        tau = command
        lost = lacking(strange, known, kind.fastest, q, qd, tau, time[k])
        acting = tau - lost + forces.torque_at(time[k], z, plants)
        more = np.hstack([p(k), np.full((count, 1), h)]).T
        for _ in range(substeps):
            out = plants.step(np.vstack([z.T, qd.T, acting.T, more]), threads=1).T
            z, qd = out[:, :dof], out[:, dof:]
    taus += NOISE * kind.largest * rng.standard_normal(taus.shape)
    lost = np.array(~np.isfinite(poses).all(axis=(0, 2)))
    return Produced(time, qs, taus, poses, held >= 0, picks, pushes, lost)


def _parameters(
    kind: Production, picks: list[list[Pick]], time: np.ndarray
) -> tuple[Callable[[int], np.ndarray], Int[np.ndarray, "time robots"]]:
    """Parameters of all plants at sample k, and which pick is held (−1 for none)."""
    held = np.full((len(time), len(picks)), -1)
    for i, of_plant in enumerate(picks):
        for j, pick in enumerate(of_plant):
            held[(time >= pick.start - 1e-9) & (time < pick.end - 1e-9), i] = j
    loads = [np.stack([*(load.p for load in pick), np.zeros(10)]) for pick in picks]
    now = kind.truth.copy()
    before = np.full(len(picks), -1)

    def parameters_at(k: int) -> np.ndarray:
        nonlocal before
        for i in np.flatnonzero(held[k] != before):
            now[i] = loaded(kind.robot, kind.truth[i], loads[i][held[k, i]])
        before = held[k]
        return now

    return parameters_at, held


class _Forces:
    """Pushes as torques of the drives."""

    def __init__(self, robot: RobotDescription, pushes: list[list[Push]]) -> None:
        self._robot = robot
        self._all = sorted(((i, push) for i, plant in enumerate(pushes) for push in plant),
                           key=lambda pair: pair[1].start)  # fmt: skip

    def torque_at(self, time: float, z: np.ndarray, plants: _Plants) -> np.ndarray:
        torque = np.zeros_like(z)
        acting = [(i, push) for i, push in self._all if push.start - 1e-9 <= time < push.end - 1e-9]
        if not acting:
            return torque
        moves, dof = len(self._robot.task.axes), z.shape[1]
        levers = plants.pushed(z.T, threads=1).T
        for i, push in acting:
            if push.place == "platform":
                T = levers[i, : moves * dof].reshape(dof, moves).T
                torque[i] += T.T @ push.force[list(self._robot.task.axes)]
            else:
                j = self._robot.drives.index(push.place)
                torque[i, j] += levers[i, moves * dof + j] * push.force[0]
        return torque
