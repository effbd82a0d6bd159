"""What solvers of an excitation problem have reached over time, by a measure common to all.

Every point is judged on a finer grid with the true sign of friction, off the clock.
"""

from dataclasses import dataclass

import numpy as np
from _excitation_solvers import Trace, velocity_term

from deltaid.motion.excitation.optimize import largest_use
from deltaid.motion.excitation.problem import ExcitationProblem, criterion

FINER = 10  # the grid that points are judged on, against the one that is optimised on


@dataclass(frozen=True)
class Curve:
    """Best feasible value so far over time [s]; the first is that of the start."""

    seconds: np.ndarray
    values: np.ndarray

    @property
    def best(self) -> float:
        return float(self.values[-1])

    def after(self, share: float) -> float:
        """The value after a share of the way from the start to the best."""
        return float((1 - share) * self.values[0] + share * self.values[-1])

    def value_at(self, seconds: float) -> float:
        reached = np.flatnonzero(self.seconds <= seconds)
        return float(self.values[reached[-1]]) if len(reached) else np.inf

    def time_to(self, value: float) -> float:
        """First time at which a value is reached; infinite if never."""
        reached = np.flatnonzero(self.values <= value)
        return float(self.seconds[reached[0]]) if len(reached) else np.inf


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
        value = criterion(problem.criterion, problem.information(x, self._samples))[0]
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
        return self.ours.value_at(self.theirs.time_to(self.theirs.best))
