"""Excitation motions: deltaid's optimiser against two usual ones, and what its motions are worth.

    pip install .
    python benchmarks/excitation.py [--quick]

One robot, one series, one set of limits, the default criterion, one thread a solver. Four parts:

Optimisers. From the same random starts, each on its own:
  deltaid  `deltaid.excitation.optimize.optimise` from one start: SLSQP, exact gradients, smooth
           maxima of the limits, tightened until they hold between the grid points.
  SLSQP    SciPy's, with forward differences; each limit is one constraint, its largest use on the
           grid, as one would write it with today's Python tools.
  IPOPT    that of CasADi's wheel on the same functions with the same differences, handed over as
           CasADi callbacks, limited-memory Hessian.
The other two get deltaid's compiled functions without derivatives, and one evaluation serves the
objective and all limits. That favours them: such functions are what they lack. They run until the
time is up, again from where they ended if they end early, or until that moves nothing.

What is compared is common to all: every point at which a solver asks for a value (not the
perturbed ones of a difference) is judged afterwards, off the clock, on a ten times finer grid with
the true sign of friction. A point that exceeds a limit there is pulled towards the feasible start
until it does not. Counted is the processor time of this process from the start, which on an idle
machine is the wall time; for deltaid it includes drawing the start, checks and tightening. An
evaluation is one call of the functions; deltaid's includes the gradients. Ratios compare the time
in which another solver has its best value, and 99 and 95 % of its way there from the start, with
the time in which deltaid has as good a value. The last line is deltaid's from as many starts as the
command makes, which is how it is used.

Command. Wall time of `deltaid excite` from nothing to a file, in a process of its own.

Predictions. Standard deviations of the base parameters that least squares will have, by deltaid's
prediction, for recordings of equal length: the optimised run against the best of many random
feasible motions, best by the same criterion, and against the one in their middle.

Identification. Recordings of a robot with known parameters, one for each seed, along the optimised
run and along random motions with the same limits: equal length, rate, encoder steps and torque
noise in N m. `deltaid.identify` gets times, angles and torques. Errors are against the truth: M by
its entries' largest errors along a third motion, relative to each entry's mean; friction by its
worst coefficient; base parameters in units of the prior's standard deviation.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy comes in, so that one core is one core
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"

import casadi as ca
import numpy as np
import polars as pl
import scipy
from _timing import machine
from scipy.optimize import minimize

import deltaid
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.excitation.excite import ExcitationSettings, Exciter
from deltaid.excitation.optimize import largest_use, optimise, random_start
from deltaid.excitation.problem import Evaluation, ExcitationProblem
from deltaid.excitation.run import Run, plan_run
from deltaid.identification.demo import mass_matrix_error
from deltaid.identification.regularizer import parameter_scale
from deltaid.motion.surrogate import SensorNoise, surrogate_parameters
from deltaid.robot.load import load_robot

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
ROBOT = "irb360-6-1600"
FINER = 10  # the grid that points are judged on, against the one that is optimised on
STEP = 1.5e-8  # of forward differences; SciPy's own choice
UNREACHABLE = 1e3  # value for a pose out of reach
DURATION, RATE = 10.0, 1000.0
SHARES = (1.0, 0.99, 0.95)  # of a solver's way from the start to its best value
THIRD = 999_999  # seed of the motion along which mass matrices are compared
COMMAND = [sys.executable, "-c", "from deltaid.cli import main; main()"]


@dataclass(frozen=True)
class Visit:
    """A point at which a solver asked for a value, and when it had it [s]."""

    seconds: float
    x: np.ndarray


@dataclass(frozen=True)
class Trace:
    """What a solver did from one start; `seconds` is when it ended."""

    name: str
    visits: list[Visit]
    evaluations: int
    seconds: float


@dataclass(frozen=True)
class Curve:
    """Best feasible value so far over time [s]; the first is that of the start."""

    seconds: np.ndarray
    values: np.ndarray

    @property
    def best(self) -> float:
        """The last and lowest value."""
        return float(self.values[-1])

    def after(self, share: float) -> float:
        """The value after a share of the way from the start to the best."""
        return float((1 - share) * self.values[0] + share * self.values[-1])

    def at(self, seconds: float) -> float:
        """Best value at a time."""
        reached = np.flatnonzero(self.seconds <= seconds)
        return float(self.values[reached[-1]]) if len(reached) else np.inf

    def time_to(self, value: float) -> float:
        """First time at which a value is reached; infinite if never."""
        reached = np.flatnonzero(self.values <= value)
        return float(self.seconds[reached[0]]) if len(reached) else np.inf


@dataclass(frozen=True)
class TracedProblem(ExcitationProblem):
    """The problem, remembering where deltaid's optimiser evaluates it."""

    visits: list[Visit] = field(default_factory=list)
    began: float = field(default_factory=time.process_time)

    def evaluate(self, x: np.ndarray, sharpness: float = 100.0) -> Evaluation:
        """As the problem's own."""
        result = super().evaluate(x, sharpness)
        self.visits.append(Visit(time.process_time() - self.began, x.copy()))
        return result


class Judge:
    """The common measure: exact objective, limits on the fine grid, nothing on any clock."""

    def __init__(self, problem: ExcitationProblem, x_0: np.ndarray) -> None:
        self._problem, self._x_0 = problem, x_0
        self._samples = FINER * problem.samples
        if not self._feasible(x_0):
            raise ValueError("the start is not feasible on the fine grid")

    def curve(self, trace: Trace, budget: float) -> Curve:
        """Best feasible value over time.

        Points that would not be the best so far even with the limits left out are passed over.
        """
        best, seconds, values = np.inf, [], []
        for visit in trace.visits:
            if visit.seconds > budget or self.value(visit.x) >= best:
                continue
            value = self.value(self._pulled(visit.x))
            if value < best:
                best = value
                seconds.append(visit.seconds)
                values.append(value)
        return Curve(np.array(seconds), np.array(values))

    def value(self, x: np.ndarray) -> float:
        """Exact objective, limits left out."""
        problem = self._problem
        s = problem.series.state(x, problem.grid(self._samples))
        value = problem.criterion.evaluate(problem.information(x, self._samples))[0]
        value -= velocity_term(problem, problem.graph.regressor(s, threads=1))
        return value if np.isfinite(value) else np.inf

    def _feasible(self, x: np.ndarray) -> bool:
        return bool(largest_use(self._problem, x, self._samples).max() <= 1.0)

    def _pulled(self, x: np.ndarray) -> np.ndarray:
        """x, or the point furthest from the start on the way to it that keeps all limits."""
        if self._feasible(x):
            return x
        low, high = 0.0, 1.0
        for _ in range(12):
            middle = 0.5 * (low + high)
            inside = self._feasible(self._x_0 + middle * (x - self._x_0))
            low, high = (middle, high) if inside else (low, middle)
        return self._x_0 + low * (x - self._x_0)


def velocity_term(problem: ExcitationProblem, outputs: np.ndarray) -> float:
    """w‖q̇‖ of (9), from the graph's outputs, of which the drive speeds are the last."""
    relative = outputs[-problem.series.dof :] / problem.velocity.speed[:, None]
    return problem.velocity.weight * float(np.sqrt(np.mean(np.sum(relative**2, axis=0))))


class Differences:
    """Objective and largest use of each limit on the grid, with forward differences.

    The last point and the last slopes are remembered, so that objective and limits share them.
    """

    def __init__(self, problem: ExcitationProblem, budget: float) -> None:
        self._problem, self._basis, self._budget = problem, problem.grid(), budget
        self._point, self._values = b"", np.empty(0)
        self._slope_point, self._slopes = b"", np.empty(0)
        self.visits: list[Visit] = []
        self.evaluations = 0
        self.began = time.process_time()

    @property
    def left(self) -> float:
        """Time left [s]."""
        return self._budget - (time.process_time() - self.began)

    def values(self, x: np.ndarray) -> np.ndarray:
        """[objective, use of each limit]; a visit."""
        if x.tobytes() != self._point:
            self._point, self._values = x.tobytes(), self._evaluate(x)
            self.visits.append(Visit(time.process_time() - self.began, x.copy()))
        return self._values

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Their derivatives, one more evaluation for each unknown."""
        if x.tobytes() != self._slope_point:
            here = self.values(x)
            there = [self._evaluate(x + STEP * e) for e in np.eye(len(x))]
            self._slope_point = x.tobytes()
            self._slopes = np.ascontiguousarray((np.array(there) - here).T / STEP)
        return self._slopes

    def _evaluate(self, x: np.ndarray) -> np.ndarray:
        problem, weighting = self._problem, self._problem.weighting
        self.evaluations += 1
        s = problem.series.state(x, self._basis)
        out = problem.graph.regressor(s, threads=1)
        u = problem.limits_of(s)
        use = np.where(problem.two_sided[:, None], np.abs(u), u).max(axis=1)
        Y = problem.graph.dense(out[: -problem.series.dof])
        flat = (Y * np.sqrt(weighting.rows)[None, :, None] * weighting.columns).reshape(
            -1, Y.shape[2]
        )
        if not np.all(np.isfinite(flat)):
            return np.full(1 + len(use), UNREACHABLE)
        G = flat.T @ flat / len(Y) + weighting.prior
        value = problem.criterion.evaluate(G)[0] - velocity_term(problem, out)
        return np.nan_to_num(np.append(value, use), nan=UNREACHABLE, posinf=UNREACHABLE)


class OutOfTimeError(Exception):
    """Ends a solver that has no time limit of its own."""


def run_deltaid(problem: ExcitationProblem, seed: int) -> Trace:
    """deltaid's optimiser from one start."""
    parts = {f.name: getattr(problem, f.name) for f in fields(problem)}
    traced = TracedProblem(**parts)
    optimum = optimise(traced, range(seed, seed + 1))
    seconds = time.process_time() - traced.began
    visits = [*traced.visits, Visit(seconds, optimum.x)]
    return Trace("deltaid", visits, len(traced.visits), seconds)


def run_slsqp(problem: ExcitationProblem, x_0: np.ndarray, budget: float) -> Trace:
    """SciPy's SLSQP with differences."""
    functions = Differences(problem, budget)

    def checked(x: np.ndarray) -> np.ndarray:
        if functions.left <= 0:
            raise OutOfTimeError
        return functions.values(x)

    def solve(x: np.ndarray) -> np.ndarray:
        limits = {
            "type": "ineq",
            "fun": lambda x: 1.0 - checked(x)[1:],
            "jac": lambda x: -functions.slopes(x)[1:],
        }
        return minimize(
            lambda x: checked(x)[0],
            x,
            jac=lambda x: functions.slopes(x)[0],
            bounds=problem.series.bounds(),
            constraints=[limits],
            method="SLSQP",
            options={"maxiter": 1000, "ftol": 1e-6},
        ).x

    return _until_time_is_up("SciPy SLSQP", solve, x_0, functions)


def run_ipopt(problem: ExcitationProblem, x_0: np.ndarray, budget: float) -> Trace:
    """CasADi's IPOPT with differences."""
    functions = Differences(problem, budget)
    shape = (1 + len(problem.two_sided), len(x_0))
    callback = _Values(functions, shape)
    x = ca.MX.sym("x", shape[1])
    out = callback(x)
    low, high = np.transpose(problem.series.bounds())

    def solve(x_now: np.ndarray) -> np.ndarray:
        options = {
            "ipopt.hessian_approximation": "limited-memory",
            "ipopt.max_cpu_time": max(functions.left, 0.1),
            "ipopt.max_iter": 1_000_000,
            "ipopt.tol": 1e-5,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "print_time": False,
        }
        solver = ca.nlpsol("solver", "ipopt", {"x": x, "f": out[0], "g": out[1:]}, options)
        found = solver(x0=x_now, lbx=low, ubx=high, lbg=-np.inf, ubg=1.0)
        return np.array(found["x"]).ravel()

    return _until_time_is_up("CasADi IPOPT", solve, x_0, functions)


class _Values(ca.Callback):
    """Objective and limits as a CasADi function of the unknowns."""

    def __init__(self, functions: Differences, shape: tuple[int, int]) -> None:
        ca.Callback.__init__(self)
        self._functions, self._shape = functions, shape
        self._slopes = _Slopes(functions, shape)
        self.construct("values", {})

    def get_sparsity_in(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._shape[1], 1)

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._shape[0], 1)

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, *_: object) -> ca.Callback:
        return self._slopes

    def eval(self, arguments: list[ca.DM]) -> list[np.ndarray]:
        return [self._functions.values(np.array(arguments[0]).ravel())]


class _Slopes(ca.Callback):
    """Their Jacobian; its second argument, the value, is not needed."""

    def __init__(self, functions: Differences, shape: tuple[int, int]) -> None:
        ca.Callback.__init__(self)
        self._functions, self._shape = functions, shape
        self.construct("slopes", {})

    def get_n_in(self) -> int:
        return 2

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        rows, columns = self._shape
        return ca.Sparsity.dense(columns, 1) if i == 0 else ca.Sparsity(rows, 1)

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self._shape)

    def eval(self, arguments: list[ca.DM]) -> list[np.ndarray]:
        return [self._functions.slopes(np.array(arguments[0]).ravel())]


def _until_time_is_up(
    name: str,
    solve: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    functions: Differences,
) -> Trace:
    """Solve, and again from the result, until the time is up or nothing moves."""
    try:
        while functions.left > 0:
            before, x = x, solve(x)
            if np.allclose(x, before, atol=1e-6):
                break
    except OutOfTimeError:
        pass
    seconds = time.process_time() - functions.began
    return Trace(name, functions.visits, functions.evaluations, seconds)


@dataclass(frozen=True)
class Comparison:
    """Another solver's curve beside deltaid's from the same start."""

    ours: Curve
    theirs: Curve

    def ratio(self, share: float = 1.0) -> float:
        """Their time for a share of their way over our time to as good a value; 0 if never."""
        value = self.theirs.after(share)
        return self.theirs.time_to(value) / self.ours.time_to(value)

    @property
    def then(self) -> float:
        """Our value when they have their best."""
        return self.ours.at(self.theirs.time_to(self.theirs.best))


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
            print(f"{_line(trace, pair.theirs)}  {_beside(pair)}", flush=True)
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
    """Best value and effort of one solver."""
    each = 1e3 * trace.seconds / trace.evaluations
    return (
        f"  {trace.name:12} {curve.best:8.4f} {curve.time_to(curve.best):7.2f} "
        f"{trace.seconds:7.2f} {trace.evaluations:11,} {each:8.2f}"
    )


def _beside(pair: Comparison) -> str:
    """Where deltaid stands when another solver has its best value, and the ratios of times."""
    at = pair.ours.time_to(pair.theirs.best)
    when = f"{at:.2f} s" if at < np.inf else "never"
    ratios = [f"{pair.ratio(share):.0f}" if pair.ratio(share) else "–" for share in SHARES]
    return f"{when:>17} {pair.then:12.4f} {ratios[0]:>6} {ratios[1]:>5} {ratios[2]:>5}"


def _summary(pairs: list[Comparison]) -> str:
    """Median ratios, and from how many starts deltaid has what is aimed at."""
    medians = [statistics.median(one.ratio(share) for one in pairs) for share in SHARES]
    tenth = sum(one.ratio() >= 10 for one in pairs)
    better = sum(one.then < one.theirs.best for one in pairs)
    return (
        f"median ratios {', '.join(f'{one:.0f}' for one in medians)}; of {len(pairs)} starts "
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
            start = time.perf_counter()
            subprocess.run(
                [*COMMAND, "excite", ROBOT, "-o", str(path)],
                check=True,
                capture_output=True,
                env=environment,
            )
            seconds.append(time.perf_counter() - start)
            rows = pl.read_csv(path).height
    print(f"\nCOMMAND deltaid excite {ROBOT} -o motion.csv, {os.cpu_count()} cores")
    print(
        f"  {statistics.median(seconds):.1f} s (median of {repeats}, from {min(seconds):.1f} to "
        f"{max(seconds):.1f}), {rows:,} rows"
    )


def ranked_random_motions(problem: ExcitationProblem, count: int) -> list[int]:
    """Seeds of random feasible motions, the best by the criterion first."""

    def score(seed: int) -> float:
        G = problem.information(random_start(problem, seed), FINER * problem.samples)
        return problem.criterion.evaluate(G)[0]

    return sorted(range(count), key=score)


def long_run(problem: ExcitationProblem, x: np.ndarray) -> Run:
    """A run from rest of at least the duration of a recording."""
    motion = problem.series.motion(x)
    return plan_run(problem, motion, int(np.ceil(DURATION / motion.period)))


def predicted(exciter: Exciter, run: Run) -> np.ndarray:
    """Predicted standard deviations for a recording of the common duration."""
    std = np.array([one.std for one in exciter.predict(run)])
    return std * np.sqrt(run.duration / DURATION)


def compare_predictions(exciter: Exciter, optimised: Run, ranked: list[int]) -> None:
    """How much smaller standard deviations become."""
    ours, problem = predicted(exciter, optimised), exciter.problem
    print(f"\nPREDICTIONS, {len(ours)} base parameters, recordings of {DURATION:g} s")
    print("standard deviation on the random motion / on the optimised run")
    print(f"{'random feasible motion':24} {'median':>7} {'smallest':>9} {'largest':>8}")
    count = len(ranked)
    for name, seed in ((f"best of {count}", ranked[0]), ("the middle one", ranked[count // 2])):
        ratio = predicted(exciter, long_run(problem, random_start(problem, seed))) / ours
        print(f"  {name:22} {np.median(ratio):7.2f} {ratio.min():9.2f} {ratio.max():8.2f}")
        worse = [exciter.base.formulas[i] for i in np.argsort(ratio) if ratio[i] < 1]
        print(f"    less certain when optimised: {', '.join(worse) or 'none'}")


def record(exciter: Exciter, run: Run, p: np.ndarray, rng: np.random.Generator) -> pl.DataFrame:
    """A recording as a drive would log it; the torque noise has the same size on every motion."""
    noise = SensorNoise()
    z, zd, zdd = run.evaluate(np.arange(round(DURATION * RATE)) / RATE)
    q, qd, qdd = exciter.dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = exciter.dynamics.torque(z, qd, qdd, p)
    tau = tau + noise.torque * exciter.torque_reference * rng.standard_normal(tau.shape)
    q = np.round(q / noise.encoder_step) * noise.encoder_step
    columns = {"t": np.arange(len(q)) / RATE}
    columns |= {f"q{i + 1}": q[:, i] for i in range(q.shape[1])}
    columns |= {f"tau{i + 1}": tau[:, i] for i in range(q.shape[1])}
    return pl.DataFrame(columns)


def errors(exciter: Exciter, result: deltaid.Identification, truth: np.ndarray) -> list[float]:
    """M on and off the diagonal, friction [%], base parameters median and largest [prior's std].

    Base parameters that the description's structure makes zero do not count.
    """
    dynamics, problem, p = exciter.dynamics, exciter.problem, result.model.p
    third = problem.series.motion(random_start(problem, THIRD))
    z, _, _ = third.evaluate(np.linspace(0, third.period, 500))
    on, off = mass_matrix_error(dynamics, z, truth, p)
    friction = slice(dynamics.layout.viscous.start, dynamics.layout.coulomb.stop)
    worst = np.max(np.abs(p[friction] / truth[friction] - 1))
    combination, prior = exciter.base.combination(), prior_parameters(dynamics.robot)
    spread = exciter.settings.prior_spread * parameter_scale(exciter.base.layout, prior)
    size = np.linalg.norm(combination * spread, axis=1)
    free = np.any(combination[:, np.any(result.reduction.A != 0, axis=1)] != 0, axis=1)
    base = (np.abs(combination @ (p - truth)) / size)[free]
    return [100 * on, 100 * off, 100 * float(worst), float(np.median(base)), float(base.max())]


def compare_identification(
    exciter: Exciter, optimised: Run, ranked: list[int], seeds: range
) -> None:
    """Identify along each kind of motion for every seed; medians and worst cases."""
    problem, robot = exciter.problem, exciter.dynamics.robot
    best = long_run(problem, random_start(problem, ranked[0]))
    kinds: dict[str, Callable[[int], Run]] = {
        "random, one a seed": lambda seed: long_run(problem, random_start(problem, seed)),
        f"best of {len(ranked)} random": lambda _: best,
        "optimised": lambda _: optimised,
    }
    print(f"\nIDENTIFICATION, {DURATION:g} s at {RATE:g} Hz, median (worst) of {len(seeds)} seeds")
    heads = ("M on %", "M off %", "friction %", "base median", "base largest")
    print(f"{'':20}" + "".join(f"{head:>17}" for head in heads))
    for name, run_of in kinds.items():
        rows = []
        for seed in seeds:
            rng = np.random.default_rng(seed)
            truth = surrogate_parameters(robot, rng)
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "recording.parquet"
                record(exciter, run_of(seed), truth, rng).write_parquet(path)
                rows.append(errors(exciter, deltaid.identify(robot, [path]), truth))
        cells = zip(np.median(rows, axis=0), np.max(rows, axis=0), strict=True)
        print(f"  {name:18}" + "".join(f"{f'{m:.2g} ({w:.2g})':>17}" for m, w in cells))


def main() -> int:
    """Measure and print."""
    arguments = _arguments()
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
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="excitation motions: time, value, what they buy")
    parser.add_argument("--starts", type=int, default=3, help="starts of the optimisers")
    parser.add_argument("--budget", type=float, default=30.0, help="time of the others [s]")
    parser.add_argument("--repeats", type=int, default=3, help="runs of the command")
    parser.add_argument("--random", type=int, default=1000, help="random motions to choose from")
    parser.add_argument("--recordings", type=int, default=5, help="recordings of each kind")
    parser.add_argument("--seed", type=int, default=0, help="of the first start and recording")
    parser.add_argument("--quick", action="store_true", help="a short run that shows the way")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.starts, arguments.budget, arguments.repeats = 1, 5.0, 1
        arguments.random, arguments.recordings = 100, 1
    return arguments


if __name__ == "__main__":
    sys.exit(main())
