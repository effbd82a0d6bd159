"""Time and memory of the whole `deltaid identify` command on logs of 10⁴ to 10⁶ or 10⁷ samples.

    pip install .
    python benchmarks/command.py [--largest 10000000] [--before ../old/src]

Logs are simulated once, as CSV and as Parquet: one robot, one motion, 1 kHz, time, positions and
torques only. Counted is the whole process, from Python's start to the saved model. Kernels are kept
in the temporary folder, so that only the first run compiles them. Every measurement is a process of
its own; memory is its peak resident set, CPU time that of all cores together.

`--before` names the sources of another version, run in turn with this one on every log; only CPU
times are compared.

Then follow the stages of one `identify` call on the longest CSV log of up to 10⁶ samples, as its
`progress` callback announces them, in CPU time; the CPU time of such a call for different rates and
as many rows, with the cut-off given; and `deltaid base` with and without kernels on disk.
"""

import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from _timing import machine, measure, options

from deltaid.checks.identify import identify
from deltaid.dynamics.dynamics import Dynamics
from deltaid.model.record import Settings
from deltaid.motion.fourier import FourierMotion
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.robot.load import load_robot

ROBOT = "irb360-6-1600"
SIZES = (10**4, 10**5, 10**6, 10**7)
USUAL = 10**6  # the longest log unless asked for; also what is simulated at once
RATE = 1000.0
RATES, ROWS, CUTOFF = (1e3, 1e4, 2e5), 500_000, 50.0
KINDS = {"CSV": "csv", "Parquet": "parquet"}
STAGES = {
    "judging": "verdicts: rows of the beginning, filter, hypotheses of wiring, information",
    "checking": "survey: read, check, forward kinematics, spectrum, checksum",
    "evaluating": "information: read, filter, forward kinematics, regressor, factor",
    "fitting": "fit: base parameters, objective, conic program",
    "comparing": "torque errors: read, filter, forward kinematics, torques",
}
COMMAND = [sys.executable, "-c", "from deltaid.cli import main; main()"]
# A process that is small itself, because a child's peak counts from its parent's size on.
LAUNCHER = """
import json, os, subprocess, sys, time
start = time.perf_counter()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(child.pid, 0)
seconds = time.perf_counter() - start
used = usage.ru_utime + usage.ru_stime
print(json.dumps([seconds, used, usage.ru_maxrss, os.waitstatus_to_exitcode(status)]))
"""
_RSS_UNIT = 1 if sys.platform == "darwin" else 1024  # bytes; macOS counts bytes, Linux KiB


@dataclass(frozen=True)
class Cost:
    """Medians over the repeats of one command: wall and CPU time [s], peak resident set [bytes]."""

    seconds: float
    cpu: float
    memory: float


def main() -> None:
    arguments = options(__doc__, largest=USUAL, before=Path, repeats=5, seed=0)
    sizes = [size for size in SIZES if size <= arguments.largest]
    print(f"{machine()}\npolars {pl.__version__}, {pl.thread_pool_size()} threads")
    print(f"{ROBOT}, {RATE:g} Hz, positions and torques; median of {arguments.repeats}\n")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["DELTAID_KERNEL_CACHE"] = str(folder / "kernels")
        for size in sizes:
            write_logs(folder, size, arguments.seed)
        if arguments.before is not None:
            for size, suffix in itertools.product(sizes, KINDS.values()):
                _print_before(folder / f"{size}.{suffix}", arguments.before, arguments.repeats)
            return
        for kind, suffix in KINDS.items():
            logs = {size: folder / f"{size}.{suffix}" for size in sizes}
            costs = {size: _cost(_identify(logs[size]), arguments.repeats) for size in sizes}
            _print_table(kind, costs, folder, suffix)
        _print_stages(folder / f"{min(sizes[-1], USUAL)}.csv", arguments.repeats)
        _print_rates(folder, arguments.repeats, arguments.seed)
        _print_start(arguments.repeats)


def robot_of(seed: int) -> tuple[Dynamics, np.ndarray, FourierMotion, np.random.Generator]:
    """The robot, its true parameters, its motion, and what draws the noise of a recording."""
    rng, dynamics = np.random.default_rng(seed), Dynamics(load_robot(ROBOT))
    p = surrogate_parameters(dynamics.robot, rng)
    return dynamics, p, random_motion(dynamics.kinematics, rng), rng


def write_logs(folder: Path, samples: int, seed: int) -> None:
    """The same recording as CSV and as Parquet, named by its number of samples.

    The motion is periodic; a long recording is written in pieces of whole periods.
    """
    dynamics, p, motion, rng = robot_of(seed)
    path = folder / f"{samples}.csv"
    with path.open("wb") as file:
        for start in range(0, samples, USUAL):
            length = min(USUAL, samples - start) / RATE
            piece = simulate_recording(
                dynamics, p, motion, rng, duration=length, rate=RATE, noise=SensorNoise()
            )
            piece = piece.with_columns(pl.col("t") + start / RATE)
            piece.write_csv(file, include_header=start == 0)
    pl.scan_csv(path).sink_parquet(path.with_suffix(".parquet"))


def _identify(log: Path) -> list[str]:
    return ["identify", ROBOT, str(log), "--output", str(log.with_name("model.yaml"))]


def _print_before(log: Path, sources: Path, repeats: int) -> None:
    """CPU time of this version and of another one, by turns."""
    runs = [(_cost(_identify(log), 1, sources), _cost(_identify(log), 1)) for _ in range(repeats)]
    before, now = (statistics.median(run.cpu for run in side) for side in zip(*runs, strict=True))
    print(f"{log.name:18} {before:6.2f} CPU s before, {now:6.2f} now, {now / before:.2f} times")


def _cost(arguments: list[str], repeats: int, sources: Path | None = None) -> Cost:
    """Medians over some runs of `deltaid ARGUMENTS`, of other sources if these are given; a
    RuntimeError where the command fails."""
    runs: list[tuple[float, float, float]] = []
    other = {} if sources is None else {"PYTHONPATH": str(sources)}
    for _ in range(repeats):
        launch = [sys.executable, "-S", "-c", LAUNCHER, *COMMAND, *arguments]
        out = subprocess.run(
            launch, check=True, capture_output=True, text=True, env=os.environ | other
        )
        seconds, cpu, peak, code = json.loads(out.stdout)
        if code != 0:
            raise RuntimeError(f"deltaid {' '.join(arguments)} failed: {out.stderr}")
        runs.append((seconds, cpu, peak * _RSS_UNIT))
    return Cost(*map(statistics.median, zip(*runs, strict=True)))


def stages(log: Path) -> dict[str, float]:
    """CPU seconds of each stage of one `identify` call, named by what it announces."""
    marks = list[tuple[str, float]]()

    def mark(text: str) -> None:
        marks.append((text.split()[0], time.process_time()))

    identify(load_robot(ROBOT), [log], progress=mark)
    marks.append(("", time.process_time()))
    found = dict.fromkeys((name for name, _ in marks[:-1]), 0.0)
    for (name, start), (_, end) in itertools.pairwise(marks):
        found[name] += end - start
    return found


def _print_table(kind: str, costs: dict[int, Cost], folder: Path, suffix: str) -> None:
    """One line a size, and how memory grows from the second size on."""
    print(f"{kind:10} {'file MB':>9} {'s':>8} {'CPU s':>8} {'samples/s':>12} {'peak MB':>9}")
    for size, cost in costs.items():
        bytes_on_disk = (folder / f"{size}.{suffix}").stat().st_size
        print(
            f"{size:10,} {bytes_on_disk / 1e6:9.1f} {cost.seconds:8.2f} {cost.cpu:8.2f} "
            f"{size / cost.seconds:12,.0f} {cost.memory / 1e6:9.0f}"
        )
    for (small, a), (large, b) in itertools.pairwise(costs.items()):
        growth, more = b.memory - a.memory, large - small
        print(
            f"from {small:,} to {large:,} samples: {growth / 1e6:+.0f} MB, that is "
            f"{growth / more:+.1f} bytes a further sample, and "
            f"{1e6 * (b.cpu - a.cpu) / more:.1f} CPU s a further million"
        )
    print()


def _print_stages(log: Path, repeats: int) -> None:
    runs = [stages(log) for _ in range(repeats)]
    found = {name: statistics.median(run[name] for run in runs) for name in runs[0]}
    print(f"stages of one identify call on {log.name}, CPU time")
    for name, seconds in found.items():
        share = 100 * seconds / sum(found.values())
        print(f"{seconds:8.2f} s {share:4.0f} %  {STAGES.get(name, name)}")


def _print_rates(folder: Path, repeats: int, seed: int) -> None:
    """CPU time of a row, by the rate it was recorded at."""
    dynamics, p, motion, rng = robot_of(seed)
    print(f"\none identify call on {ROWS:,} rows, cut-off {CUTOFF:g} Hz")
    for rate in RATES:
        log = folder / f"{rate:g}.parquet"
        simulate_recording(
            dynamics, p, motion, rng, duration=ROWS / rate, rate=rate, noise=SensorNoise()
        ).write_parquet(log)

        def call(log: Path = log) -> None:
            identify(load_robot(ROBOT), [log], settings=Settings(cutoff=CUTOFF))

        seconds = measure(call, repeats, time.process_time)
        print(f"{rate:10,.0f} Hz {1e6 * seconds / ROWS:8.2f} CPU µs a row")


def _print_start(repeats: int) -> None:
    print(f"\ndeltaid base {ROBOT}")
    for name, flags in {"compiled": ["--no-cache"], "kept": []}.items():
        cost = _cost([*flags, "base", ROBOT], repeats)
        print(f"{name:10} {cost.seconds:8.2f} s {cost.cpu:8.2f} CPU s")


if __name__ == "__main__":
    main()
