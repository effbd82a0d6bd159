"""A fit's verdicts, as the model file keeps them."""

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.identification.fit import FittedProblem
from deltaid.identification.regularizer import prior_scale
from deltaid.identification.scatter import quantile
from deltaid.identification.torque_error import TorqueError
from deltaid.identification.uncertainty import uncertainty
from deltaid.model.record import BaseParameter, Consistency, Fit, Parameter
from deltaid.robot.inertia import pseudo_inertia

# Degrees of freedom that are as good as infinitely many.
_MANY = 1e8


def judged_parameters(problem: FittedProblem) -> tuple[Parameter, ...]:
    """The parameters of a fit with their intervals, and which of data and prior decided each."""
    layout, reduction, p = problem.layout, problem.reduction, problem.p
    p_reg, visible, uncertain = reduction.p_reg, problem.information.columns, uncertainty(problem)
    free = np.any(reduction.A != 0, axis=1)
    held_std = problem.settings.prior_spread * prior_scale(reduction)
    rows = []
    for i, parameter in enumerate(layout.parameters):
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
        low, high = max(middle - reach, parameter.low), min(middle + reach, parameter.high)
        rows.append(
            Parameter(
                name=parameter.name,
                value=float(p[i]),
                std=float(std),
                low=float(min(low, p[i])),
                high=float(max(high, p[i])),
                unit=parameter.unit,
                prior=float(p_reg[i]),
                determined_by=by,
            )
        )
    return tuple(rows)


def judged_base(problem: FittedProblem) -> tuple[BaseParameter, ...]:
    """Base parameters with their intervals."""
    base, estimate = problem.base, problem.estimate
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


def record(problem: FittedProblem, error: TorqueError) -> Fit:
    """What a fit reached, with the torque errors that it leaves."""
    solution, base = problem.solution, problem.base
    certified = bool(np.isfinite(solution.bound))
    return Fit(
        objective=solution.objective,
        lower_bound=solution.bound if certified else None,
        duality_gap=solution.duality_gap if certified else None,
        gamma=problem.objective.gamma,
        status=solution.status,
        iterations=solution.iterations,
        optimization_variables=problem.reduction.size,
        base_parameters=base.rank,
        base_condition=base.condition,
        noise_level=problem.noise,
        rms=tuple(map(float, error.rms)),
        nrmse=tuple(map(float, error.nrmse)),
        rms_unfiltered=tuple(map(float, error.rms_unfiltered)),
    )


def eigenvalues(
    layout: ParameterLayout, p: Float[np.ndarray, " parameters"]
) -> tuple[Consistency, ...]:
    """Eigenvalues of M̄ of every body."""
    return tuple(
        Consistency(
            body=body,
            eigenvalues=tuple(np.linalg.eigvalsh(pseudo_inertia(p[layout.body(body)])).tolist()),
        )
        for body in layout.bodies
    )
