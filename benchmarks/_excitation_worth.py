"""What optimised motions are worth: predicted standard deviations, and errors of identified models.

Both against random motions within the same limits and of the same length.
"""

from collections.abc import Callable

import numpy as np
from _excitation_judge import FINER

import deltaid
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.objective import parameter_scale
from deltaid.identification.demo import mass_matrix_error
from deltaid.motion.excitation.excite import Exciter
from deltaid.motion.excitation.optimize import random_start
from deltaid.motion.excitation.problem import ExcitationProblem, criterion
from deltaid.motion.excitation.run import Run, plan_run
from deltaid.motion.surrogate import SensorNoise, surrogate_parameters

DURATION, RATE = 10.0, 1000.0
THIRD = 999_999  # seed of the motion along which mass matrices are compared


def ranked_random_motions(problem: ExcitationProblem, count: int) -> list[int]:
    """Seeds of random feasible motions, the best by the criterion first."""

    def score(seed: int) -> float:
        G = problem.information(random_start(problem, seed), FINER * problem.samples)
        return criterion(problem.criterion, G)[0]

    return sorted(range(count), key=score)


def long_run(problem: ExcitationProblem, x: np.ndarray) -> Run:
    """A run from rest of at least the duration of a recording."""
    motion = problem.series.motion(x)
    return plan_run(problem, motion, int(np.ceil(DURATION / motion.period)))


def predicted(exciter: Exciter, run: Run) -> np.ndarray:
    """Predicted standard deviations for a recording of the common duration."""
    std = np.array([entry.std for entry in exciter.predict(run)])
    return std * np.sqrt(run.duration / DURATION)


def compare_predictions(exciter: Exciter, optimised: Run, ranked: list[int]) -> None:
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


def record(
    exciter: Exciter, run: Run, p: np.ndarray, rng: np.random.Generator
) -> deltaid.Recording:
    """A recording as a drive would log it; the torque noise has the same size on every motion."""
    noise = SensorNoise()
    z, zd, zdd = run.evaluate(np.arange(round(DURATION * RATE)) / RATE)
    q, qd, qdd = exciter.dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = exciter.dynamics.torque(z, qd, qdd, p)
    tau = tau + noise.torque * exciter.torque_reference * rng.standard_normal(tau.shape)
    q = np.round(q / noise.encoder_step) * noise.encoder_step
    return deltaid.Recording.from_arrays(t=np.arange(len(q)) / RATE, q=q, tau=tau)


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
    A = result.problem.reduction.A[: combination.shape[1]]  # without what was fitted beside it
    free = np.any(combination[:, np.any(A != 0, axis=1)] != 0, axis=1)
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
            recording = record(exciter, run_of(seed), truth, rng)
            rows.append(errors(exciter, deltaid.identify(robot, recording), truth))
        cells = zip(np.median(rows, axis=0), np.max(rows, axis=0), strict=True)
        print(f"  {name:18}" + "".join(f"{f'{m:.2g} ({w:.2g})':>17}" for m, w in cells))
