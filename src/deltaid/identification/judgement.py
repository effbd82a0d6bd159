"""A fit as the model that a file keeps: values, intervals, what decided them, what is doubtful."""

from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version

import numpy as np

from deltaid.identification.doubts import ambiguous, doubts, inseparable
from deltaid.identification.fit import FittedProblem
from deltaid.identification.friction_curves import friction_curves
from deltaid.identification.gains import torque_scale
from deltaid.identification.labels import Labels
from deltaid.identification.marginal import posterior_record
from deltaid.identification.sensor_stage import fitted_sensors
from deltaid.identification.setup import ContestOutcome
from deltaid.identification.torque_error import TorqueError
from deltaid.identification.widening import doubted_sensors, widened_priors
from deltaid.model.corrections import Correction, FittedEffect, Source
from deltaid.model.parameter_record import BaseParameter, FrictionChoice, HeldLoad, Parameter, Share
from deltaid.model.record import Consistency, Fit, IdentifiedModel, Settings
from deltaid.recording.readings import Readings
from deltaid.robot.inertia import pseudo_inertia
from deltaid.robot.parameter import ADDED
from deltaid.sensors.weighings import weighings


def judged_parameters(problem: FittedProblem, first: int = 0) -> tuple[Parameter, ...]:
    """The parameters of a fit from some on, with their intervals and what decided each.

    Those of additions follow the robot's.
    """
    labels, p_reg, judged = Labels(problem), problem.reduction.p_reg, list[Parameter]()
    moves = ambiguous(problem)
    for i, parameter in enumerate(problem.layout.parameters[first:], start=first):
        label, value = labels.label(i), float(problem.values[i])
        low, high = label.low, label.high
        if label.by != "prior":
            # Ranges are those of the recording alone; where a fit holds what the recording would
            # have otherwise, its estimate may be at their end.
            low, high = min(low, value - label.std), max(high, value + label.std)
        moved = moves.get(parameter.name, 0.0)
        low, high = min(low, low + moved), max(high, high + moved)
        judged.append(
            Parameter(
                name=parameter.name,
                value=value,
                std=float(label.std),
                low=float(min(max(low, parameter.low), value)),
                high=float(max(min(high, parameter.high), value)),
                unit=parameter.unit,
                prior=float(p_reg[i]),
                determined_by=label.by,
                rests_on=label.rests_on,
                share=label.share,
            )
        )
    return tuple(judged)


def judged_base(problem: FittedProblem) -> tuple[BaseParameter, ...]:
    """Base parameters of the robot with their intervals."""
    base, estimate = problem.base, problem.estimate
    by_noise, _ = estimate.by_noise
    noise = (by_noise / np.where(estimate.std > 0, estimate.std, 1.0)) ** 2
    rows = np.stack((estimate.values, estimate.std, estimate.interval, noise), axis=1).tolist()
    return tuple(
        BaseParameter(
            formula=group.formula(base.layout),
            representative=parameter.name,
            value=value,
            std=std,
            low=value - half,
            high=value + half,
            unit=parameter.unit,
            share=Share(noise=part, prior=0.0, geometry=1 - part),
        )
        for group, (value, std, half, part) in zip(base.groups, rows, strict=True)
        if (parameter := base.layout.parameters[group.representative]).kind not in ADDED
    )


def assembled(
    problem: FittedProblem,
    settings: Settings,
    error: TorqueError,
    judged: Sequence[Parameter],
    *,
    loads: tuple[HeldLoad, ...],
    readings: Readings | None = None,
    effects: tuple[FittedEffect, ...] = (),
    corrections: Sequence[Correction],
    sources: tuple[Source, ...],
    remarks: Sequence[str],
    choice: FrictionChoice | None = None,
    outcome: ContestOutcome | None = None,
) -> IdentifiedModel:
    """The model of a fit.

    Args:
        error: its torque errors.
        judged: its parameters, those of additions behind the robot's.
        loads: what is held, as fitted.
        readings: what drives read otherwise.
        effects: what takes torques beside the robot.
        corrections: what was corrected before it and by it, but for priors.
        sources: the recordings behind it.
        remarks: warnings about these.
        choice: how friction laws were chosen, if they were.
        outcome: of the contest that decided what was corrected.
    """
    count, layout, outcome = (
        len(problem.p),
        problem.layout,
        outcome or ContestOutcome(problem.dynamics.robot),
    )
    # What determines the scale of a fit's torques and masses beside torque constants, in words.
    facts = () if problem.information.facts is None else weighings(problem.dynamics.robot)
    known = [addition.witness for addition in problem.additions if addition.is_absolute]
    absolute = (*known, *(fact.name for fact in facts))
    moments = {body: pseudo_inertia(problem.p[layout.body(body)]) for body in layout.bodies}
    return IdentifiedModel(
        deltaid=version("deltaid"),
        identified_on=datetime.now(UTC).date(),
        robot=problem.dynamics.robot,
        parameters=tuple(judged[:count]),
        base_parameters=judged_base(problem),
        consistency=tuple(
            Consistency(body=body, eigenvalues=tuple(np.linalg.eigvalsh(M).tolist()))
            for body, M in moments.items()
        ),
        fit=_record(problem, error),
        settings=settings.changed(intervals="linear"),  # models are drawn where checks are made
        posterior=posterior_record(problem),
        loads=loads,
        readings=readings,
        effects=effects,
        sensors=fitted_sensors(problem, judged[count:]),
        corrections=(*corrections, *widened_priors(problem)),
        absolute=absolute,
        inseparable=(*inseparable(problem, absolute=bool(absolute)), *outcome.inseparable),
        friction_choice=choice,
        friction_curves=friction_curves(problem, error.fastest),
        sources=sources,
        warnings=(
            *remarks,
            *outcome.doubts.values(),
            *doubted_sensors(problem),
            *doubts_of_fit(problem),
        ),
    )


def doubts_of_fit(problem: FittedProblem) -> tuple[str, ...]:
    """Warnings that follow from the fit, one sentence a cause."""
    return (*doubts(problem), *torque_scale(problem))


def _record(problem: FittedProblem, error: TorqueError) -> Fit:
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
        base_parameters=sum(k < len(problem.p) for k in base.representatives),
        base_condition=base.condition,
        noise_level=problem.noise,
        rms=tuple(map(float, error.rms)),
        nrmse=tuple(map(float, error.nrmse)),
        rms_unfiltered=tuple(map(float, error.rms_unfiltered)),
    )
