"""Recordings of a robot day by day, made of one that was gathered: other friction, other tools."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import polars as pl

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.fleets.factor_columns import map_to
from deltaid.fleets.factor_file import ENDING, FactorFile, digest, write
from deltaid.fleets.factor_record import FactorGroups, Temperature
from deltaid.fleets.gather import gathered
from deltaid.fleets.merged import Merging, merging_of
from deltaid.fleets.robot_drift import DriftRecording
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot

ROBOT = "clavel-delta3"
DESCRIBED = load_robot(ROBOT)
SETTINGS = Settings(cutoff=15.0, friction="described", events=False, lag="none")
START = datetime(2026, 1, 1)


def recording(
    seed: int,
    robot: RobotDescription = DESCRIBED,
    friction: float = 1.0,
    duration: float = 6.0,
    rate: float = 500.0,
) -> pl.DataFrame:
    """A recording of a robot with so many times its friction, on a motion and with noise of a
    seed."""
    dynamics, p, rng = compiled(robot), prior_parameters(robot), np.random.default_rng(seed)
    p[dynamics.layout.friction] *= friction
    motion, noise = random_motion(dynamics.kinematics, rng), SensorNoise(torque=0.02)
    return simulate_recording(dynamics, p, motion, rng, duration=duration, rate=rate, noise=noise)


def one_recording(folder: Path, seed: int = 0) -> FactorFile:
    """The same, gathered."""
    path = folder / f"log{seed}.csv"
    write_recording(recording(seed), path)
    return gathered(ROBOT, path, settings=SETTINGS)


def with_other(file: FactorFile, merging: Merging, more: dict[str, float], name: str) -> FactorFile:
    """The same recording of a robot with more of some parameters."""
    layout, kept = merging.dynamics.layout, merging.columns.place
    delta = np.zeros(len(layout.names))
    for key, value in more.items():
        delta[layout.names.index(key)] = value
    by_name = dict(zip(kept, map_to(merging.columns, merging.dynamics) @ delta, strict=True))

    def moved(groups: FactorGroups) -> FactorGroups:
        factors = tuple(R.copy() for R in groups.factors)
        for every, columns in zip(factors, file.record.felt, strict=True):
            own = np.array([by_name.get(file.record.names[k], 0.0) for k in columns])
            for R in every:
                R[:, -1] += R[:, : len(own)] @ own
        return replace(groups, factors=factors)

    # Not validated: that of a year takes longer than all the rest.
    record, known = file.record, file.record.model
    source = known.sources[0].changed(log=name, sha256=digest(name), rows="")
    fields: dict[str, Any] = dict(known) | {"sources": (source,)}
    own: dict[str, Any] = dict(record) | {"model": type(known).model_construct(**fields)}
    geometry = None if file.geometry is None else moved(file.geometry)
    changed = type(record).model_construct(**own)
    return FactorFile(changed, moved(file.whole), moved(file.groups), geometry, name)


def write_months(folder: Path, count: int = 42) -> None:
    """Files of a robot, whose second drive rises by 5 % a month from day 36 on; recorded every
    other day.

    From day 20 on it has another gripper.
    """
    rng = np.random.default_rng(3)
    at = 2 * np.arange(count)
    warm = 24 + 4 * np.sin(at / 25) + 2 * rng.standard_normal(count)
    scatter = 0.007 * rng.standard_normal((count, 3))

    def share(k: int) -> Sequence[float]:
        rise = np.array([0.0, 0.05 / 30.4375 * max(at[k] - 36, 0), 0.0])
        return np.expm1(rise - 0.009 * (warm[k] - 24) + scatter[k]).tolist()

    folder.mkdir(parents=True)

    def held(k: int) -> float:
        return 0.15 if at[k] >= 20 else 0.0

    with TemporaryDirectory() as logs:
        file = one_recording(Path(logs))
    for k, recorded in enumerate(days(file, count, share, held=held, every=2)):
        T = float(warm[k])
        record = recorded.file.record
        fields: dict[str, Any] = dict(record) | {"temperature": Temperature(mean=T, low=T, high=T)}
        own = replace(recorded.file, record=type(record).model_construct(**fields), path="")
        write(own, folder / f"{record.log.removesuffix('.csv')}{ENDING}")


def days(
    file: FactorFile,
    count: int,
    share: Callable[[int], Sequence[float]],
    *,
    held: Callable[[int], float] = lambda _: 0.0,
    temperature: Callable[[int], float | None] = lambda _: None,
    every: int = 1,
    first: int = 0,
) -> list[DriftRecording]:
    """One recording a day, or every so many days from the first on; functions of its number.

    Args:
        share: by how much friction of each drive is more on a day, as a share.
        held: mass that nobody told of [kg].
    """
    robot, layout = DESCRIBED, compiled(DESCRIBED).layout
    p, found = prior_parameters(robot), list[DriftRecording]()
    merging = merging_of([file.brief], robot, SETTINGS)
    for day in range(count):
        more = {"P.m": held(day)}
        for drive, times in zip(robot.drives, share(day), strict=True):
            for kind in ("viscous", "coulomb"):
                name = f"{kind}.{drive}"
                more[name] = times * float(p[layout.names.index(name)])
        time = START + timedelta(days=first + every * day)
        changed = with_other(file, merging, more, f"line3-{time:%Y-%m-%d}.csv")
        found.append(DriftRecording(changed, time, temperature(day)))
    return found
