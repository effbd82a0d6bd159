"""The catalogue's kinds of robots, an example's, motions, differences, comparisons of arrays."""

from pathlib import Path

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.user_code import use_mechanism
from deltaid.motion.random_motion import random_motion
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from plants import Truth

# The catalogue's robots that stand for a mechanism each; tests that take long run on these alone.
# Its machines (tests/test_catalogue.py) are of the same mechanisms, with other numbers.
KINDS = (
    "clavel-delta3", "h4", "h4-linear", "i4", "i4-linear", "irb360-6-1600", "linear-delta",
    "linear-delta-45", "par4", "par4-linear",
)  # fmt: skip


def example(name: str) -> RobotDescription:
    """A robot of the examples whose mechanism is a Python file."""
    folder = Path(__file__).resolve().parents[1] / "examples" / name
    use_mechanism(folder / "mechanism.py")
    return load_robot(folder / "robot.yaml")


def along(
    kinematics: Kinematics, rng: np.random.Generator, time: np.ndarray | int, **options: float
) -> tuple[np.ndarray, ...]:
    """z, q, q̇, q̈ along a random motion at some times, or at so many of its period."""
    motion = random_motion(kinematics, rng, **options)
    if isinstance(time, int):
        time = np.linspace(0, motion.period, time, endpoint=False)
    z, zd, zdd = motion.evaluate(time)
    return z, *kinematics.drive_motion(z, zd, zdd)


# Central differences of fourth order: steps and weights of f'(0) h.
_STEPS, _WEIGHTS = (-2, -1, 1, 2), (1 / 12, -8 / 12, 8 / 12, -1 / 12)


def slope(f, x: np.ndarray, along: np.ndarray, h: float = 1e-4) -> np.ndarray:
    """Derivative of f at x in the direction `along`, by central differences of fourth order."""
    terms = [w * f(x + s * h * along) for s, w in zip(_STEPS, _WEIGHTS, strict=True)]
    return np.sum(terms, axis=0) / h


def assert_close(actual: np.ndarray, expected: np.ndarray, share: float) -> None:
    """Every entry within a share of the largest one."""
    np.testing.assert_allclose(actual, expected, rtol=0, atol=share * np.abs(expected).max())


def largest_mass_error(M: np.ndarray, true: np.ndarray) -> float:
    """Largest |ΔM_ij| / √(M_ii M_jj) of mass matrices, (states, drives, drives)."""
    return float(np.max(np.abs(M - true) / np.sqrt(np.einsum("sii,sjj->sij", true, true))))


def assert_torques(
    robot: RobotDescription, truth: Truth, p: np.ndarray, since: float = -np.inf
) -> None:
    """The package has the truth's torques from a time on, while all joints move."""
    moving = np.all(truth.rates != 0, axis=1) & (truth.time > since)
    q, qd, qdd, tau = (x[moving] for x in (truth.q, truth.qd, truth.qdd, truth.tau))
    assert_close(compiled(robot).inverse_dynamics(q, qd, qdd, p), tau, 1e-5)
