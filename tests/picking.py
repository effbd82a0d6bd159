"""A short recording of a robot that holds loads and is pushed, and a model of the robot.

Drives follow their motion whatever happens, so torques show at once what a load or a push takes.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.checks.identify import identify
from deltaid.dynamics.dynamics import compiled
from deltaid.model.model import Model, load
from deltaid.model.settings import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.online.watch import Watched
from deltaid.robot.load import load_robot
from logs import tabled

RATE, NOISE = 1000.0, 0.02
MASS, CENTRE = 0.8, (0.0, 0.0, -0.04)
HELD = ((2.0, 5.0), (6.5, 8.5))
# From when to when, drive (None: the platform), force or torque.
PUSHES = ((3.5, 3.6, None, (25.0, -15.0, 5.0)), (7.5, 7.62, 1, (8.0,)))
SETTINGS = Settings(
    friction="described", events=False, lag="none", compliance="none", effects="none"
)


@dataclass(frozen=True, eq=False)
class Picked:
    """A model, and a recording with the truth behind it."""

    model: Model
    table: pl.DataFrame


@cache
def picked() -> Picked:
    """Identify Clavel's Delta, and record it for ten seconds with loads and pushes."""
    robot, rng = load_robot("clavel-delta3"), np.random.default_rng(4)
    dynamics, p = compiled(robot), surrogate_parameters(robot, rng)
    motions = [random_motion(dynamics.kinematics, rng, period=5.0) for _ in range(2)]
    known = simulate_recording(
        dynamics, p, motions[0], rng, duration=12.0, rate=RATE, noise=SensorNoise()
    )
    model = load(identify(robot, known, settings=SETTINGS, force=True))
    time = np.arange(10 * int(RATE)) / RATE
    z, zd, zdd = motions[1].evaluate(time)
    q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, p)
    noise = NOISE * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    heavy = Model(robot, p, robot.name).with_load(_load()).p
    held = np.any([(time >= a) & (time < b) for a, b in HELD], axis=0)
    tau[held] = dynamics.torque(z[held], qd[held], qdd[held], heavy)
    J = dynamics.kinematics.jacobian(z)
    for start, end, drive, size in PUSHES:
        for k in np.flatnonzero((time >= start) & (time < end)):
            if drive is None:
                tau[k] -= np.linalg.solve(J[k].T, np.array(size))
            else:
                tau[k, drive] -= size[0]
    return Picked(model, tabled(t=time, q=q, tau=tau + noise, gripper=held.astype(int)))


def assert_as_it_was(found: Watched) -> None:
    """Loads and pushes are those that it was recorded with."""
    assert [load.mass.value for load in found.loads] == pytest.approx([MASS, MASS], abs=0.02)
    assert [load.start for load in found.loads] == pytest.approx([a for a, _ in HELD], abs=2e-3)
    assert len(found.touches) == len(PUSHES)
    for touch, (start, _, drive, _) in zip(found.touches, PUSHES, strict=True):
        assert start < touch.start < start + 0.01
        assert touch.place == ("platform" if drive is None else f"drive{drive + 1}")


def write_picked(folder: Path) -> None:
    """Write `model.yaml` and `production.csv`."""
    found = picked()
    folder.mkdir(exist_ok=True)
    found.model.identified.save(folder / "model.yaml")
    found.table.write_csv(folder / "production.csv")


def _load() -> np.ndarray:
    c = np.array(CENTRE)
    second = MASS * (1e-4 * np.eye(3) + c @ c * np.eye(3) - np.outer(c, c))
    return np.array([MASS, *(MASS * c), *np.diag(second), second[0, 1], second[1, 2], second[0, 2]])
