"""What a fleet costs: time and memory of gathering and fitting: python benchmarks/fleet.py.

Recordings are periods of one random motion one after the other, each with noise of its own, written
as Parquet. Time is that of processors, of all threads, so that it does not depend on what else a
machine is doing; wall time is used only for what one and two processes do. Memory is the largest
that a worker has had.
"""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from _table import STATED, leave
from _timing import options

from deltaid.fleets.workers import open_workers

ROBOT = "irb360-6-1600"
RATE, CUTOFF = 1000.0, 15.0
# Samples of one recording, and recordings so short that they cost little but their overhead.
LONG, SHORT, SHORTS = 10_000_000, 4_000, 12
# The fleet on paper.
ROBOTS, DAYS, HOUR = 10_000, 365, 3_600_000


def write_recordings(folder: Path, lengths: Sequence[int]) -> list[Path]:
    """Recordings of so many samples."""
    from deltaid.dynamics.dynamics import compiled
    from deltaid.motion.random_motion import random_motion
    from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
    from deltaid.robot.load import load_robot

    rng, robot = np.random.default_rng(1), load_robot(ROBOT)
    dynamics = compiled(robot)
    motion, p = random_motion(dynamics.kinematics, rng), surrogate_parameters(robot, rng)
    recording = simulate_recording(
        dynamics, p, motion, rng, duration=motion.period, rate=RATE, noise=SensorNoise(torque=0.0)
    )
    names = [name for name in recording.columns if name.startswith("tau")]
    largest = {name: float(np.abs(recording[name].to_numpy()).max()) for name in names}
    paths = list[Path]()
    for k, count in enumerate(lengths):
        at = np.arange(count) % len(recording)
        columns = {"t": np.arange(count) / RATE}
        for name in recording.columns[1:]:
            values = recording[name].to_numpy()[at]
            if name in largest:
                values += 0.02 * largest[name] * rng.standard_normal(count)
            columns[name] = values
        paths.append(folder / f"{count}-{k:03d}.parquet")
        pl.DataFrame(columns).write_parquet(paths[-1])
    return paths


def used() -> tuple[float, float]:
    """Time of processors [s] and largest memory [MB] of this process so far."""
    own, status = resource.getrusage(resource.RUSAGE_SELF), Path("/proc/self/status")
    peak = int(status.read_text().partition("VmHWM:")[2].split()[0]) / 1024
    return own.ru_utime + own.ru_stime, peak


def gather(paths: Sequence[Path], folder: Path, workers: int) -> dict[str, float]:
    """Recordings gathered by so many processes."""
    from datetime import datetime

    from deltaid.fleets.fleet import Recorded
    from deltaid.fleets.gather_plan import GatherJob, How
    from deltaid.fleets.place import Place
    from deltaid.fleets.store import stamp_of
    from deltaid.model.record import Settings
    from deltaid.robot.load import load_robot

    place, how = Place.named(folder), How(load_robot(ROBOT), None, Settings(cutoff=CUTOFF))
    day, names = datetime(2026, 1, 1), map(str, paths)
    recorded = (Recorded("r", day, name, ROBOT, stamp=stamp_of(name)) for name in names)
    jobs = [GatherJob(each, how) for each in recorded]
    with open_workers(count=workers) as pool:
        list(pool.done(nothing, range(workers), _fail))
        start = time.perf_counter()
        results = list(pool.done(partial(measured, place=place), jobs, _fail))
        wall = time.perf_counter() - start
    if bad := [outcome.reason for outcome, *_ in results if outcome.reason]:
        raise RuntimeError(bad[0])
    return {
        "wall": wall,
        "cpu": sum(seconds for _, seconds, _ in results),
        "peak": max(peak for *_, peak in results),
        "bytes": float(np.mean([outcome.bytes for outcome, *_ in results])),
    }


def measured(job: Any, place: Any) -> tuple[Any, float, float]:
    """A recording gathered, with time of processors [s] and largest memory [MB] of its process."""
    from deltaid.fleets.gather_all import gather_recorded

    before = used()
    outcome = gather_recorded(job, place=place)
    after = used()
    return outcome, after[0] - before[0], after[1]


def identify(path: Path) -> float:
    """Time of processors of the single command [s]."""
    code = "import sys; from deltaid.cli import main; main()"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", code, "identify", ROBOT, str(path), "--cutoff", str(CUTOFF)],
        check=True, capture_output=True,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def nothing(number: int) -> int:
    return number


def dispatch(count: int = 2000) -> float:
    """Wall time of a task that does nothing [s]."""
    with open_workers(count=1) as pool:
        list(pool.done(nothing, range(10), _fail))
        start = time.perf_counter()
        list(pool.done(nothing, range(count), _fail))
        return (time.perf_counter() - start) / count


def fits(folder: Path, count: int) -> float:
    """Time of processors of reading so many factor files of a robot, and of their fit [s]."""
    from deltaid.fleets.factor_file import read
    from deltaid.fleets.identify_gathered import identify_gathered
    from deltaid.model.record import Settings
    from deltaid.parallel import threads

    paths = sorted(folder.rglob("*.factors.parquet"))
    start = time.process_time()
    with threads(1):
        files = [read(paths[k % len(paths)]) for k in range(count)]
        own = []
        for k, file in enumerate(files):  # each as if it were of another recording
            source = file.record.model.sources[0].changed(sha256=f"{k:064x}", rows="")
            model = file.record.model.changed(sources=(source,))
            own.append(replace(file, record=file.record.changed(model=model)))
        identify_gathered(ROBOT, own, Settings(cutoff=CUTOFF))
    return time.process_time() - start


def _fail(item: object, why: str) -> object:
    raise RuntimeError(f"{item}: {why}")


def main() -> None:
    given = options(__doc__, samples=float(STATED["fleet"]["samples"]), folder=Path)
    total = round(given.samples)
    length = min(LONG, total // 4)
    with tempfile.TemporaryDirectory(dir=given.folder) as name:
        folder = Path(name)
        long = write_recordings(folder, [length] * (total // length))
        short = write_recordings(folder, [SHORT] * SHORTS)
        size = sum(path.stat().st_size for path in long)
        few = long[: max(2, len(long) // 5)]
        serial = gather(few, folder / "one", 1)
        parallel = gather(long, folder / "two", 2)
        brief = gather(short, folder / "brief", 1)
        print(
            f"memory of workers: {serial['peak']:.0f} and {parallel['peak']:.0f} MB",
            file=sys.stderr,
        )
        single = identify(long[0])
        task, week, year = dispatch(), fits(folder / "brief", 7), fits(folder / "brief", DAYS)
    rate = len(long) * length / parallel["cpu"]
    faster = serial["wall"] / len(few) / (parallel["wall"] / len(long))
    overhead = max(brief["cpu"] / SHORTS - SHORT / rate, 0.0)
    # Processes that got less than most of a core waited for others, and caches were shared.
    is_busy = serial["cpu"] < 0.8 * serial["wall"] or parallel["cpu"] < 1.6 * parallel["wall"]
    speedup = "not known: others used the machine" if is_busy else f"{faster:.2f} times as fast"
    daily = HOUR / rate + overhead + task
    hours = ROBOTS * DAYS * daily / 3600
    refits = ROBOTS * (52 * week + 12 * year) / 3600
    stored = ROBOTS * DAYS * parallel["bytes"] / 1e9
    gathered = f"{len(long) * length:,} in {len(long)} recordings, {size / 1e9:.2f} GB"
    rows = [
        ("samples gathered", gathered),
        ("largest memory of a worker", f"{max(serial['peak'], parallel['peak']):.0f} MB"),
        ("gathered, samples a second and core", f"{rate:,.0f}"),
        ("`deltaid identify` of one of them, the same", f"{length / single:,.0f}"),
        ("two processes against one, wall time", speedup),
        ("overhead a recording", f"{overhead:.2f} s"),
        ("overhead a task", f"{1e3 * task:.1f} ms"),
        ("factor file", f"{parallel['bytes'] / 1e3:.0f} kB"),
        ("fit of a week, 7 factor files", f"{week:.1f} s"),
        ("fit of a year, 365 factor files", f"{year:.1f} s"),
        ("**on paper: 10⁴ robots, an hour at 1 kHz a day**", ""),
        ("a night, gathering", f"{ROBOTS * daily / 3600:,.0f} core hours"),
        ("a year, gathering", f"{hours:,.0f} core hours"),
        ("a year, fits of each week and every month of all", f"{refits:,.0f} core hours"),
        ("a year, factor files", f"{stored:,.0f} GB"),
    ]
    note = (
        f"Cost of a fleet of {ROBOT} (4 drives). Time is that of processors; the two processes "
        "share a machine with two cores."
        + " Others used it meanwhile, so times are too long."
        * is_busy
    )
    leave(("what", "figure"), rows, note, samples=len(long) * length)


if __name__ == "__main__":
    main()
