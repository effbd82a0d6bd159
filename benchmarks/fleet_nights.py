"""What a night costs a robot after so many days: python benchmarks/fleet_nights.py.

A year of a robot with one recording a day, night after night: each night does the jobs of its call,
of the week and of all recordings so far, without gathering. Of some nights stands what the jobs of
all recordings read and write, and their time of processors; with the week's fit, which reads up to
seven factor files, the mean of seven nights. A few recordings are gathered; all others are these
under checksums of their own.
"""

import tempfile
import time
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from _table import leave

from deltaid.dynamics.dynamics import compiled
from deltaid.fleets import factor_file, place, store
from deltaid.fleets.drift_findings import DriftSettings
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fleet import ALL, Recorded
from deltaid.fleets.gather_all import gather_recorded
from deltaid.fleets.gather_plan import GatherJob, GatherResult, How
from deltaid.fleets.place import Place
from deltaid.fleets.step import work_chain
from deltaid.fleets.steps import fit_jobs, robot_chains
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
        result = gather_recorded(GatherJob(recorded, how), Place.named(folder))
        files.append(factor_file.read(folder / result.file))
    return files


def of_day(day: int, files: list[FactorFile], folder: Path) -> GatherResult:
    """One of the recordings as if it were made on this day."""
    file, sha256 = files[day % len(files)], f"{day * 7919:064x}"
    source = file.record.model.sources[0].changed(sha256=sha256, rows="", log=f"{day}.parquet")
    model = file.record.model.changed(sources=(source,))
    name = f"factors/r/{day:03d}{factor_file.ENDING}"
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    factor_file.write(replace(file, record=file.record.changed(model=model)), path)
    recorded = Recorded("r", FIRST + timedelta(days=day), f"{day}.parquet", ROBOT, stamp="1")
    return GatherResult(recorded, str(day), name, bytes=path.stat().st_size, sha256=sha256)


class Counted:
    """Bytes that pass through files of a fleet's folder."""

    def __init__(self) -> None:
        self.read = self.written = 0
        read, write, factors = store.read, store.write, factor_file.read

        def counted_read(path: str) -> bytes | None:
            data = read(path)
            self.read += len(data or b"")
            return data

        def counted_write(path: str, data: bytes) -> None:
            self.written += len(data)
            write(path, data)

        def counted_factors(path: Path) -> FactorFile:
            self.read += path.stat().st_size
            return factors(path)

        store.read, store.write, place.read = counted_read, counted_write, counted_factors


@dataclass(frozen=True)
class Night:
    """What the jobs of a night's call have read and written [MB], and their time of processors."""

    read: float
    written: float
    seconds: float


def night(days: list[GatherResult], folder: Path, counted: Counted) -> tuple[Night, Night]:
    """The jobs of the last day's call: of all recordings, and of its week."""
    jobs = fit_jobs(days, "week", {ROBOT: load_robot(ROBOT)}, SETTINGS)
    nights = [Night(0, 0, 0)] * 2
    for chain in robot_chains(jobs, DriftSettings()):
        fit = chain[0]
        is_week = ALL not in fit.names
        if not is_week or days[-1].file in fit.files:
            before, start = (counted.read, counted.written), time.process_time()
            for result in work_chain(chain, Place.named(folder)):
                assert not result.reason, result.reason
            seconds = time.process_time() - start
            read, written = counted.read - before[0], counted.written - before[1]
            nights[is_week] = Night(read / 1e6, written / 1e6, seconds)
    return nights[0], nights[1]


def main() -> None:
    rows, counted = list[tuple[str, ...]](), Counted()
    with tempfile.TemporaryDirectory() as name:
        folder, days, nights = Path(name), list[GatherResult](), list[tuple[Night, Night]]()
        files = gathered(folder)
        for day in range(max(DAYS)):
            days.append(of_day(day, files, folder))
            nights.append(night(days, folder, counted))
            if len(days) in DAYS:
                every = nights[-1][0]
                both = [job for week in nights[-7:] for job in week]
                read = sum(job.read for job in both) / 7
                seconds = sum(job.seconds for job in both) / 7
                scale = (ROBOTS * read / 1e6, ROBOTS * seconds / 3600)
                figures = (every.read, every.written, every.seconds, read, seconds, *scale)
                rows.append((str(len(days)), *(f"{x:.2f}" for x in figures)))
    head = ("day", "read, MB a robot", "written, MB", "processor, s",
            "with the week's fit: read, MB", "processor, s", "10⁴ robots: read, TB",
            "core hours")  # fmt: skip
    note = (
        f"Nights of a year, one recording of a {ROBOT} a day, without gathering. Of all "
        "recordings, with drift and type, on the night of that day; with the week's fit the mean "
        "of seven nights until then."
    )
    leave(head, rows, note)


if __name__ == "__main__":
    main()
