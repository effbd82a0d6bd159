"""Excitation motions: deltaid's optimiser against two usual ones, and what its motions are worth.

    pip install .
    python benchmarks/excitation.py [--quick]

One robot, one series, one set of limits, the default criterion, one thread a solver. Four parts:

Optimisers, from the same random starts: deltaid's `optimise` (SLSQP, exact gradients, smooth maxima
of the limits, tightened until they hold between grid points); SciPy's SLSQP with forward
differences, one constraint a limit; CasADi's IPOPT on the same functions and differences, limited-
memory Hessian. Both others get deltaid's compiled functions, one evaluation for the objective and
all limits. They run until the time is up, again from where they ended, or until nothing moves.
Every point at which a solver asks for a value is judged off the clock, on a ten times finer grid
with the true sign of friction; one beyond a limit is pulled towards the feasible start. Counted is
processor time from the start, for deltaid with drawing the start, checks and tightening; one of its
evaluations includes gradients. Ratios compare the time to another solver's best value, and to 99
and 95 % of its way there, with deltaid's time to as good a value. The last line is deltaid's from
as many starts as the command makes.

Command. Wall time of `deltaid excite` from nothing to a file, in a process of its own.

Predictions. Standard deviations of base parameters for recordings of equal length: the optimised
run against the best of many random feasible motions, by the same criterion, and the middle one.

Identification. Recordings of a known robot, one a seed, along the optimised run and random motions
with the same limits, rate, encoder steps and torque noise in N m. Errors: M by its entries' largest
along a third motion, relative to each entry's mean; friction by its worst coefficient; base
parameters in units of the prior's standard deviation.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import _alone  # noqa: F401
import numpy as np
import polars as pl
import scipy
from _excitation_judge import Comparison, Curve, Judge
from _excitation_solvers import Trace, run_deltaid, run_ipopt, run_slsqp
from _excitation_worth import (
    compare_identification,
    compare_predictions,
    long_run,
    ranked_random_motions,
)
from _timing import machine, options

from deltaid.dynamics.dynamics import compiled
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.motion.excitation.optimize import optimise, random_start
from deltaid.motion.excitation.problem import ExcitationProblem
from deltaid.robot.load import load_robot

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
ROBOT = "irb360-6-1600"
SHARES = (1.0, 0.99, 0.95)  # of a solver's way from the start to its best value
COMMAND = [sys.executable, "-c", "from deltaid.cli import main; main()"]


def compare_optimisers(problem: ExcitationProblem, seeds: range, budget: float) -> None:
    """All three from every start, a table for each, and what it comes to."""
    problem.evaluate(random_start(problem, 0))  # compiles the kernels for everyone
    unknowns, limits = problem.series.length, len(problem.two_sided)
    print(f"\nOPTIMISERS, {unknowns} unknowns, {limits} limits; lower is better")
    print(
        f"{'':14} {'best':>8} {'at s':>7} {'end s':>7} {'evaluations':>11} {'each ms':>8}  "
        f"{'deltaid has it at':>17} {'deltaid then':>12} {'ratio':>6} {'99 %':>5} {'95 %':>5}"
    )
    found: dict[str, list[Comparison]] = {}
    for seed in seeds:
        x_0 = random_start(problem, seed)
        judge, trace = Judge(problem, x_0), run_deltaid(problem, seed)
        ours = judge.curve(trace, np.inf)
        print(f"start {seed}, {ours.values[0]:.4f} before")
        print(_line(trace, ours))
        for run in (run_slsqp, run_ipopt):
            trace = run(problem, x_0, budget)
            pair = Comparison(ours, judge.curve(trace, budget))
            found.setdefault(trace.name, []).append(pair)
            print(f"{_line(trace, pair.theirs)}  {_compared(pair)}", flush=True)
    for name, pairs in found.items():
        print(f"{name}, {_summary(pairs)}")
    _print_command_starts(problem)


def _print_command_starts(problem: ExcitationProblem) -> None:
    """What deltaid reaches with as many starts as the command makes; all threads counted."""
    count = ExcitationSettings().starts
    began = time.process_time()
    x = optimise(problem, range(count)).x
    seconds = time.process_time() - began
    value = Judge(problem, random_start(problem, 0)).value(x)
    print(f"deltaid from {count} starts, as the command makes: {value:.4f} in {seconds:.2f} s")


def _line(trace: Trace, curve: Curve) -> str:
    each = 1e3 * trace.seconds / trace.evaluations
    return (
        f"  {trace.name:12} {curve.best:8.4f} {curve.time_to(curve.best):7.2f} "
        f"{trace.seconds:7.2f} {trace.evaluations:11,} {each:8.2f}"
    )


def _compared(pair: Comparison) -> str:
    """Where deltaid stands when another solver has its best value, and the ratios of times."""
    at = pair.ours.time_to(pair.theirs.best)
    when = f"{at:.2f} s" if at < np.inf else "never"
    ratios = [f"{pair.ratio(share):.0f}" if pair.ratio(share) else "–" for share in SHARES]
    return f"{when:>17} {pair.then:12.4f} {ratios[0]:>6} {ratios[1]:>5} {ratios[2]:>5}"


def _summary(pairs: list[Comparison]) -> str:
    """Median ratios, and from how many starts deltaid has what is aimed at."""
    medians = [statistics.median(pair.ratio(share) for pair in pairs) for share in SHARES]
    tenth = sum(pair.ratio() >= 10 for pair in pairs)
    better = sum(pair.then < pair.theirs.best for pair in pairs)
    return (
        f"median ratios {', '.join(f'{median:.0f}' for median in medians)}; of {len(pairs)} starts "
        f"deltaid has its best value in a tenth of the time from {tenth}, and a better one at "
        f"equal time from {better}"
    )


def time_command(repeats: int) -> None:
    """Wall time of `deltaid excite ROBOT -o FILE`, with the environment of a user."""
    environment = {name: value for name, value in os.environ.items() if name not in THREADS}
    seconds, rows = [], 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "motion.csv"
        for _ in range(repeats):
            start, command = time.perf_counter(), [*COMMAND, "excite", ROBOT, "-o", str(path)]
            subprocess.run(command, check=True, capture_output=True, env=environment)
            seconds.append(time.perf_counter() - start)
            rows = pl.read_csv(path).height
    print(f"\nCOMMAND deltaid excite {ROBOT} -o motion.csv, {os.cpu_count()} cores")
    print(
        f"  {statistics.median(seconds):.1f} s (median of {repeats}, from {min(seconds):.1f} to "
        f"{max(seconds):.1f}), {rows:,} rows"
    )


def main() -> None:
    arguments = options(
        __doc__, starts=3, budget=30.0, repeats=3, random=1000, recordings=5, seed=0, quick=False
    )
    if arguments.quick:
        arguments.starts, arguments.budget, arguments.repeats = 1, 5.0, 1
        arguments.random, arguments.recordings = 100, 1
    exciter = Exciter(compiled(load_robot(ROBOT)), ExcitationSettings())
    problem, settings = exciter.problem, exciter.settings
    print(f"{machine()}\nscipy {scipy.__version__}, load average {os.getloadavg()[0]:.1f}")
    print(
        f"{ROBOT}, {settings.criterion}, w = {settings.velocity_weight:g}, {settings.harmonics} "
        f"harmonics, {problem.samples} grid points"
    )
    first = arguments.seed
    compare_optimisers(problem, range(first, first + arguments.starts), arguments.budget)
    time_command(arguments.repeats)
    optimised = long_run(problem, exciter.optimise().optimum.x)
    ranked = ranked_random_motions(problem, arguments.random)
    compare_predictions(exciter, optimised, ranked)
    seeds = range(first, first + arguments.recordings)
    compare_identification(exciter, optimised, ranked, seeds)


if __name__ == "__main__":
    main()
