"""Excitation motions, optimised from several starts and feasible between the grid points too."""

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Event

import numpy as np
from jaxtyping import Float
from scipy import optimize
from threadpoolctl import threadpool_limits

from deltaid.errors import DeltaidError
from deltaid.motion.excitation.problem import Evaluation, ExcitationProblem, Judge, Vector
from deltaid.motion.fourier import FourierMotion

# Sharpness of the limits' smooth maxima: blunt first, so that the solver sees whole stretches of
# the motion, then so sharp that at most about 1 % of a limit is given away.
_SHARPNESS = (30.0, 300.0)
_FINER = 10  # the grid on which feasibility is checked, against the one that is optimised on
_ROUNDS = 8  # of tightening
_CENTRES = 300  # poses tried for a start whose middle of the workspace exceeds a limit
_SLIGHT = 1.1  # an excess that tightening can mend; beyond it the limits fight
_ITERATIONS = 250  # of the solver, at most
# Use that counts as full on the fine grid: the rest is for what lies between its points.
_FULL = 0.9995
_SMALLEST_BOX = 0.1  # half its width, as a share of the workspace
_UNREACHABLE = 1e3  # stands for objective, use and slopes of a pose out of reach


@dataclass(frozen=True)
class StartAccount:
    """What became of one start.

    Attributes:
        seed: of its random coefficients.
        before, after: the objective at the start and at the end.
        use: largest use of any limit on the fine grid.
        evaluations, seconds: the effort.
        message: the solver's own word.
        judged: what another judge says of the motion, smaller is better; None without one.
    """

    seed: int
    before: float
    after: float
    use: float
    evaluations: int
    seconds: float
    message: str
    judged: float | None = None

    @property
    def merit(self) -> float:
        """What feasible motions are compared by: the judge's word, or the objective."""
        return self.after if self.judged is None else self.judged

    @property
    def feasible(self) -> bool:
        """Whether all limits hold on the fine grid."""
        return self.use <= _FULL


@dataclass(frozen=True)
class Optimum:
    """The best feasible motion with the account of every start, of `best` its own."""

    x: Vector
    motion: FourierMotion
    best: StartAccount
    accounts: tuple[StartAccount, ...]


Progress = Callable[[StartAccount], None]


def optimise(
    problem: ExcitationProblem,
    seeds: range,
    *,
    stop: Event | None = None,
    progress: Progress = lambda _: None,
    judge: Judge | None = None,
) -> Optimum:
    """The best feasible motion from several starts, on all cores.

    The matrices are small, so BLAS gets one thread: more of them only wait for one another.

    Args:
        seeds: one start for each; the same seeds give the same motion.
        stop: when set, running searches end and the best feasible motion so far is returned.
        progress: called when a start has ended.
        judge: which of the feasible results is best, where it is not the objective that says so.

    Raises:
        DeltaidError: no start led to a feasible motion; says which limits fight.
    """
    stop, results = stop or Event(), []
    with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
        for account, x in pool.map(lambda seed: _from_start(problem, seed, stop), seeds):
            if judge is not None and account.feasible:
                account = replace(account, judged=judge(problem.series.motion(x)))
            progress(account)
            results.append((account, x))
    feasible = [(account, x) for account, x in results if account.feasible]
    if not feasible:
        raise conflict(problem, results[0][1])
    best, x = min(feasible, key=lambda pair: pair[0].merit)
    return Optimum(x, problem.series.motion(x), best, tuple(account for account, _ in results))


def random_start(problem: ExcitationProblem, seed: int) -> Vector:
    """A random motion as large as the limits allow; coefficients fall with the harmonic.

    At rest in the middle of the workspace when even that exceeds a limit.
    """
    rng, series = np.random.default_rng(seed), problem.series
    shape = rng.standard_normal((series.dof, 2, series.harmonics))
    shape *= np.arange(1, series.harmonics + 1) ** -1.0
    x = _resting(problem, rng)
    x[0] = rng.uniform(np.log(series.slowest), np.log(series.fastest))
    moved = np.hstack([np.zeros((series.dof, 1)), shape.reshape(series.dof, -1)])
    direction, low, high = np.insert(moved.ravel(), 0, 0.0), 0.0, 2.0
    for _ in range(25):
        middle = 0.5 * (low + high)
        inside = largest_use(problem, x + middle * direction).max() <= 0.95
        low, high = (middle, high) if inside else (low, middle)
    return x + low * direction


def _resting(problem: ExcitationProblem, rng: np.random.Generator) -> Vector:
    """Rest in the middle of the workspace; where that exceeds a limit, at a better random point."""
    series, moves = problem.series, problem.graph.dynamics.robot.task.moves
    centres, x = np.zeros((_CENTRES, series.dof)), np.zeros(series.length)
    centres[1:, moves] = rng.uniform(-1, 1, (_CENTRES - 1, moves.stop))
    z = series.centre + centres * series.size
    use = problem.use_of(np.hstack([z, np.zeros((_CENTRES, 2 * series.dof))]).T).max(axis=0)
    best = 0 if use[0] <= 0.8 else int(np.argmin(use))
    x[1:].reshape(series.dof, -1)[:, 0] = centres[best]
    return x


def largest_use(
    problem: ExcitationProblem, x: Vector, samples: int | None = None
) -> Float[np.ndarray, " limits"]:
    """Largest use of every limit on a grid; infinite where a pose is out of reach."""
    basis = problem.grid(samples or problem.samples)
    return problem.use_of(problem.series.state(x, basis)).max(axis=1)


def _from_start(problem: ExcitationProblem, seed: int, stop: Event) -> tuple[StartAccount, Vector]:
    """Optimise from one start, then tighten limits until they hold between the grid points."""
    began, fine = time.perf_counter(), _FINER * problem.samples
    x_0, search = random_start(problem, seed), _Search(problem, stop)
    before, x, message = problem.evaluate(x_0).value, x_0, "stopped"
    for sharpness in _SHARPNESS:
        x, message = search.run(x, sharpness)
    for _ in range(_ROUNDS):
        use = largest_use(problem, x, fine)
        if use.max() <= _FULL or use.max() > _SLIGHT or stop.is_set():
            break
        search.bound = np.where(use > _FULL, search.bound * _FULL / use - 1e-3, search.bound)
        x, message = search.run(x, _SHARPNESS[-1])
    use = largest_use(problem, x, fine).max()
    for other in (search.best, x_0):  # the start itself is feasible, unless the limits fight
        if use > _FULL and other is not None:
            other_use = largest_use(problem, other, fine).max()
            if other_use <= _FULL:
                x, use, message = other, other_use, f"went back to a feasible motion ({message})"
    after = problem.evaluate(x).value
    use, seconds = float(use) if np.isfinite(after) else np.inf, time.perf_counter() - began
    return StartAccount(seed, before, after, use, search.evaluations, seconds, message), x


class _Search:
    """Sequential quadratic programming on the smooth problem, with a `bound` of each limit that can
    be tightened. `best` is the best point that kept all, for when the search is stopped."""

    def __init__(self, problem: ExcitationProblem, stop: Event) -> None:
        self._problem, self._stop, self.bound = problem, stop, np.ones(len(problem.two_sided))
        self._last: tuple[bytes, Evaluation] | None = None
        self.best: Vector | None = None
        self._best_value, self.evaluations = np.inf, 0

    def run(self, x: Vector, sharpness: float) -> tuple[Vector, str]:
        """Minimise the smooth problem from x, in a smaller box where steps end beyond limits."""
        x_0, radius = x, np.inf
        while True:
            x, message = self._minimised(x_0, sharpness, radius)
            use = largest_use(self._problem, x)
            if np.all(use <= _SLIGHT * self.bound) or radius < _SMALLEST_BOX or self._stop.is_set():
                return x, message
            radius = 0.5 * min(radius, 1.0)

    def _minimised(self, x: Vector, sharpness: float, radius: float) -> tuple[Vector, str]:
        """Minimise within a box of coordinates about x."""

        def evaluated(x: Vector) -> Evaluation:
            key = x.tobytes() + np.float64(sharpness).tobytes()
            if self._last is None or key != self._last[0]:
                self._last = key, self._problem.evaluate(x, sharpness)
                self.evaluations += 1
            return self._last[1]

        def watch(x: Vector) -> None:
            here = evaluated(x)
            if here.value < self._best_value and np.all(here.use <= self.bound + 1e-3):
                self.best, self._best_value = x.copy(), here.value
            if self._stop.is_set():
                raise StopIteration

        result = optimize.minimize(
            lambda x: evaluated(x).value if np.isfinite(evaluated(x).value) else _UNREACHABLE,
            x,
            jac=lambda x: np.ascontiguousarray(_finite(evaluated(x).gradient)),
            bounds=[
                (max(low, middle - radius), min(high, middle + radius))
                for (low, high), middle in zip(self._problem.series.bounds(), x, strict=True)
            ],
            constraints=[
                {
                    "type": "ineq",
                    "fun": lambda x: self.bound - _finite(evaluated(x).use),
                    "jac": lambda x: -_finite(evaluated(x).slopes),
                }
            ],
            method="SLSQP",
            callback=watch,
            options={"maxiter": _ITERATIONS, "ftol": 1e-5},
        )
        return np.asarray(result.x), str(result.message)


def _finite(values: np.ndarray) -> np.ndarray:
    """Numbers for a pose out of reach, large enough that the line search steps back."""
    return np.nan_to_num(values, nan=_UNREACHABLE, posinf=_UNREACHABLE, neginf=-_UNREACHABLE)


def conflict(problem: ExcitationProblem, x: Vector) -> DeltaidError:
    """Which limits fight: those in use to the full where the largest excess is smallest."""
    use = _least_excess(problem, x)
    worst = use.max()
    names = [name for name, u in zip(problem.limit_names, use, strict=True) if u > worst - 0.02]
    return DeltaidError(
        f"no motion keeps all limits; at best {', '.join(names)} "
        f"{'is' if len(names) == 1 else 'are'} exceeded by {100 * (worst - 1):.2g} %",
        where=problem.graph.dynamics.robot.name,
        cure="these limits fight each other or the robot's geometry: widen one of them in the "
        "description (workspace, drive_limits, strut_swing_deg, stroke, largest_condition)",
    )


def _least_excess(problem: ExcitationProblem, x: Vector) -> Float[np.ndarray, " limits"]:
    """Use of every limit where the largest of them is as small as possible."""
    last = len(x)

    def evaluated(y: Vector) -> Evaluation:
        return problem.evaluate(y[:last])

    result = optimize.minimize(
        lambda y: y[last],
        np.append(0.01 * x, largest_use(problem, 0.01 * x).clip(max=10.0).max()),
        jac=lambda _: np.eye(last + 1)[last],
        bounds=[*problem.series.bounds(), (0.0, 1e3)],
        constraints=[
            {
                "type": "ineq",
                "fun": lambda y: y[last] - _finite(evaluated(y).use),
                "jac": lambda y: np.column_stack(
                    [-_finite(evaluated(y).slopes), np.ones(len(problem.two_sided))]
                ),
            }
        ],
        method="SLSQP",
        options={"maxiter": _ITERATIONS, "ftol": 1e-6},
    )
    return largest_use(problem, result.x[:last])
