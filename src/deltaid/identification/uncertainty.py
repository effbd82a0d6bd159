"""How far identified parameters can be trusted: standard deviations, and doubts about the data."""

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from deltaid.errors import IdentificationError
from deltaid.identification.conic import Solution
from deltaid.identification.information import Information, triangle
from deltaid.identification.objective import NOISE_FLOOR, Objective, noise_level
from deltaid.identification.reduction import Reduction

# A consistent fit contradicts the data when it leaves so many times the torque error of parameters
# without constraints and more than this share of the largest torque, or when a mass that torques
# cannot see had to grow to so many times its prior.
_WORSE, _SHARE, _GREW = 3.0, 0.01, 3.0


def standard_deviations(
    objective: Objective, reduction: Reduction, solution: Solution, information: Information
) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, " parameters"]]:
    """Standard deviations of p given data and prior, and given the prior alone.

    Minimising J maximises a posterior whose negative logarithm is s J / (2 σ̂²), so the covariance
    of x is (s / (2 σ̂²) ∇²J)⁻¹ at the minimum, and that of the prior the same without the data.
    Where a body touches the edge of consistency this Gaussian reaches beyond it.

    Raises:
        IdentificationError: the prior's sizes are too far apart for the arithmetic.
    """
    sigma = max(noise_level(information), NOISE_FLOOR)
    unit = sigma * np.sqrt(2.0 / (information.samples * objective.gamma))
    _, _, hessian = objective.regularizer.evaluate(reduction.prior)
    scale = np.sqrt(np.diag(hessian))
    try:
        root = np.linalg.cholesky(hessian / np.outer(scale, scale)).T
    except np.linalg.LinAlgError:
        raise IdentificationError(
            "the prior's sizes differ too much to be weighed against each other",
            cure="check masses and lengths of the prior in the description",
        ) from None
    data = np.sqrt(2.0 / objective.gamma) * objective.data.R / scale
    A = reduction.A / scale

    def deviations(factor: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " parameters"]:
        """√diag(A (FᵀF)⁻¹ Aᵀ) for a triangular F."""
        return unit * np.linalg.norm(solve_triangular(factor, A.T, trans="T"), axis=0)

    return deviations(triangle(np.vstack([data, root]))), deviations(root)


def doubts(
    reduction: Reduction, solution: Solution, objective: Objective, information: Information
) -> tuple[str, ...]:
    """What in a result contradicts the data or the prior: wrong signs, units, geometry."""
    texts = []
    noise = max(noise_level(information), NOISE_FLOOR)
    rows = len(information.torque_max)
    left = np.sqrt(objective.data.evaluate(solution.x)[0] / rows)
    if left > max(_WORSE * noise, _SHARE):
        texts.append(
            f"the consistent fit leaves {left / noise:.3g} times the torque error that is possible "
            "without physical consistency: check sign, unit, torque constant and gear of torques "
            "and positions, and the robot's lengths"
        )
    p, p_reg = reduction.parameters(solution.x), reduction.p_reg
    for i, name in enumerate(reduction.layout.names):
        held = not np.any(reduction.A[i])
        if held and p_reg[i] > 0 and p[i] > _GREW * p_reg[i]:
            texts.append(
                f"{name} had to grow from {p_reg[i]:.3g} to {p[i]:.3g} "
                f"{reduction.layout.units[i]} to keep its body consistent: check the scale of "
                "torques and the prior"
            )
    return tuple(texts)
