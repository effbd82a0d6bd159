"""What a fit that is shrunk is posed from: columns of causes, rows of one noise level, and their
normal equations."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.estimation.problem import Columns, Rows

# Share of its prior that is left to a coefficient at its bound.
_HELD = 1e-6
# Rows whose sums show noise that is not white, and by how much it may exceed white noise.
_SLOW, _REDDEST = 8, 30.0


@dataclass(frozen=True, eq=False)
class CauseColumns:
    """Columns that one cause has.

    Attributes:
        deviation: prior standard deviation of each coefficient.
        mean: of the prior, minus what has been applied already.
        is_candidate: whether it is corrected; else it only keeps others from explaining it.
        may_be_dropped: whether a candidate goes where rows do not need it.
        is_positive: whether x less the mean, all that is applied, is at least zero by physics.
        is_possible: whether physics allows such values of x less the mean; a candidate whose
            estimate it does not allow stands for something else, and is dropped.
    """

    name: str
    columns: Int[np.ndarray, " k"]
    deviation: Float[np.ndarray, " k"]
    mean: Float[np.ndarray, " k"]
    is_candidate: bool = True
    is_positive: bool = False
    may_be_dropped: bool = True
    is_possible: Callable[[Float[np.ndarray, " k"]], bool] = lambda _: True

    def allows(self, x: Float[np.ndarray, " n"]) -> bool:
        """Whether physics allows all that is applied."""
        return self.is_possible(x[self.columns] - self.mean)

    def held(self, x: Float[np.ndarray, " n"]) -> "CauseColumns":
        """With coefficients at zero where physics allows no less than x has."""
        below = self.is_positive & (x[self.columns] < self.mean)
        return replace(self, deviation=np.where(below, _HELD * self.deviation, self.deviation))


@dataclass(frozen=True, eq=False)
class NoiseBlock:
    """Rows A x = b of one noise level.

    Attributes:
        stretches: of time, of each row.
        largest: the largest measured value beside them.
        independent: share of the rows whose noise is independent, behind a low-pass.
    """

    A: Columns
    b: Rows
    stretches: Int[np.ndarray, " rows"]
    largest: float
    independent: float = 1.0

    @cached_property
    def normal(self) -> Float[np.ndarray, "n n"]:
        return self.A.T @ self.A

    @cached_property
    def right(self) -> Float[np.ndarray, " n"]:
        return self.A.T @ self.b

    def noise(self, residual: Rows) -> float:
        """Standard deviation of its noise; slow errors of the model count as noise."""
        count = len(residual) // _SLOW * _SLOW
        variance = float(np.mean(residual**2))
        slow = np.mean(residual[:count].reshape(-1, _SLOW).sum(axis=1) ** 2) / _SLOW
        red = np.clip(slow / max(variance, 1e-300), 1.0, _REDDEST)
        return float(np.sqrt(max(variance * red, 1e-300)))


@dataclass(frozen=True, eq=False)
class Normal:
    """K x = r of rows and of what is known at some noise levels, without the priors of groups."""

    sigma: Float[np.ndarray, " blocks"]
    K: Float[np.ndarray, "n n"]
    r: Float[np.ndarray, " n"]
