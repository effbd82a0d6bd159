"""What a night costs a robot after so many days: python benchmarks/fleet_nights.py.

A year of a robot with one recording a day. On some days the jobs of that night's call are done, of
the week and of all recordings so far, without gathering: what they read, and their time of
processors. A few recordings are gathered; all others are these under checksums of their own.
"""

import tempfile
import time
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from _table import leave

from deltaid.dynamics.dynamics import compiled
from deltaid.fleets import factor_file, place
from deltaid.fleets.drift_findings import DriftSettings
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fleet import Recorded
from deltaid.fleets.gather_all import gather_recorded
from deltaid.fleets.gather_plan import GatherJob, How
from deltaid.fleets.known import GatherResult
from deltaid.fleets.place import Place
from deltaid.fleets.step import work_chain
from deltaid.fleets.steps import ALL, fit_jobs, robot_chains
from deltaid.fleets.store import stamp_of
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.robot.load import load_robot

ROBOT, SETTINGS = "irb360-6-1600", Settings(cutoff=15.0)
DAYS = (7, 30, 100, 365)
FIRST = datetime(2026, 1, 5, 6)
GATHERED, SECONDS = 4, 10.0
# The fleet on paper.
ROBOTS = 10_000


def gathered(folder: Path) -> list[FactorFile]:
    """A few recordings of one robot."""
    robot, rng = load_robot(ROBOT), np.random.default_rng(1)
    dynamics, files = compiled(robot), list[FactorFile]()
    p, how = surrogate_parameters(robot, rng), How(robot, None, SETTINGS)
    for k in range(GATHERED):
        motion, path = random_motion(dynamics.kinematics, rng), folder / f"{k}.parquet"
        simulate_recording(
            dynamics, p, motion, rng, duration=SECONDS, noise=SensorNoise()
        ).write_parquet(path)
        recorded = Recorded("r", FIRST, str(path), ROBOT, stamp=stamp_of(str(path)))
        result = gather_recorded(GatherJob.for_recording(recorded, how), Place.named(folder))
        files.append(factor_file.read(folder / result.file))
    return files


def of_day(day: int, files: list[FactorFile], folder: Path) -> GatherResult:
    """One of the recordings as if it were made on this day."""
    file, sha256 = files[day % len(files)], f"{day * 7919:064x}"
    source = file.record.model.sources[0].changed(sha256=sha256, log=f"{day}.parquet")
    model = file.record.model.changed(sources=(source,))
    name = f"factors/r/{day:03d}{factor_file.ENDING}"
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    factor_file.write(replace(file, record=file.record.changed(model=model)), path)
    recorded = Recorded("r", FIRST + timedelta(days=day), f"{day}.parquet", ROBOT, stamp="1")
    return GatherResult(recorded, str(day), name, size=path.stat().st_size, sha256=sha256)


def night(days: list[GatherResult], folder: Path) -> tuple[float, float]:
    """Time of processors [s] and what is read [MB] by the jobs of the last day's call."""
    jobs, read, seconds = (
        fit_jobs(days, "week", {ROBOT: load_robot(ROBOT)}, SETTINGS),
        list[int](),
        0.0,
    )

    def counted(path: Path) -> FactorFile:
        read.append(path.stat().st_size)
        return factor_file.read(path)

    place.read = counted
    for chain in robot_chains(jobs, days, DriftSettings()):
        fit = chain[0][1]
        if ALL in fit.names or days[-1].file in fit.files:
            start = time.process_time()
            for _, result in work_chain(chain, Place.named(folder)):
                assert not result.reason, result.reason
            seconds += time.process_time() - start
    return seconds, sum(read) / 1e6


def main() -> None:
    rows = list[tuple[str, ...]]()
    with tempfile.TemporaryDirectory() as name:
        folder, days = Path(name), list[GatherResult]()
        files = gathered(folder)
        for day in range(max(DAYS)):
            days.append(of_day(day, files, folder))
            if len(days) in DAYS:
                seconds, megabytes = night(days, folder)
                hours, terabytes = ROBOTS * seconds / 3600, ROBOTS * megabytes / 1e6
                figures = (f"{megabytes:.1f}", f"{seconds:.1f}", f"{terabytes:.2f}", f"{hours:.0f}")
                rows.append((str(len(days)), *figures))
    head = ("day", "read, MB a robot", "processor, s a robot", "10⁴ robots, TB", "core hours")
    note = f"The night after so many days, one recording of a {ROBOT} a day, without gathering."
    leave(head, rows, note)


if __name__ == "__main__":
    main()
