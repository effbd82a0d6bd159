"""Motions within a robot's limits that a recording is compared with, each with what it tells."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.information import Information, gather_samples
from deltaid.motion.random_motion import random_motion

_SAMPLES, _PERIOD, _SLOWER = 400, 10.0, 20.0
# Random motions that together are what is usual.
_USUAL = 3


@dataclass(frozen=True, eq=False)
class Candidate:
    """A motion.

    Attributes:
        words: what to record, as a cure says it.
        information: what it tells, without torques.
        q: drive coordinates along it [rad or m].
        largest: largest torque of each drive, by the prior [N m or N].
    """

    words: str
    information: Information
    q: Float[np.ndarray, "samples dof"]
    largest: Float[np.ndarray, " dof"]


@lru_cache(maxsize=8)
def candidates(dynamics: Dynamics) -> tuple[Candidate, ...]:
    """The usual motion of all coordinates, as fast as limits allow; then special ones.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    task = dynamics.robot.task
    rng, time = np.random.default_rng(0), np.linspace(0.0, _PERIOD, _SAMPLES)
    runs = [random_motion(dynamics.kinematics, rng, period=_PERIOD) for _ in range(_USUAL)]
    states = [run.evaluate(time) for run in runs]
    z, zd, zdd = (np.concatenate(parts) for parts in zip(*states, strict=True))

    def only(chosen: list[int], pace: float = 1.0) -> tuple[np.ndarray, ...]:
        """Some of the coordinates move, the others rest in the middle."""
        moving = np.isin(np.arange(dynamics.dof), chosen)
        home = dynamics.kinematics.home
        return np.where(moving, z, home), zd * moving * pace, zdd * moving * pace**2

    everything = list(range(dynamics.dof))
    found = [_candidate(dynamics, "motions of all drives as fast as the limits allow", z, zd, zdd)]
    slow = only(everything, 1 / _SLOWER)
    words = "a slow motion through poses all over the workspace"
    found.append(_candidate(dynamics, words, *slow))
    if len(task.axes) > 1:
        for k, axis in enumerate(task.axes):
            name = ("along x", "along y", "up and down")[axis]
            words = f"fast strokes {name}"
            found.append(_candidate(dynamics, words, *only([k])))
    if task.turn is not None and task.axes:
        turning = only([task.turn])
        words = "fast turns of the tool while the platform rests"
        found.append(_candidate(dynamics, words, *turning))
    return tuple(found)


def _candidate(
    dynamics: Dynamics, words: str, z: np.ndarray, zd: np.ndarray, zdd: np.ndarray
) -> Candidate:
    q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, prior_parameters(dynamics.robot))
    largest = np.abs(tau).max(axis=0)
    return Candidate(words, gather_samples(dynamics, z, qd, qdd, tau), q, largest)
