"""Recordings of a robot day by day, made of one that was gathered: other friction, other tools."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from deltaid.drift.recorded import Recorded
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.factors.condensed import Group, Groups
from deltaid.factors.file import FactorFile
from deltaid.factors.gather import gathered
from deltaid.factors.problem import merging_of
from deltaid.factors.target import map_to
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, write_recording
from deltaid.robot.load import load_robot

ROBOT = "clavel-delta3"
SETTINGS = Settings(cutoff=15.0, friction="described", events=False, lag="none")
START = datetime(2026, 1, 1)


def one_recording(folder: Path, seed: int = 0) -> FactorFile:
    """A recording of the described robot, gathered."""
    robot, rng = load_robot(ROBOT), np.random.default_rng(seed)
    dynamics = compiled(robot)
    motion = random_motion(dynamics.kinematics, rng)
    found = simulate_recording(
        dynamics, prior_parameters(robot), motion, rng, duration=6.0,
        noise=SensorNoise(torque=0.02),
    )  # fmt: skip
    path = folder / f"log{seed}.csv"
    write_recording(found, path)
    return gathered(ROBOT, path, settings=SETTINGS)


def with_other(file: FactorFile, more: dict[str, float], name: str) -> FactorFile:
    """The same recording of a robot with more of some parameters."""
    robot = load_robot(ROBOT)
    merging = merging_of([file], robot, SETTINGS)
    layout, kept = merging.dynamics.layout, merging.columns.kept_names
    delta = np.zeros(len(layout.names))
    for key, value in more.items():
        delta[layout.names.index(key)] = value
    by_name = dict(zip(kept, map_to(merging.columns, merging.dynamics) @ delta, strict=True))
    condensed = file.condensed

    def moved(group: Group) -> Group:
        factors = []
        for R, felt in zip(group.factors, condensed.felt, strict=True):
            own = np.array([by_name.get(condensed.names[k], 0.0) for k in felt])
            R = R.copy()
            R[:, -1] += R[:, : len(own)] @ own
            factors.append(R)
        return replace(group, factors=tuple(factors))

    # Not validated: that of a year takes longer than all the rest.
    record, known = file.record, file.record.model
    source = known.sources[0].changed(log=name, sha256=f"{name}-sum")
    fields: dict[str, Any] = dict(known) | {"sources": (source,)}
    own: dict[str, Any] = dict(record) | {"model": type(known).model_construct(**fields)}
    found = replace(
        condensed,
        whole=moved(condensed.whole),
        groups=Groups.of(moved(one) for one in condensed.groups),
        geometry=None if condensed.geometry is None else moved(condensed.geometry),
    )
    return FactorFile(type(record).model_construct(**own), found, name)


def days(
    file: FactorFile,
    count: int,
    share: Callable[[int], Sequence[float]],
    *,
    held: Callable[[int], float] = lambda _: 0.0,
    temperature: Callable[[int], float | None] = lambda _: None,
) -> list[Recorded]:
    """One recording a day.

    Args:
        share: by how much friction of each drive is more on a day, as a share.
        held: mass that nobody told of [kg].
    """
    robot, layout = load_robot(ROBOT), compiled(load_robot(ROBOT)).layout
    p, found = prior_parameters(robot), list[Recorded]()
    for day in range(count):
        more = {"P.m": held(day)}
        for drive, own in zip(robot.drives, share(day), strict=True):
            for kind in ("viscous", "coulomb"):
                name = f"{kind}.{drive}"
                more[name] = own * float(p[layout.names.index(name)])
        one = with_other(file, more, f"a-{START + timedelta(days=day):%Y-%m-%d}.csv")
        found.append(Recorded(one, START + timedelta(days=day), temperature(day)))
    return found
