"""The fit of a consistent robot to torque columns in some order, with some gains.

What decides between hypotheses about columns is the fit of a robot that may exist,

    −2 log L = N log σ² + ‖W(E u − Y p)‖²/σ² + d²(p, p₀),   p in its cones,

with the entropic distance d² to the prior: a wrong sign explains a poor motion by masses that no
body has. Rows W are shares of each drive's recorded torque, so that units do not decide.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float

from deltaid.checks.wiring.residual import AT_REST, LEAST, OFFSET, UNIT, MapResidual, rms_torques
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import IdentificationError
from deltaid.estimation.conic import Conic
from deltaid.estimation.objective import Objective
from deltaid.estimation.posing import METRICS
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.estimation.regularizer import Quadratic, Regularizer

# γ of the prior; rounds of fit and noise level, and change of the latter that ends them.
_GAMMA, _ROUNDS, _SETTLED = 1.0, 4, 0.05
_SOLVER = Conic(tolerance=1e-7, largest_gap=1e-2)


@dataclass(frozen=True)
class Consistent:
    """The fit of a robot that may exist."""

    score: float  # log likelihood and log prior of it
    left: float  # share of the torques that it leaves, of each drive alike
    distance: float  # d² to the prior; below some 10 where bodies are as described


IMPOSSIBLE = Consistent(-np.inf, 1.0, np.inf)


@dataclass(frozen=True, eq=False)
class Posed:
    """Torques in the order of the drives as rows [A b], A x = b over what is free of a robot, each
    drive as a share of its torques."""

    reduction: Reduction
    regularizer: Regularizer
    rows: Float[np.ndarray, "drives samples augmented"]

    @classmethod
    def from_residual(
        cls, residual: MapResidual, tau: Float[np.ndarray, "drives samples"]
    ) -> "Posed":
        """Of torques of each drive, under the map of a residual."""
        of_rows, columns = residual.rows, residual.columns
        Y = residual.Y.reshape(*tau.shape, -1) * of_rows.scale[:, None, None]
        weights, sizes = np.where(residual.still, AT_REST, 1.0), rms_torques(tau)
        expected = Y @ residual.prior * weights[:, None]
        by = np.linalg.norm(expected) / np.linalg.norm(tau * weights[:, None])
        by = 1.0 if abs(np.log(by)) < np.log(UNIT) else by
        reduction, regularizer = _prior(residual.dynamics, tuple(columns.tolist()))
        A, b = Y @ reduction.A[columns], by * tau - Y @ reduction.p_0[columns]
        rows = np.concatenate([A, b[:, :, None]], axis=2)
        return cls(reduction, regularizer, rows * (weights / (by * sizes))[:, None, None])

    @cached_property
    def highest(self) -> float:
        """No robot has a higher score: that of the least squares of any masses and constants."""
        left = self._level(Quadratic.of(self._without_constant(1.0)).c)
        return -self._size * float(np.log(left))

    @cached_property
    def fit(self) -> Consistent:
        """Of a robot that may exist."""
        noise, best = 0.02, IMPOSSIBLE
        for _ in range(_ROUNDS):
            # A constant torque costs what its prior says: one of usual size is as likely as noise.
            constant = 1 - 1 / np.sqrt(1 + self.rows.shape[1] * (OFFSET / noise) ** 2)
            data = Quadratic.of(self._without_constant(constant) / noise)
            try:
                solution = _SOLVER.solve(Objective(self.reduction, data, self.regularizer, _GAMMA))
            except IdentificationError:
                return IMPOSSIBLE
            misfit, before = data.evaluate(solution.x)[0], noise
            distance, noise = solution.objective - misfit, self._level(misfit * noise**2)
            best = Consistent(float(-self._size * np.log(noise) - 0.5 * distance), noise, distance)
            if abs(np.log(noise / before)) < _SETTLED:
                break
        return best

    def _without_constant(self, share: float) -> Float[np.ndarray, "rows augmented"]:
        """The rows without a share of each drive's mean."""
        rows = self.rows - share * self.rows.mean(axis=1, keepdims=True)
        return rows.reshape(-1, rows.shape[2])

    @property
    def _size(self) -> int:
        return self.rows.shape[0] * self.rows.shape[1]

    def _level(self, squares: float) -> float:
        """Share of the torques that squares of so much leave."""
        return float(np.sqrt(squares / self._size + LEAST**2))


@lru_cache(maxsize=8)
def _prior(dynamics: Dynamics, columns: tuple[int, ...]) -> tuple[Reduction, Regularizer]:
    """What every hypothesis about columns is fitted with."""
    reduction = build_reduction(dynamics.robot, np.array(columns))
    return reduction, METRICS["entropic"].regularizer(reduction)
