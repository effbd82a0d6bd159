"""What a solver of (15) is, and what it finds. A solver is a value that holds its tolerances."""

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

from deltaid.estimation.objective import Objective
from deltaid.estimation.regularizer import Vector


@dataclass(frozen=True)
class Solution:
    """A minimiser of the objective and how good it is.

    Attributes:
        x: the free variables.
        objective: J(x).
        bound: no consistent x has a smaller J; −∞ where nothing is known.
        iterations: of the solver.
        status: what the solver said.
    """

    x: Vector
    objective: float
    bound: float
    iterations: int
    status: str

    @property
    def duality_gap(self) -> float:
        """J(x) minus its lower bound, never negative."""
        return max(0.0, self.objective - self.bound)


@runtime_checkable
class Solver(Protocol):
    """A way to minimise J over all consistent x.

    Attributes:
        certifies: whether the bound of its solutions proves how far they are from the optimum.
    """

    certifies: ClassVar[bool]

    def solve(self, objective: Objective) -> Solution:
        """A minimiser of J.

        Raises:
            IdentificationError: the objective is not one for this solver, or it did not reach its
                end.
        """
        ...
