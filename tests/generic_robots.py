"""Robots with generic bodies and friction at generic states."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.robot.platform import Telescope
from support import random_states, random_twin


@dataclass(frozen=True, eq=False)
class Case:
    """A robot with generic bodies and friction at generic states inside its workspace."""

    dynamics: Dynamics
    p: np.ndarray
    z: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray


@cache
def case(name: str) -> Case:
    """Three drives, four drives, and four with a bar that hangs off the axis at both ends."""
    twin = random_twin(7, telescope=name != "three drives")
    robot, states = twin.robot, random_states(twin.oracle, np.random.default_rng(8), 20)
    if name == "offset bar":
        bar = Telescope(base_joint=(0.04, -0.03, 0.1), platform_joint=(-0.02, 0.03, 0.05))
        robot = robot.changed(telescope=bar)
    return Case(Dynamics(robot), twin.p, *states)


CASES = ("three drives", "four drives", "offset bar")
every_case = pytest.mark.parametrize("name", CASES)


def generic_states(dynamics: Dynamics, n: int) -> tuple[np.ndarray, ...]:
    """z, q, q̇, q̈ of n random samples within reach of the catalogue's robots."""
    rng, dof = np.random.default_rng(14), dynamics.dof
    z = [0.02, -0.05, -0.98, 0.4] + [0.35, 0.35, 0.12, 3.0] * rng.uniform(-1, 1, (n, 4))
    zd, zdd = ([1, 1, 1, 5] * rng.standard_normal((n, 4)) * scale for scale in (2, 30))
    z, zd, zdd = (x[:, :dof] for x in (z, zd, zdd))
    return z, *dynamics.kinematics.drive_motion(z, zd, zdd)
