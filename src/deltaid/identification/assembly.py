"""Assembly of the identified model from a fit: values, intervals, corrections, warnings."""

from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version

import numpy as np

from deltaid.estimation.additions import split_by_addition
from deltaid.identification.doubts import doubts, inseparable
from deltaid.identification.fit import FittedProblem
from deltaid.identification.friction_constants import friction_curves
from deltaid.identification.gains import torque_scale
from deltaid.identification.judgement import judged_base, posterior_record
from deltaid.identification.measured_rows import SensorAddition
from deltaid.identification.setup import ContestOutcome
from deltaid.identification.torque_error import TorqueError
from deltaid.identification.widening import doubted_sensors, widened_priors
from deltaid.model.corrections import Correction, FittedChannel, FittedSensor, Source
from deltaid.model.parameter_record import HeldLoad, Parameter
from deltaid.model.record import Consistency, Fit, IdentifiedModel
from deltaid.robot.inertia import pseudo_inertia
from deltaid.sensors.weighings import weighings


def assembled(
    problem: FittedProblem,
    error: TorqueError,
    judged: Sequence[Parameter],
    *,
    loads: tuple[HeldLoad, ...],
    corrections: Sequence[Correction],
    sources: tuple[Source, ...],
    remarks: Sequence[str],
    outcome: ContestOutcome | None = None,
) -> IdentifiedModel:
    """The model of a fit.

    Args:
        error: torque errors of the fit.
        judged: parameters of the robot, then of additions.
        loads: as fitted.
        corrections: made before the fit and by it, without widened priors.
        sources: the recordings.
        remarks: warnings about the recordings.
        outcome: of the contest of causes.
    """
    count, absolute = len(problem.p), _references(problem)
    outcome = outcome or ContestOutcome(problem.dynamics.robot)
    return IdentifiedModel(
        deltaid=version("deltaid"),
        identified_on=datetime.now(UTC).date(),
        robot=problem.dynamics.robot,
        parameters=tuple(judged[:count]),
        base_parameters=judged_base(problem),
        consistency=_consistency(problem),
        fit=_record(problem, error),
        settings=problem.settings.changed(intervals="linear"),  # only `checks` draws models
        posterior=posterior_record(problem),
        loads=loads,
        sensors=_fitted_sensors(problem, judged[count:]),
        corrections=(*corrections, *widened_priors(problem)),
        absolute=absolute,
        inseparable=(*inseparable(problem, absolute=bool(absolute)), *outcome.inseparable),
        friction_curves=friction_curves(problem, error.fastest),
        sources=sources,
        warnings=(
            *remarks,
            *outcome.doubts.values(),
            *doubted_sensors(problem),
            *doubts_of_fit(problem),
        ),
    )


def _references(problem: FittedProblem) -> tuple[str, ...]:
    """In words, what fixes the scale of torques and masses in addition to torque constants."""
    additions = [addition.scale_reference for addition in problem.additions]
    facts = () if problem.information.facts is None else weighings(problem.dynamics.robot)
    return (*filter(None, additions), *(fact.name for fact in facts))


def _consistency(problem: FittedProblem) -> tuple[Consistency, ...]:
    layout = problem.layout
    moments = {body: pseudo_inertia(problem.p[layout.body(body)]) for body in layout.bodies}
    return tuple(
        Consistency(body=body, eigenvalues=tuple(np.linalg.eigvalsh(M).tolist()))
        for body, M in moments.items()
    )


def doubts_of_fit(problem: FittedProblem) -> tuple[str, ...]:
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


def _fitted_sensors(
    problem: FittedProblem, judged: Sequence[Parameter]
) -> tuple[FittedSensor, ...]:
    information, sensors = problem.information, list[FittedSensor]()
    rows = np.stack([information.rms(problem.values), information.torque_max], axis=1)
    sizes = iter(rows[information.drives.stop :].tolist())
    for sensor, fitted in split_by_addition(problem.additions, judged):
        if not isinstance(sensor, SensorAddition):
            continue
        channels = tuple(
            FittedChannel(name=c.name, unit=c.unit, stated=c.noise, left=residual, largest=largest)
            for c, (residual, largest) in zip(sensor.rows.channels, sizes, strict=False)
        )
        sensors.append(FittedSensor(name=sensor.rows.name, channels=channels, parameters=fitted))
    return tuple(sensors)
