"""A fit's verdicts, as the model file keeps them."""

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.identification.fit import FittedProblem
from deltaid.identification.labels import Labels
from deltaid.identification.torque_error import TorqueError
from deltaid.model.parameter_record import BaseParameter, Parameter, Share
from deltaid.model.record import Consistency, Fit
from deltaid.robot.inertia import pseudo_inertia
from deltaid.robot.parameter import ADDED


def judged_parameters(problem: FittedProblem, first: int = 0) -> tuple[Parameter, ...]:
    """The parameters of a fit from some on, with their intervals and what decided each.

    Those of additions follow the robot's.
    """
    labels, p_reg = Labels(problem), problem.reduction.p_reg
    rows = []
    for i, parameter in enumerate(problem.layout.parameters[first:], start=first):
        label, value = labels.of(i), problem.values[i]
        low, high = max(label.low, parameter.low), min(label.high, parameter.high)
        rows.append(
            Parameter(
                name=parameter.name,
                value=float(value),
                std=float(label.std),
                low=float(min(low, value)),
                high=float(max(high, value)),
                unit=parameter.unit,
                prior=float(p_reg[i]),
                determined_by=label.by,
                rests_on=label.rests_on,
                share=label.share,
            )
        )
    return tuple(rows)


def judged_base(problem: FittedProblem) -> tuple[BaseParameter, ...]:
    """Base parameters of the robot with their intervals."""
    base, estimate = problem.base, problem.estimate
    by_noise, _ = estimate.by_noise
    noise = (by_noise / np.where(estimate.std > 0, estimate.std, 1.0)) ** 2
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
            share=Share(noise=float(part), prior=0.0, geometry=float(1 - part)),
        )
        for formula, value, std, half, part, parameter in zip(
            base.formulas,
            estimate.values,
            estimate.std,
            estimate.interval,
            noise,
            shown,
            strict=True,
        )
        if parameter.kind not in ADDED
    )


def record(problem: FittedProblem, error: TorqueError) -> Fit:
    """What a fit reached, with the torque errors that it leaves."""
    solution, base = problem.solution, problem.base
    representatives = [group.representative for group in base.groups]
    certified = bool(np.isfinite(solution.bound))
    return Fit(
        objective=solution.objective,
        lower_bound=solution.bound if certified else None,
        duality_gap=solution.duality_gap if certified else None,
        gamma=problem.objective.gamma,
        status=solution.status,
        iterations=solution.iterations,
        optimization_variables=problem.reduction.size,
        base_parameters=sum(k < len(problem.p) for k in representatives),
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
