"""From the information to the parameters: deltaid's two solvers and CVXPY on the same problem.

    pip install '.[benchmark]'
    python benchmarks/fit.py

A surrogate robot with known truth is recorded twice: as a drive would log it (encoder steps, 2 %
torque noise; positions and torques only) and without noise, with velocities and accelerations.
Times are CPU times on one thread from the recordings' triangular factors to the solution: γ from
the data, the objective, the solution; for CVXPY the same problem built, compiled, solved and read
back, 'solver' being the part that its solver reports. What the description alone decides stands on
a line of its own. J is evaluated by the same function for all, its difference from the conic
optimum in units of γ. Errors against the truth: M by its entries' largest along another motion,
relative to each entry's mean; friction by its worst coefficient.

The CVXPY problem is written independently of deltaid's (_cvxpy_fit.py). The run fails if the optima
differ by more than the solvers' tolerances explain, or if CVXPY's own value of J is not that of
deltaid's function; also for torques that no robot produces, where the constraints decide.
"""

import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import _alone  # noqa: F401
import numpy as np
from _cvxpy_fit import CvxpyFit, CvxpySolution, Metric
from _timing import machine, measure, options

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.conic import Conic
from deltaid.estimation.information import Information, gather_samples, merge
from deltaid.estimation.log_cholesky import LogCholesky
from deltaid.estimation.objective import Solution, default_gamma, pose
from deltaid.estimation.reduction import build_reduction
from deltaid.identification.demo import mass_matrix_error
from deltaid.identification.gathering import gather
from deltaid.model.record import Settings
from deltaid.motion.fourier import FourierMotion
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import (
    SensorNoise,
    simulate_recording,
    surrogate_parameters,
)
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import pseudo_inertia
from deltaid.robot.load import load_robot

ROBOT, DURATION, RATE = "irb360-6-1600", 20.0, 1000.0
Result = TypeVar("Result")
CPU = time.process_time
METRICS: tuple[Metric, ...] = ("euclidean", "entropic")
# Both interior-point solvers stop at 1e-9 of what they see of J (the part that parameters can
# change, in units of γ) in gap and in feasibility; ten times that is what they may differ by.
TOLERANCE = 1e-8
# The regulariser for the impossible robot, with which all kinds of cones hold the optimum back.
EDGE_GAMMA = 1e-4
PAPER = "the publication (Sec. VII)", "< 1", "about 2", "< 2.2"


@dataclass(frozen=True)
class Truth:
    """The surrogate robot, and the motion along which mass matrices are compared."""

    dynamics: Dynamics
    p: np.ndarray
    motion: FourierMotion

    def errors(self, p: np.ndarray) -> tuple[float, float, float]:
        """Errors [%] of M on and off the diagonal, and of friction, as the largest of each."""
        z, _, _ = self.motion.evaluate(np.linspace(0, self.motion.period, 500))
        diagonal, off_diagonal = mass_matrix_error(self.dynamics, z, self.p, p)
        layout = self.dynamics.layout
        friction = slice(layout.viscous.start, layout.coulomb.stop)
        worst = float(np.max(np.abs(p[friction] / self.p[friction] - 1)))
        return 100 * diagonal, 100 * off_diagonal, 100 * worst


def recorded(
    dynamics: Dynamics,
    p: np.ndarray,
    motion: FourierMotion,
    rng: np.random.Generator,
    noise: SensorNoise | None,
) -> Information:
    """The factors of a recording."""
    recording = simulate_recording(
        dynamics, p, motion, rng, duration=DURATION, rate=RATE, noise=noise
    )
    return merge(gather(dynamics, with_filter(open_log(recording, dynamics.kinematics))))


def impossible(dynamics: Dynamics, p: np.ndarray, motion: FourierMotion) -> Information:
    """The factors of torques that no robot produces: all friction and rotor inertias negative,
    centres of mass further out than their bodies' radii of gyration."""
    p, layout = p.copy(), dynamics.layout
    for body in layout.bodies:
        part = layout.body(body)
        length = np.sqrt(np.trace(pseudo_inertia(p[part])[:3, :3]) / p[part][0])
        free = [entry in dynamics.robot.bodies[body].free for entry in ("mcx", "mcy", "mcz")]
        p[part][1:4] += np.where(free, 2 * p[part][0] * length, 0.0)
    p[layout.viscous.start :] *= -1
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, 1000, endpoint=False))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    return gather_samples(dynamics, z, qd, qdd, dynamics.torque(z, qd, qdd, p))


@dataclass(frozen=True)
class Run:
    """One solver on one problem; times in s, `solver_seconds` is nan where it is not known."""

    name: str
    seconds: float
    solver_seconds: float
    x: np.ndarray
    status: str


class Problem:
    """One fit, posed for all solvers. The methods are what is counted.

    Raises:
        ValueError: CVXPY's free variables are not deltaid's.
    """

    def __init__(
        self, robot: RobotDescription, information: Information, settings: Settings
    ) -> None:
        self.robot, self.information, self.settings = robot, information, settings
        self.reduction = build_reduction(robot, information.columns)
        self._theirs = CvxpyFit(robot, information.columns)
        if tuple(self._theirs.names) != self.reduction.names:
            raise ValueError("the free variables are not the same")
        self.objective = pose(information, self.reduction, settings)

    def conic(self) -> Solution:
        """From the factors to the global optimum."""
        objective = pose(self.information, self.reduction, self.settings)
        return Conic().solve(objective)

    def log_cholesky(self) -> Solution:
        """From the factors to the publication's kind of solution."""
        objective = pose(self.information, self.reduction, self.settings)
        return LogCholesky().solve(objective)

    def cvxpy(self, solver: str) -> CvxpySolution:
        """The same by CVXPY; its status says what its warning would."""
        settings = self.settings
        gamma = settings.gamma or default_gamma(self.information, settings.prior_spread)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            return self._theirs.solve(self.information, gamma, settings.regularizer, solver)


def main() -> int:
    """Measure, print, check; 1 if CVXPY and conic disagree."""
    arguments = options(__doc__, robot=ROBOT, repeats=21, seed=0, scs=False)
    rng = np.random.default_rng(arguments.seed)
    dynamics = Dynamics(load_robot(arguments.robot))
    p = surrogate_parameters(dynamics.robot, rng)
    motion, other = (random_motion(dynamics.kinematics, rng) for _ in range(2))
    truth = Truth(dynamics, p, other)
    solvers = ("CLARABEL", "SCS") if arguments.scs else ("CLARABEL",)
    print(f"{machine()}\n{arguments.robot}, {DURATION:g} s at {RATE:g} Hz, seed {arguments.seed}")
    print(f"CPU times: median of {arguments.repeats}, log-cholesky and SCS of 3")
    bad: list[str] = []
    for name, noise in (("noisy", SensorNoise()), ("noise-free", None)):
        information = recorded(dynamics, p, motion, rng, noise)
        print(f"\n{name} recording, {information.mean_samples:.0f} samples in the factor")
        for metric in METRICS:
            problem = Problem(dynamics.robot, information, Settings(regularizer=metric))
            bad += _compare(problem, truth, solvers, arguments.repeats)
    print("\nimpossible robot, conic and CVXPY only")
    information = impossible(dynamics, p, motion)
    for metric in METRICS:
        settings = Settings(regularizer=metric, gamma=EDGE_GAMMA)
        problem = Problem(dynamics.robot, information, settings)
        print(f"  {metric}, γ = {EDGE_GAMMA:g}")
        bad += _check(problem, problem.conic(), problem.cvxpy("CLARABEL"))
    if bad:
        print("\nDISAGREEMENT:", *bad, sep="\n  ", file=sys.stderr)
    return 1 if bad else 0


def _compare(problem: Problem, truth: Truth, solvers: tuple[str, ...], repeats: int) -> list[str]:
    conic, seconds = _timed(problem.conic, repeats)
    status = f"{conic.status}, {conic.iterations} steps"
    runs = [Run("conic", seconds, np.nan, conic.x, status)]
    paper, seconds = _timed(problem.log_cholesky, 3)
    status = f"{paper.status}, {paper.iterations} steps"
    runs.append(Run("log-cholesky", seconds, np.nan, paper.x, status))
    theirs = {}
    for name in solvers:
        theirs[name], seconds = _timed(
            partial(problem.cvxpy, name), repeats if name == "CLARABEL" else 3
        )
        parts = theirs[name].solver_seconds, theirs[name].x, theirs[name].status
        runs.append(Run(f"CVXPY, {name}", seconds, *parts))
    _print_table(problem, truth, runs)
    columns = problem.information.columns
    ours = 1e3 * measure(lambda: build_reduction(problem.robot, columns), repeats, CPU)
    other = 1e3 * measure(lambda: CvxpyFit(problem.robot, columns), repeats, CPU)
    print(f"  not counted, from the description alone: deltaid {ours:.1f} ms, CVXPY {other:.1f} ms")
    return _check(problem, conic, theirs["CLARABEL"], *(run.x for run in runs))


def _timed(function: Callable[[], Result], repeats: int) -> tuple[Result, float]:
    """The result of the last call, and the median CPU time [s]."""
    results: list[Result] = []
    seconds = measure(lambda: results.append(function()), repeats, CPU)
    return results[-1], seconds


def _print_table(problem: Problem, truth: Truth, runs: list[Run]) -> None:
    objective, reduction = problem.objective, problem.reduction
    best, conic = objective.value(runs[0].x), runs[0].seconds
    print(f"\n  {problem.settings.regularizer}, γ = {objective.gamma:.3e}")
    print(
        f"  {'':26} {'ms':>8} {'/conic':>7} {'solver':>7} {'J':>13} {'ΔJ/γ':>9} "
        f"{'M on %':>8} {'M off %':>8} {'friction %':>10}  status"
    )
    for run in runs:
        value = objective.value(run.x)
        on, off, friction = truth.errors(reduction.A @ run.x + reduction.p_0)
        solver = "" if np.isnan(run.solver_seconds) else f"{1e3 * run.solver_seconds:.2f}"
        print(
            f"  {run.name:26} {1e3 * run.seconds:8.2f} {run.seconds / conic:7.1f} {solver:>7} "
            f"{value:13.6e} {(value - best) / objective.gamma:9.1e} "
            f"{on:8.2g} {off:8.2g} {friction:10.2g}  {run.status}"
        )
    name, on, off, friction = PAPER
    print(f"  {name:26} {'':48} {on:>8} {off:>8} {friction:>10}")


def _check(
    problem: Problem, conic: Solution, theirs: CvxpySolution, *others: np.ndarray
) -> list[str]:
    """What is further apart than the tolerances explain.

    The lower bound is compared with the smallest J that anyone reached, and only printed: it is
    known no better than the solver's tolerances.
    """
    objective, gamma = problem.objective, problem.objective.gamma
    value = objective.value(theirs.x)
    allowed = TOLERANCE * (1 + (conic.objective - objective.data.c) / gamma)
    apart = abs(value - conic.objective) / gamma
    evaluated = abs(theirs.objective - value) / gamma
    lowest = min(objective.value(x) for x in (conic.x, theirs.x, *others))
    print(f"  |J of conic − J of CVXPY| = {apart:.1e} γ; tolerances explain {allowed:.1e} γ")
    print(f"  J of the same x, CVXPY's expression against ours: {evaluated:.1e} γ")
    print(f"  conic's lower bound − lowest J of all: {(conic.bound - lowest) / gamma:.1e} γ")
    metric, bad = problem.settings.regularizer, []
    if not apart <= allowed < np.inf:
        bad.append(f"{metric}: optima differ by {apart:.1e} γ, tolerances explain {allowed:.1e} γ")
    if not evaluated <= allowed < np.inf:
        bad.append(f"{metric}: values of J at the same x differ by {evaluated:.1e} γ")
    return bad


if __name__ == "__main__":
    sys.exit(main())
