"""Recordings that many tests look at, each made and identified once a worker.

Ask for one by name: `identified("clavel-delta3")`. Read what you get; a test that changes something
changes a copy (`.changed`, `shutil.copytree(found.folder, tmp_path / "copy")`).
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from deltaid.checks.identify import Judged, identify
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import (
    SensorNoise,
    simulate_recording,
    surrogate_parameters,
    write_recording,
)
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot, save_yaml
from posteriors import stout, truth
from sensed import sensed

RATE, DURATION, NOISE = 500.0, 8.0, 0.02


@dataclass(frozen=True, eq=False)
class Identified:
    """A recording with known truth, and what `deltaid identify` makes of it.

    Attributes:
        robot: as described.
        p: the truth.
        frames: the recordings.
        folder: robot.yaml, log.csv (log-2.csv …) and model.yaml.
        result: model, verdicts and evidence.
    """

    robot: RobotDescription
    p: np.ndarray
    frames: tuple[pl.DataFrame, ...]
    folder: Path
    result: Judged

    @property
    def dynamics(self) -> Dynamics:
        return compiled(self.robot)

    @property
    def log(self) -> Path:
        return self.folder / "log.csv"

    @property
    def model_file(self) -> Path:
        return self.folder / "model.yaml"


def simulated(
    robot: RobotDescription,
    p: np.ndarray,
    seed: int | np.random.Generator,
    noise: float | None = NOISE,
    *,
    duration: float = DURATION,
    rate: float = RATE,
) -> pl.DataFrame:
    """A random motion, of eight seconds at 500 Hz unless told, with that noise of torques."""
    dynamics, rng = compiled(robot), np.random.default_rng(seed)
    motion = random_motion(dynamics.kinematics, rng)
    sensing = None if noise is None else SensorNoise(noise)
    return simulate_recording(dynamics, p, motion, rng, duration=duration, rate=rate, noise=sensing)


Made = tuple[RobotDescription, np.ndarray, tuple[pl.DataFrame, ...]]


def _clean(name: str, logs: int = 1) -> Made:
    robot = load_robot(name)
    p = surrogate_parameters(robot, np.random.default_rng(0))
    return robot, p, tuple(simulated(robot, p, seed) for seed in range(logs))


def _stout() -> Made:
    """Bodies as thick as long, of which a posterior can be drawn by rejection, too."""
    robot = stout()
    return robot, truth(robot), (simulated(robot, truth(robot), 2, 0.05),)


def _sensed(case: str) -> Made:
    robot = sensed("clavel-delta3", case, 0.5).robot
    p = prior_parameters(robot)
    return robot, p, (simulated(robot, p, 5),)


def _late() -> Made:
    """Torques of drive 2 are 4 ms late."""
    robot, p, (frame,) = _clean("clavel-delta3")
    return robot, p, (frame.with_columns(pl.col("tau2").shift(2).backward_fill()),)


# Robots of each way to drive and hold a platform, and what a fit can have beside its torques.
SET: dict[str, Callable[[], Made]] = {
    **{
        name: lambda name=name: _clean(name)
        for name in ("clavel-delta3", "irb360-6-1600", "linear-delta", "h4", "par4", "i4-linear")
    },
    "two logs": lambda: _clean("clavel-delta3", 2),
    "stout": _stout,
    "weighed": lambda: _sensed("strut and platform weighed"),
    "plate": lambda: _sensed("wrench"),
    "gauges": lambda: _sensed("gauges"),
    "late": _late,
}


_DONE: dict[str, Identified] = {}
_FOLDERS: list[tempfile.TemporaryDirectory[str]] = []


def identified(name: str) -> Identified:
    """One of `SET`, with today's standard settings."""
    if name not in _DONE:
        _FOLDERS.append(tempfile.TemporaryDirectory(prefix="identified-"))
        _DONE[name] = _identified(name, Path(_FOLDERS[-1].name))
    return _DONE[name]


def _identified(name: str, folder: Path) -> Identified:
    robot, p, frames = SET[name]()
    save_yaml(robot, folder / "robot.yaml")
    for k, frame in enumerate(frames):
        write_recording(frame, folder / ("log.csv" if k == 0 else f"log-{k + 1}.csv"))
    result = identify(robot, sorted(folder.glob("log*.csv")), settings=Settings())
    result.model.save(folder / "model.yaml")
    return Identified(robot, p, frames, folder, result)
