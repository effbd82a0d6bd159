"""Packing cycles: 25-305-25 mm to and fro, and picks from a moving belt.

A cycle is a list of places with times, joined by straight lines and smoothed by a Gaussian, similar
to a path planner with blended corners and bounded jerk.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from deltaid.robot.description import RobotDescription
from drives.robots import Machine, on_path
from oracle.tree import Array
from plants import GRID, oracle_of

# Standard deviation of the smoothing of corners (s); lift and width of a cycle (m).
_SMOOTH, _LIFT, _WIDTH = 0.03, 0.025, 0.305
# Picks per round; speed of the belt (m/s); time for which the robot follows it (s).
_PICKS, _BELT, _FOLLOWED = 4, 0.3, 0.15

Places = tuple[Array, Array, float]


def adept(rng: np.random.Generator) -> Places:
    """Times, places (x, y, up, turn) and period: up 25 mm, 305 mm across, down, a quarter turn; and
    back."""
    half, stand = rng.uniform(0.26, 0.42), rng.uniform(0.02, 0.06)
    lift, across = 0.2 * half, 0.75 * half
    times = np.array([stand, stand + lift, across, half])
    there, high, over, back = [-1, 0, 0, -1], [-1, 0, 1, -1], [1, 0, 1, 1], [1, 0, 0, 1]
    angle = rng.uniform(0, np.pi)
    places = np.array([there, high, over, back, back, over, high, there], float)
    x = 0.5 * _WIDTH * places[:, 0]
    out = np.column_stack([np.cos(angle) * x, np.sin(angle) * x, _LIFT * places[:, 2],
                           0.25 * np.pi * places[:, 3]])  # fmt: skip
    return np.concatenate([times, half + times]), out, 2 * half


def conveyor(rng: np.random.Generator) -> Places:
    """Picks from a belt along x, which the robot follows, to places in rows of a box."""
    times, places, now = list[float](), list[tuple[float, ...]](), 0.0
    for k in range(_PICKS):
        x, y = rng.uniform(-0.12, 0.02), 0.14 + rng.uniform(-0.04, 0.04)
        end, turn = x + _BELT * _FOLLOWED, rng.uniform(-0.7, 0.7)
        box_x, box_y = 0.05 * (k % 3 - 1), -0.16 + 0.05 * (k // 3)
        for wait, *place in (
            (0.06, x, y, 0.0, turn), (_FOLLOWED, end, y, 0.0, turn), (0.06, end, y, 0.05, turn),
            (0.24, box_x, box_y, 0.05, 0.0), (0.06, box_x, box_y, 0.0, 0.0),
            (0.08, box_x, box_y, 0.0, 0.0), (0.06, box_x, box_y, 0.05, 0.0),
        ):  # fmt: skip
            now += wait
            times.append(now)
            places.append(tuple(place))
        now += 0.24
    return np.array(times), np.array(places), now


MOTIONS = {"adept": adept, "conveyor": conveyor}


def cycling(robot: RobotDescription, p: Array, motion: str, seed: int) -> Machine:
    """A robot with parameters p on one of these motions at a random place in its workspace."""
    rng = np.random.default_rng([seed, len(motion)])
    times, places, period = MOTIONS[motion](rng)
    grid = np.arange(GRID) * (period / GRID)
    lines = np.column_stack([np.interp(grid, times, x, period=period) for x in places.T])
    moved = gaussian_filter1d(lines, _SMOOTH * GRID / period, axis=0, mode="wrap", truncate=8.0)
    centre, half = robot.within(0.0)
    turn, oracle = robot.task.turn, oracle_of(robot, p)
    offset = rng.uniform(-0.5, 0.5, len(centre))
    for size in 0.9 ** np.arange(30):
        path = np.tile(centre + 0.5 * size * offset * half, (GRID, 1))
        path[:, :3] += size * moved[:, :3]
        if turn is not None:
            path[:, turn] = centre[turn] + moved[:, 3]
        flat = np.abs(path[:, :3] - centre[:3]) <= half[:3]
        if np.all(flat) and np.all(np.isfinite(oracle.positions(path))):
            return on_path(robot, p, path, period, 1000.0, rng)
    raise AssertionError(f"no {motion} for {robot.name}")
