"""Poses of hidden machines as instruments read them, for tests of `deltaid calibrate`."""

from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

import deltaid
from oracle.measured_delta import DRAWINGS, BuiltDelta, built
from oracle.tree import Array

CLAVEL, KOSSEL = "clavel-delta3", "anycubic-kossel"
NOISE, POINT = 2e-5, ("px", "py", "pz")
# Of a tracker against the machine.
TURN = Rotation.from_rotvec([0.3, -0.2, 1.0]).as_matrix()


Described = str | deltaid.Kinematics


@cache
def kinematics(robot: Described) -> deltaid.Kinematics:
    return deltaid.Kinematics(robot) if isinstance(robot, str) else robot


def machine(name: str, seed: int, **options: float) -> tuple[BuiltDelta, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return built(rng, DRAWINGS[name], **options), rng


def real(robot: BuiltDelta, name: Described, commanded: Array) -> Array:
    """Where a machine stands that believes in its description."""
    return robot.tool_points(drives(name, commanded), commanded)


def drives(name: Described, commanded: Array) -> Array:
    """Of a description, without the telescope's."""
    described = kinematics(name)
    z = np.tile(described.home, (len(commanded), 1))
    z[:, : commanded.shape[1]] = commanded
    return described.inverse(z)[:, : described.robot.limbs.count]


def tracked(
    name: Described, x: Array, m: Array, rng: np.random.Generator, turn: Array = TURN
) -> dict[str, Array]:
    """Readings of a tracker somewhere."""
    points = m @ turn.T + [1.0, 2.0, 0.5] + rng.normal(0, NOISE, m.shape)
    q = drives(name, x)
    return {f"q{i + 1}": q[:, i] for i in range(q.shape[1])} | dict(
        zip(("px", "py", "pz"), points.T, strict=True)
    )


def touched(
    robot: BuiltDelta, name: Described, places: Array, noise: float, rng: np.random.Generator
) -> dict[str, Array]:
    """Commanded points at which a machine touches planes at heights `places[:, 2]`."""
    x = places.copy()
    for _ in range(5):
        x[:, 2] -= real(robot, name, x)[:, 2] - places[:, 2]
    x[:, 2] += rng.normal(0, noise, len(x))
    return dict(zip("xyz", x.T, strict=True)) | {"block": places[:, 2] - places[:, 2].min()}


def spans(
    robot: BuiltDelta, name: Described, a: Array, b: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Distances between pairs of commanded points."""
    length = np.linalg.norm(real(robot, name, a) - real(robot, name, b), axis=1)
    return {
        f"{end}_{axis}": points[:, k]
        for end, points in (("a", a), ("b", b))
        for k, axis in enumerate("xyz")
    } | {"distance": length + rng.normal(0, NOISE, len(a))}


def measured(folder: Path, seed: int) -> Path:
    """A tracker's points, a bed, the same with a block, and distances of one machine."""
    robot, rng = machine(CLAVEL, seed)
    x = DRAWINGS[CLAVEL].poses(rng, 40)
    pl.DataFrame(tracked(CLAVEL, x, real(robot, CLAVEL, x), rng)).write_csv(folder / "points.csv")
    places = rng.uniform([-0.3, -0.3, -1.05], [0.3, 0.3, -1.05], (30, 3))
    pl.DataFrame(touched(robot, CLAVEL, places, 1e-5, rng)).write_csv(folder / "bed.csv")
    places[15:, 2] += 0.1
    pl.DataFrame(touched(robot, CLAVEL, places, 1e-5, rng)).write_csv(folder / "gauge.csv")
    a, b = DRAWINGS[CLAVEL].poses(rng, 18), DRAWINGS[CLAVEL].poses(rng, 18)
    pl.DataFrame(spans(robot, CLAVEL, a, b, rng)).write_csv(folder / "parts.csv")
    return folder
