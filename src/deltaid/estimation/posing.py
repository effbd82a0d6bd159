"""The objective and solver that settings name."""

from dataclasses import replace

from deltaid.estimation.conic import Conic
from deltaid.estimation.information import Information
from deltaid.estimation.log_cholesky import LogCholesky
from deltaid.estimation.objective import Objective, Solution, Solver, data_term, default_gamma
from deltaid.estimation.reduction import Reduction
from deltaid.estimation.regularizer import AFFINE_INVARIANT, LOG_DET, Metric
from deltaid.model.options import Method, RegularizerName
from deltaid.model.record import Settings

SOLVERS: dict[Method, Solver] = {"conic": Conic(), "log-cholesky": LogCholesky()}
METRICS: dict[RegularizerName, Metric] = {
    "euclidean": Metric(),
    "entropic": Metric(LOG_DET),
    "riemannian": Metric(AFFINE_INVARIANT),
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
    """Minimise J by a solver; one that does not certify borrows the bound of one that does. Errors
    as of `Solver.solve`."""
    solution = solver.solve(objective)
    if solver.certifies or not objective.regularizer.convex:
        return solution
    return replace(solution, bound=Conic().solve(objective).bound)
