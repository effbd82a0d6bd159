"""Linearised rows of instruments and torques, the step to their minimum, and their noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from deltaid.estimation.problem import LinearProblem
from deltaid.levels import CERTAIN, UNLIKELY
from deltaid.sensors.planning.knowledge import Knowledge

# Prior deviation of an instrument's unknowns [m or rad]: larger than any step of them.
FAR = 10.0

U = Float[np.ndarray, " free"]
Used = Bool[np.ndarray, " readings"]
Residuals = Float[np.ndarray, "readings values"]


@dataclass(frozen=True, eq=False)
class WeightedRows:
    """Linearised rows of an instrument, or of torques, in units of their noise: slopes by u and all
    v, measured minus predicted, and which readings the fit uses."""

    slopes: Float[np.ndarray, "readings values variables"]
    errors: Residuals
    used: Used

    @cached_property
    def used_slopes(self) -> Float[np.ndarray, "rows variables"]:
        return self.slopes[self.used].reshape(-1, self.slopes.shape[2])

    @property
    def rms(self) -> float:
        """Root mean square of the errors that the fit uses."""
        return float(np.sqrt(np.mean(self.errors[self.used] ** 2)))

    def chance(self, knowledge: Knowledge) -> tuple[float, float]:
        """Sum of squared errors, and its expectation."""
        square, taken = self.errors[self.used] ** 2, (self.used_slopes @ knowledge.inverse) ** 2
        return float(square.sum()), square.size - float(taken.sum())

    def level(self, knowledge: Knowledge) -> float:
        """Factor by which noise exceeds the assumed one; 1 where chance explains the squares."""
        square, freedom = self.chance(knowledge)
        explained = freedom < 1 or square <= chi2.ppf(1 - UNLIKELY, freedom)
        return 1.0 if explained else float(np.sqrt(square / freedom))

    def changed(self, step: Float[np.ndarray, " variables"], noise: float = 1.0) -> "WeightedRows":
        """Rows after a step, in units of `noise` times their noise."""
        errors = (self.errors - self.slopes @ step) / noise
        return replace(self, slopes=self.slopes / noise, errors=errors)


def step_of(
    rows: Sequence[WeightedRows], u: U, spread: float = 1.0
) -> tuple[Float[np.ndarray, " variables"], Knowledge]:
    """Step to the minimum, with a prior of u `spread` times as wide, and the information there."""
    A = np.vstack([part.used_slopes for part in rows])
    error = np.concatenate([part.errors[part.used].ravel() for part in rows])
    own = A.shape[1] - len(u)
    D = np.diag(np.pad(np.full(len(u), 1 / spread), (0, own), constant_values=1 / FAR))
    problem = LinearProblem(A, error, np.zeros(len(error), dtype=int))
    return problem.with_known(D, np.pad(-u / spread, (0, own))).x, Knowledge(D).and_rows(A)


def noise_levels(rows: Sequence[WeightedRows], u: U) -> list[float]:
    """Factors by which the noise of each part exceeds the assumed one.

    A number far from its description must not count as noise. So factors are computed with the
    prior and with a wider one; the result makes the rows more probable.
    """
    choices = []
    for spread in (1.0, CERTAIN):
        step, knowledge = step_of(rows, u, spread)
        levels = [part.changed(step).level(knowledge) for part in rows]
        choices.append((_surprise(rows, u, levels, spread), levels))
    return min(choices)[1]


def _surprise(rows: Sequence[WeightedRows], u: U, noise: Sequence[float], spread: float) -> float:
    """-log p(rows) up to a constant [nats], with noise and prior times the given factors."""
    none = np.zeros(rows[0].slopes.shape[2])
    parts = [part.changed(none, level) for part, level in zip(rows, noise, strict=True)]
    step, knowledge = step_of(parts, u, spread)
    errors = [part.changed(step).errors[part.used].ravel() for part in parts]
    square = sum(float(x @ x) for x in (*errors, (u + step[: len(u)]) / spread))
    wide = sum(x.size * np.log(level) for x, level in zip(errors, noise, strict=True))
    return square / 2 + wide + len(u) * np.log(spread) + np.linalg.slogdet(knowledge.root)[1]
