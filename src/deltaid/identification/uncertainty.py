"""How far identified parameters can be trusted: intervals, and doubts about the data."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import solve_triangular

from deltaid.errors import IdentificationError
from deltaid.identification.base_parameters import BaseParameters
from deltaid.identification.conic import Solution
from deltaid.identification.information import Information, triangle
from deltaid.identification.least_squares import BaseEstimate
from deltaid.identification.model import BaseParameter, Parameter
from deltaid.identification.objective import NOISE_FLOOR, Objective, noise_level
from deltaid.identification.reduction import Reduction
from deltaid.identification.regularizer import prior_scale
from deltaid.identification.scatter import Noise, quantile

# A consistent fit contradicts the data when it leaves so many times the torque error of parameters
# without constraints and more than this share of the largest torque, or when a mass that torques
# cannot see had to grow to so many times its prior.
_WORSE, _SHARE, _GREW = 3.0, 0.01, 3.0
# A base parameter of the fit contradicts the recording when it lies so many half widths of its 95 %
# interval away from what the recording alone gives.
_APART = 3.0
# The data decided a parameter whose standard deviation it shrank below this share of the prior's.
_SHRUNK = 0.5
# Noise that is so many times smaller than the standard deviation does not matter; degrees of
# freedom that are as good as infinitely many.
_HARDLY, _MANY = 100.0, 1e8


@dataclass(frozen=True)
class Uncertainty:
    """How far the parameters p of a fit can be trusted, given data and prior.

    Attributes:
        std, interval: standard deviation, and half the width of the 95 % interval.
        prior_std: standard deviation given the prior alone.
        by_data: whether the data decided.
    """

    std: Float[np.ndarray, " parameters"]
    interval: Float[np.ndarray, " parameters"]
    prior_std: Float[np.ndarray, " parameters"]
    by_data: Bool[np.ndarray, " parameters"]


def uncertainty(
    objective: Objective,
    reduction: Reduction,
    information: Information,
    base: BaseParameters,
    noise: Noise,
) -> Uncertainty:
    """Deviations of the minimiser of (15) from the truth, by noise and by the prior.

    Minimising J maximises a posterior whose negative logarithm is s J / (2 σ̂²). With its Hessian
    H = D + P, D from the data and P from the prior, x errs by H⁻¹ (g + P (x_prior − x)), where g is
    what the noise adds to the gradient. The variance by the prior is cᵀ H⁻¹ P H⁻¹ c for a
    combination cᵀx; that by the noise comes from the scatter of the recording (`scatter`), and for
    white noise would be cᵀ H⁻¹ D H⁻¹ c. Where a body touches the edge of consistency this reaches
    beyond it.

    Data decides where the standard deviation is less than half of the prior's. A sharp sum of two
    parameters does not make the two known: each keeps the part by the prior of the other.

    Raises:
        IdentificationError: the prior's sizes are too far apart for the arithmetic.
    """
    samples, sigma = information.samples, max(noise_level(information), NOISE_FLOOR)
    unit = sigma * np.sqrt(2.0 / (samples * objective.gamma))
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
    factor = triangle(np.vstack([data, root]))
    H_inverse_A = solve_triangular(factor, solve_triangular(factor, A.T, trans="T"))
    prior_share = unit**2 * np.sum((root @ H_inverse_A) ** 2, axis=0)
    in_scores = noise.root @ (base.combination() @ (A @ H_inverse_A))
    by_noise, freedom = noise.deviations(2.0 / (objective.gamma * samples) * in_scores)
    std = np.hypot(by_noise, np.sqrt(prior_share))
    # Satterthwaite: only the part by noise is estimated.
    nu = freedom * np.minimum(std / np.maximum(by_noise, np.finfo(float).tiny), _HARDLY) ** 4
    prior_std = unit * np.linalg.norm(solve_triangular(root, A.T, trans="T"), axis=0)
    return Uncertainty(std, quantile(nu) * std, prior_std, std < _SHRUNK * prior_std)


def judged_parameters(
    p: Float[np.ndarray, " parameters"],
    reduction: Reduction,
    uncertain: Uncertainty,
    visible: Int[np.ndarray, " columns"],
    prior_spread: float,
) -> tuple[Parameter, ...]:
    """Parameters p of a fit with their intervals, and which of data and prior decided each."""
    layout, p_reg = reduction.layout, reduction.p_reg
    free = np.any(reduction.A != 0, axis=1)
    held_std = prior_spread * prior_scale(reduction)
    rows = []
    for i, name in enumerate(layout.names):
        std, reach, middle = 0.0, 0.0, p[i]
        if free[i] and uncertain.by_data[i]:
            by, std, reach = "data", uncertain.std[i], uncertain.interval[i]
        elif free[i]:
            by, std, middle = "prior", uncertain.prior_std[i], p_reg[i]
        elif p[i] != 0 and i in visible:
            by = "fixed"
        elif p[i] != 0:
            by = "prior" if np.isclose(p[i], p_reg[i], rtol=1e-9) else "consistency"
            std, middle = held_std[i], p_reg[i]
        else:
            by = "structure"
        if by in ("prior", "consistency"):
            reach = float(quantile(np.array([_MANY]))[0]) * std
        low = max(middle - reach, layout.parameters[i].low)
        rows.append(
            Parameter(
                name=name,
                value=float(p[i]),
                std=float(std),
                low=float(min(low, p[i])),
                high=float(max(middle + reach, p[i])),
                unit=layout.units[i],
                prior=float(p_reg[i]),
                determined_by=by,
            )
        )
    return tuple(rows)


def judged_base(base: BaseParameters, estimate: BaseEstimate) -> tuple[BaseParameter, ...]:
    """Base parameters with their intervals."""
    shown = [base.layout.parameters[group.representative] for group in base.groups]
    return tuple(
        BaseParameter(
            formula=formula,
            representative=parameter.name,
            value=float(value),
            std=float(std),
            low=float(value - half),
            high=float(value + half),
            unit=parameter.unit,
        )
        for formula, value, std, half, parameter in zip(
            base.formulas, estimate.values, estimate.std, estimate.interval, shown, strict=True
        )
    )


def doubts(
    reduction: Reduction,
    solution: Solution,
    objective: Objective,
    information: Information,
    base: BaseParameters,
    estimate: BaseEstimate,
    prior_spread: float,
) -> tuple[str, ...]:
    """What in a result contradicts the data or the prior: wrong signs, units, geometry, priors.

    Args:
        estimate: what the recording alone gives of the base parameters.
    """
    texts = []
    noise = max(noise_level(information), NOISE_FLOOR)
    rows = len(information.torque_max)
    left = np.sqrt(objective.data.evaluate(solution.x)[0] / rows)
    p, p_reg = reduction.parameters(solution.x), reduction.p_reg
    if left > max(_WORSE * noise, _SHARE):
        texts.append(
            f"the consistent fit leaves {left / noise:.3g} times the torque error that is possible "
            "without physical consistency: check sign, unit, torque constant and gear of torques "
            "and positions, and the robot's lengths"
        )
    else:
        # γ is what a noise of this level would have got (`objective.default_gamma`).
        assumed = prior_spread * np.sqrt(objective.gamma * information.samples)
        excess = max(1.0, assumed / max(noise_level(information), np.finfo(float).tiny))
        texts += _contradictions(p, base, estimate, excess)
    for i, name in enumerate(reduction.layout.names):
        held = not np.any(reduction.A[i])
        if held and p_reg[i] > 0 and p[i] > _GREW * p_reg[i]:
            texts.append(
                f"{name} had to grow from {p_reg[i]:.3g} to {p[i]:.3g} "
                f"{reduction.layout.units[i]} to keep its body consistent: check the scale of "
                "torques and the prior"
            )
    return tuple(texts)


def _contradictions(
    p: Float[np.ndarray, " parameters"],
    base: BaseParameters,
    estimate: BaseEstimate,
    excess: float,
) -> list[str]:
    """The base parameter that a fit p holds farthest from what the recording alone gives.

    With the truth within the prior, the two differ by less than the noise of the estimate. Where
    they do not, parameters that hang together with this one are pulled along, out of intervals
    that take the prior at its word.

    Args:
        excess: how many times larger than the data's own the noise is that γ stands for.
    """
    fitted = base.values(p)
    half = excess * estimate.interval
    apart = np.abs(fitted - estimate.values) / np.maximum(half, np.finfo(float).tiny)
    k, count = int(np.argmax(apart)), int(np.sum(apart > _APART))
    if not count:
        return []
    unit = base.layout.units[base.groups[k].representative]
    others = f"; {count - 1} more are as far apart" if count > 1 else ""
    return [
        f"the recording alone gives {base.formulas[k]} = {estimate.values[k]:.3g} ± "
        f"{half[k]:.2g} {unit}, the fit {fitted[k]:.3g} {unit}{others}: prior, entries that 'free' "
        "leaves out or consistency contradict the recording, and other parameters of these bodies "
        "may lie outside of their intervals; check the prior and what is free"
    ]
