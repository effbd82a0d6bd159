"""A fit as the model that a file keeps: values, intervals, what decided them, what is doubtful."""

from collections.abc import Sequence
from importlib.metadata import version

from deltaid.identification.contradicted import contradicted
from deltaid.identification.doubts import doubts
from deltaid.identification.fit import FittedProblem, widened_priors
from deltaid.identification.friction_curves import friction_curves
from deltaid.identification.judgement import eigenvalues, judged_base, record
from deltaid.identification.marginal import posterior_record
from deltaid.identification.sensor_stage import fitted_sensors
from deltaid.identification.torque_error import TorqueError
from deltaid.identification.torque_scale import torque_scale
from deltaid.model.corrections import Correction
from deltaid.model.friction_record import FrictionChoice
from deltaid.model.parameter_record import HeldLoad, Parameter
from deltaid.model.record import IdentifiedModel, Settings, Source


def doubts_of_fit(problem: FittedProblem) -> tuple[str, ...]:
    """What a fit itself gives reason to doubt, one sentence a cause."""
    return (*doubts(problem), *contradicted(problem), *torque_scale(problem))


def assembled(
    problem: FittedProblem,
    settings: Settings,
    error: TorqueError,
    judged: Sequence[Parameter],
    *,
    loads: tuple[HeldLoad, ...],
    corrections: Sequence[Correction],
    sources: tuple[Source, ...],
    remarks: Sequence[str],
    choice: FrictionChoice | None = None,
) -> IdentifiedModel:
    """The model of a fit.

    Args:
        error: what it leaves of the torques.
        judged: its parameters, those of additions behind the robot's.
        loads: what is held, as the fit found it.
        corrections: what was put right before it and by it, but for priors.
        sources: the recordings behind it.
        remarks: what is to be said of these.
        choice: how friction laws were chosen, if they were.
    """
    own = len(problem.p)
    return IdentifiedModel(
        deltaid=version("deltaid"),
        robot=problem.dynamics.robot,
        parameters=tuple(judged[:own]),
        base_parameters=judged_base(problem),
        consistency=eigenvalues(problem.layout, problem.p),
        fit=record(problem, error),
        settings=settings.changed(intervals="linear"),  # models are drawn where checks are made
        posterior=posterior_record(problem),
        loads=loads,
        sensors=fitted_sensors(problem, judged[own:]),
        corrections=(*corrections, *widened_priors(problem)),
        friction_choice=choice,
        friction_curves=friction_curves(problem, error.fastest),
        sources=sources,
        warnings=(*remarks, *doubts_of_fit(problem)),
    )
