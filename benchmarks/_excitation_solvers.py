"""Three optimisers of the same excitation problem, and the points at which they ask for values.

What they are and how they are compared is said in `excitation.py`.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields

import casadi as ca
import numpy as np
from scipy.optimize import minimize

from deltaid.motion.excitation.optimize import optimise
from deltaid.motion.excitation.problem import Evaluation, ExcitationProblem, criterion

STEP = 1.5e-8  # of forward differences; SciPy's own choice
UNREACHABLE = 1e3  # value for a pose out of reach


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
class TracedProblem(ExcitationProblem):
    """The problem, remembering where deltaid's optimiser evaluates it."""

    visits: list[Visit] = field(default_factory=list)
    began: float = field(default_factory=time.process_time)

    def evaluate(self, x: np.ndarray, sharpness: float = 100.0) -> Evaluation:
        result = super().evaluate(x, sharpness)
        self.visits.append(Visit(time.process_time() - self.began, x.copy()))
        return result


def velocity_term(problem: ExcitationProblem, outputs: np.ndarray) -> float:
    """w‖q̇‖ of (9), from the graph's outputs, of which the drive speeds are the last."""
    relative = outputs[-problem.series.dof :] / problem.speed[:, None]
    return problem.velocity_weight * float(np.sqrt(np.mean(np.sum(relative**2, axis=0))))


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
    def seconds_left(self) -> float:
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
        problem = self._problem
        self.evaluations += 1
        s = problem.series.state(x, self._basis)
        out = problem.graph.regressor(s, threads=1)
        use = problem.use_of(s).max(axis=1)
        Y = problem.graph.dense(out[: -problem.series.dof])
        flat = (Y * np.sqrt(problem.row_weights)[None, :, None] * problem.scales).reshape(
            -1, Y.shape[2]
        )
        if not np.all(np.isfinite(flat)):
            return np.full(1 + len(use), UNREACHABLE)
        G = flat.T @ flat / len(Y) + problem.prior
        value = criterion(problem.criterion, G)[0] - velocity_term(problem, out)
        return np.nan_to_num(np.append(value, use), nan=UNREACHABLE, posinf=UNREACHABLE)


class OutOfTimeError(Exception):
    """Ends a solver that has no time limit of its own."""


def run_deltaid(problem: ExcitationProblem, seed: int) -> Trace:
    parts = {f.name: getattr(problem, f.name) for f in fields(problem)}
    traced = TracedProblem(**parts)
    optimum = optimise(traced, range(seed, seed + 1))
    seconds = time.process_time() - traced.began
    visits = [*traced.visits, Visit(seconds, optimum.x)]
    return Trace("deltaid", visits, len(traced.visits), seconds)


def run_slsqp(problem: ExcitationProblem, x_0: np.ndarray, budget: float) -> Trace:
    functions = Differences(problem, budget)

    def checked(x: np.ndarray) -> np.ndarray:
        if functions.seconds_left <= 0:
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
    functions = Differences(problem, budget)
    rows, n, dense = 1 + len(problem.two_sided), len(x_0), ca.Sparsity.dense
    inputs = [dense(n, 1), ca.Sparsity(rows, 1)]
    slopes = _Callback(functions.slopes, inputs, dense(rows, n))
    callback = _Callback(functions.values, inputs[:1], dense(rows, 1), slopes)
    x = ca.MX.sym("x", n)
    out = callback(x)
    low, high = np.transpose(problem.series.bounds())

    def solve(x_now: np.ndarray) -> np.ndarray:
        options = {
            "ipopt.hessian_approximation": "limited-memory",
            "ipopt.max_cpu_time": max(functions.seconds_left, 0.1),
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


class _Callback(ca.Callback):
    """Objective and limits as a CasADi function of the unknowns, or (with two inputs, the second of
    which is not needed) their Jacobian."""

    def __init__(
        self, function: Callable[[np.ndarray], np.ndarray], inputs: list[ca.Sparsity],
        output: ca.Sparsity, jacobian: ca.Callback | None = None,
    ) -> None:  # fmt: skip
        ca.Callback.__init__(self)
        self._function, self._inputs, self._output = function, inputs, output
        self._jacobian = jacobian
        self.construct("slopes" if jacobian is None else "values", {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._inputs[i]

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return self._output

    def has_jacobian(self) -> bool:
        return self._jacobian is not None

    def get_jacobian(self, *_: object) -> ca.Callback | None:
        return self._jacobian

    def eval(self, arguments: list[ca.DM]) -> list[np.ndarray]:
        return [self._function(np.array(arguments[0]).ravel())]


def _until_time_is_up(
    name: str, solve: Callable[[np.ndarray], np.ndarray], x: np.ndarray, functions: Differences
) -> Trace:
    """Solve, and again from the result, until the time is up or nothing moves."""
    try:
        while functions.seconds_left > 0:
            before, x = x, solve(x)
            if np.allclose(x, before, atol=1e-6):
                break
    except OutOfTimeError:
        pass
    seconds = time.process_time() - functions.began
    return Trace(name, functions.visits, functions.evaluations, seconds)
