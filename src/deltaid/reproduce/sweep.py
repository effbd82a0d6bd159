"""How accuracy depends on γ_p/γ_τ, the weight of the regularisation against the data."""

from dataclasses import dataclass, replace

import numpy as np

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.errors import IdentificationError
from deltaid.estimation.conic import Conic
from deltaid.identification.identify import Identification
from deltaid.reproduce.accuracy import Accuracy, DriveMotion, accuracy


@dataclass(frozen=True)
class SweepPoint:
    """Accuracy of the global optimum at one γ."""

    gamma: float
    objective: float
    accuracy: Accuracy


def sweep(
    dynamics: Dynamics,
    identification: Identification,
    along: DriveMotion,
    truth: Parameters,
    gammas: np.ndarray,
) -> tuple[SweepPoint, ...]:
    """The same data and prior fitted with other γ. A γ without a certified optimum is left out."""
    objective = identification.problem.objective
    points = []
    for gamma in gammas:
        try:
            solution = Conic().solve(replace(objective, gamma=float(gamma)))
        except IdentificationError:
            continue
        p = objective.reduction.parameters(solution.x)
        result = accuracy(dynamics, along, truth, p)
        points.append(SweepPoint(float(gamma), solution.objective, result))
    return tuple(points)
