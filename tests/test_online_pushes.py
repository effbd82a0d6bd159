"""Weak pushes for a minute: they are no noise, and a stronger one is found as before."""

import numpy as np

import deltaid
from deltaid.online.contact import least_force, threshold
from deltaid.online.settings import OnlineSettings
from shuttling import RATE, Shuttle, shuttle

# Seconds without pushes, with weak ones, with strong ones; a push lasts so many rows.
QUIET, WEAK, STRONG, PUSH = 90, 60, 30, 100
# By which the reported limit may grow.
MOST = 1.3


def produced(
    robot: Shuttle, seconds: float, forces: tuple[float, float], seed: int
) -> tuple[np.ndarray, ...]:
    """q, torques, gripper and rows of pushes [N], one a second, of picks with friction that the
    model has not: 20 % of Coulomb more, Stribeck and ripple."""
    rng, rows = np.random.default_rng(seed), len(robot.q)
    count = round(seconds * RATE / rows)
    q, tau, held = robot.rounds(np.exp(rng.uniform(np.log(0.05), 0.0, count)))
    qd = RATE * np.gradient(robot.q, axis=0)
    lacked = 0.2 + 0.3 * np.exp(-((qd / 0.3) ** 2))
    tau += np.tile(robot.coulomb * (robot.sign * lacked + 0.1 * np.sin(12 * robot.q)), (count, 1))
    kinematics = robot.model.dynamics.kinematics
    starts = np.arange(500, len(q) - 500, 1000)
    starts += rng.integers(0, 400, len(starts))
    for first in starts if max(forces) else ():
        force = rng.standard_normal(3)
        force *= rng.uniform(*forces) / np.linalg.norm(force)
        for k in range(first, first + PUSH):
            z = kinematics.forward(robot.q[k % rows])
            tau[k] -= np.linalg.solve(kinematics.jacobian(z).T, force)
    return q, tau, held, starts


def test_a_minute_of_weak_pushes_does_not_make_it_deaf() -> None:
    """With speeds of unknown noise, where how large residuals are is learnt."""
    robot, noise = shuttle(), np.random.default_rng(9)
    settings = OnlineSettings(speed="differenced", largest_mass=1.0)
    online, limits = deltaid.Online(robot.model, settings), []
    u = threshold(settings.false_alarms, settings.corner, 3)
    for seed, (seconds, *forces) in enumerate(((QUIET, 0, 0), (WEAK, 5, 15), (STRONG, 30, 30))):
        q, tau, held, starts = produced(robot, seconds, (forces[0], forces[1]), seed)
        tau += online.known.noise * noise.standard_normal(tau.shape)
        found = online.run(q, None, tau, held)
        information = found.outputs["contact_information"][-6000:].reshape(-1, 3, 3)
        limits.append(np.median(least_force(information, u), axis=1))
        if not forces[0]:
            assert not found.contact.any()
        soon = [found.contact[first : first + 20].any() for first in starts]
        assert forces[1] < 30 or np.mean(soon) >= 0.9  # at rest friction takes up a push
    assert np.all(limits[1] <= MOST * limits[0])
