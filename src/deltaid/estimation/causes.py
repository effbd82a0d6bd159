"""What a shrunk fit (`shrinkage`) is posed of: columns of causes, each with a prior of its own, and
blocks of rows, each of one noise level."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.estimation.problem import Columns, Rows
from deltaid.levels import FAINT

# Number of rows whose sums show slow noise.
_SLOW = 8


@dataclass(frozen=True, eq=False)
class CauseColumns:
    """The columns of one cause.

    Attributes:
        deviation: prior standard deviation of each coefficient.
        mean: prior mean of each step: minus the coefficients that have been applied already.
        is_candidate: whether it can be corrected; otherwise it is a nuisance.
        may_be_dropped: whether a candidate is dropped if rows do not need it.
        is_positive: whether coefficients, x less the mean, cannot be negative.
        is_possible: whether physics allows such coefficients, given their covariance; otherwise a
            candidate mimics another cause and is dropped.
    """

    name: str
    columns: Int[np.ndarray, " k"]
    deviation: Float[np.ndarray, " k"]
    mean: Float[np.ndarray, " k"]
    is_candidate: bool = True
    is_positive: bool = False
    may_be_dropped: bool = True
    is_possible: Callable[[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]], bool] = lambda *_: (
        True
    )

    def allows(self, x: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]) -> bool:
        """Whether physics allows the coefficients.

        A step of x counts as uncertain by its own size, since slopes are those before it; otherwise
        nonlinear effects would be dropped before they settle.
        """
        step = x[self.columns]
        own = covariance[np.ix_(self.columns, self.columns)] + np.outer(step, step)
        return self.is_possible(step - self.mean, own)

    def held(self, x: Float[np.ndarray, " n"]) -> "CauseColumns":
        """With coefficients held at zero where they would be negative but cannot."""
        below = self.is_positive & (x[self.columns] < self.mean)
        return replace(self, deviation=np.where(below, FAINT * self.deviation, self.deviation))


@dataclass(frozen=True, eq=False)
class NoiseBlock:
    """Rows A x = b of one noise level.

    Attributes:
        stretches: the stretch of time of each row.
        largest: the largest measured value.
        independent: share of the rows with independent noise, behind a low-pass.
        counted: share of the samples behind the rows that count; the others are zero.
    """

    A: Columns
    b: Rows
    stretches: Int[np.ndarray, " rows"]
    largest: float
    independent: float = 1.0
    counted: float = 1.0

    @property
    def count(self) -> float:
        """Number of rows without those excluded."""
        return max(self.counted * len(self.b), 1.0)

    @cached_property
    def products(self) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
        """AᵀA and Aᵀb."""
        return self.A.T @ self.A, self.A.T @ self.b

    def noise(self, residual: Rows) -> float:
        """Standard deviation of its noise; slow errors of the model count as noise."""
        whole = len(residual) // _SLOW * _SLOW
        sums = residual[:whole].reshape(-1, _SLOW).sum(axis=1)
        square = max(float(residual @ residual), float(sums @ sums), 1e-300)
        return float(np.sqrt(square / self.count))


@dataclass(frozen=True, eq=False)
class WeightedBlocks:
    """Blocks of rows at some levels of noise, and rows D x = d of a prior.

    Attributes:
        sigma: noise of each block.
    """

    blocks: tuple[NoiseBlock, ...]
    D: Columns
    d: Rows
    sigma: Float[np.ndarray, " blocks"]

    @cached_property
    def products(self) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
        """DᵀD + Σ AᵀA/σ² and Dᵀd + Σ Aᵀb/σ²."""
        K, r = self.D.T @ self.D, self.D.T @ self.d
        for block, sigma in zip(self.blocks, self.sigma, strict=True):
            normal, right = block.products
            K += normal / sigma**2
            r += right / sigma**2
        return K, r
