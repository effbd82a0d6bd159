"""How often the reported 95 % intervals contain the truth, over many seeds of noise.

Torques are linear in their noise, so all seeds are gathered in one pass: true torques and each
noise stand in columns of their own beside the regressor. What is gathered is what so many
recordings would have given, and goes the users' way from there.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.signal import lfilter

from courses import Courses
from deltaid.dynamics.dynamics import compiled
from deltaid.estimation.additions import extended
from deltaid.estimation.base_parameters import base_parameters
from deltaid.estimation.information import Information, merge
from deltaid.estimation.scatter import Noise, inverse
from deltaid.identification.gathering import Gathered, gather_all
from deltaid.identification.least_squares import BaseEstimate, estimate_base
from deltaid.motion.surrogate import SensorNoise, surrogate_parameters
from deltaid.recording.recording import open_recordings
from deltaid.robot.load import load_robot
from logs import tabled
from sensed import motion
from support import along

RATE = 1000.0
KINDS = ("white", "coloured", "ripple")
Run = Callable[[str], tuple[np.ndarray, ...]]
ROBOTS = ("irb360-6-1600", "clavel-delta3")


def optimised(name: str) -> tuple[np.ndarray, ...]:
    """t, z, q, q̇, q̈ of the run that `deltaid excite` gives."""
    return motion(name, RATE)


@cache
def wandering(name: str) -> tuple[np.ndarray, ...]:
    """The same of a random motion, three times around: it goes by no optimiser's version."""
    time = np.arange(int(9 * RATE)) / RATE
    kinematics = compiled(load_robot(name)).kinematics
    return time, *along(kinematics, np.random.default_rng(0), time, period=3.0)


def noises(kind: str, seeds: int, q: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Noise of all seeds as a share of each drive's largest torque, (seeds, dof, samples)."""
    noise = rng.standard_normal((seeds, *q.T.shape))
    if kind == "white":
        return SensorNoise().torque * noise
    if kind == "coloured":  # first order, with a memory of 20 ms
        memory = np.exp(-1 / (0.020 * RATE))
        return 0.02 * lfilter([np.sqrt(1 - memory**2)], [1, -memory], noise)
    assert kind == "ripple"  # three orders a revolution in each drive, with random phases
    noise *= 0.02
    for _ in range(3):
        order = rng.integers(6, 60, (seeds, q.shape[1], 1))
        phase = rng.uniform(0, 2 * np.pi, order.shape)
        noise += 0.01 * np.sin(order * q.T + phase)
    return noise


def estimates(
    name: str, kind: str, seeds: int, run: Run = optimised
) -> tuple[np.ndarray, list[BaseEstimate]]:
    """True base parameters of a catalogue robot, and the estimate of each seed of noise."""
    dynamics, rng = compiled(load_robot(name)), np.random.default_rng(1)
    time, z, q, qd, qdd = run(name)
    p = surrogate_parameters(dynamics.robot, rng)
    tau = dynamics.torque(z, qd, qdd, p).T
    noise = noises(kind, seeds, q, rng) * np.abs(tau).max(axis=1)[:, None]
    step = SensorNoise().encoder_step
    log = tabled(t=time, q=np.round(q / step) * step, tau=tau.T)
    recordings = open_recordings(log, dynamics.kinematics)
    wide = extended(dynamics, [Courses(dynamics, np.concatenate([tau[None], noise]), RATE)])
    gathered = gather_all(wide, recordings)
    limits = np.abs(tau).max(axis=1)
    base, found = None, []
    for seed in range(seeds):
        groups = recorded(gathered, seed, seeds, limits)
        information = merge(groups.blocks)
        base = base or base_parameters(information, dynamics.layout)
        found.append(estimate_base(base, information, groups=groups))
    return base.combination() @ p, found


def recorded(groups: Gathered, seed: int, seeds: int, torque_max: np.ndarray) -> Gathered:
    """Groups of the recording with the noise of one seed: τ is the true torque plus its noise."""
    n, own = len(groups.blocks[0].columns) - 1 - seeds, groups.blocks[0].columns
    blocks = []
    for block in groups.blocks:
        # Triangular: what the torque has below row n no column of Y has, so it makes one more row.
        factors = block.factors[:, : n + 1, : n + 1].copy()
        tau = block.factors[:, :, n] + block.factors[:, :, n + 1 + seed]
        factors[:, :n, n], factors[:, n, n] = tau[:, :n], np.linalg.norm(tau[:, n:], axis=1)
        blocks.append(Information(own[:n], factors, block.samples, torque_max))
    places = groups.places[:, :, : n + 1, : n + 1].copy()
    noise = groups.places[:, :, : n + 2 + seed, n + 1 + seed]
    places[..., :n, n] += noise[..., :n]
    places[..., n, :n] = places[..., :n, n]
    places[..., n, n] += 2 * noise[..., n] + noise[..., -1]
    return Gathered((tuple(blocks),), places, merge(blocks))


def covered(truth: np.ndarray, found: list[BaseEstimate]) -> np.ndarray:
    """Share of seeds in which each base parameter's interval contains the truth."""
    return np.mean([np.abs(e.values - truth) <= e.interval for e in found], axis=0)


def covered_by_white_formula(truth: np.ndarray, found: list[BaseEstimate]) -> np.ndarray:
    """The same with the intervals that white noise would have."""
    share = []
    for e in found:
        white = Noise(e.noise.root, e.noise.sigma, e.noise.freedom)
        std, _ = white.deviations(inverse(e.noise.root).T)
        share.append(np.abs(e.values - truth) <= 1.96 * std)
    return np.mean(share, axis=0)
