"""What is minimised and by what: the objective that settings ask for, and what their names mean."""

from deltaid.identification.conic import Conic
from deltaid.identification.information import Information
from deltaid.identification.log_cholesky import LogCholesky
from deltaid.identification.objective import Objective, data_term, default_gamma
from deltaid.identification.reduction import Reduction
from deltaid.identification.regularizer import (
    AffineInvariant,
    Euclidean,
    LogDet,
    Metric,
    Spectral,
)
from deltaid.identification.solver import Solution, Solver
from deltaid.model.options import Method, RegularizerName
from deltaid.model.record import Settings

# What the names that users write stand for.
SOLVERS: dict[Method, Solver] = {"conic": Conic(), "log-cholesky": LogCholesky()}
METRICS: dict[RegularizerName, Metric] = {
    "euclidean": Euclidean(),
    "entropic": Spectral(LogDet()),
    "riemannian": Spectral(AffineInvariant()),
}


def pose(information: Information, reduction: Reduction, settings: Settings) -> Objective:
    """Objective (15) for some information, with γ given or by maximum a posteriori."""
    return Objective(
        reduction,
        data_term(information, reduction),
        METRICS[settings.regularizer].regularizer(reduction),
        settings.gamma or default_gamma(information, settings.prior_spread),
    )


def minimise(objective: Objective, solver: Solver) -> Solution:
    """Minimise J by a solver; one that does not certify borrows the bound of one that does.

    Raises:
        IdentificationError: a solver did not reach its end.
    """
    solution = solver.solve(objective)
    if solver.certifies or not objective.convex:
        return solution
    bound = Conic().solve(objective).bound
    return Solution(solution.x, solution.objective, bound, solution.iterations, solution.status)
