"""The whole identification: from a robot and its logs to a consistent model with intervals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import IdentificationError
from deltaid.identification.base_parameters import BaseParameters, base_parameters
from deltaid.identification.conic import Solution, solve_conic
from deltaid.identification.friction_choice import choose_friction
from deltaid.identification.information import Information, gather, merge, places_of
from deltaid.identification.least_squares import BaseEstimate, estimate_base
from deltaid.identification.log_cholesky import solve_log_cholesky
from deltaid.identification.model import (
    Fit,
    IdentifiedModel,
    Settings,
    Source,
    eigenvalues,
)
from deltaid.identification.objective import (
    Objective,
    data_term,
    default_gamma,
    noise_level,
)
from deltaid.identification.places import Places
from deltaid.identification.reduction import Reduction, build_reduction
from deltaid.identification.regularizer import build_regularizer
from deltaid.identification.scatter import Groups
from deltaid.identification.torque_error import TorqueError, torque_error
from deltaid.identification.uncertainty import (
    doubts,
    judged_base,
    judged_parameters,
    uncertainty,
)
from deltaid.recording.columns import ColumnMapping
from deltaid.recording.filter import LowPass
from deltaid.recording.log import Log
from deltaid.recording.windows import FilteredLog, open_logs
from deltaid.robot.description import RobotDescription

Progress = Callable[[str], None]

# How often load-dependent friction is fitted again at most, and when its shares have settled.
_LOAD_ROUNDS, _LOAD_SETTLED = 30, 1e-6


@dataclass(frozen=True)
class Identification:
    """An identified model with the evidence behind it.

    Attributes:
        model: the result.
        base: which combinations of parameters the motion determines.
        base_estimate: their weighted least-squares values, without consistency.
        information: the factors of the data.
        blocks: the same for consecutive stretches of the recordings.
        reduction: the free variables.
        solution: the minimiser of (15) and its certificate.
        recordings: the logs behind it, each with its filter.
    """

    model: IdentifiedModel
    base: BaseParameters
    base_estimate: BaseEstimate
    information: Information
    blocks: tuple[Information, ...]
    reduction: Reduction
    solution: Solution
    recordings: tuple[FilteredLog, ...]


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def identify(
    robot: RobotDescription,
    logs: Sequence[str | Path],
    *,
    columns: ColumnMapping | None = None,
    settings: Settings | None = None,
    progress: Progress = lambda _: None,
) -> Identification:
    """Identify a robot's dynamic parameters from recordings of the same machine.

    Args:
        robot: the description with geometry, priors and reductions.
        logs: CSV or Parquet files.
        columns: names and units of their columns, if not the default ones.
        settings: method, regulariser, γ, filter, friction laws.
        progress: called with a sentence before each stage.

    Raises:
        RecordingError: a log cannot be used.
        IdentificationError: the fit cannot be posed or did not converge.
    """
    settings = settings or Settings()
    filtered = open_logs(logs, compiled(robot).kinematics, columns, settings.cutoff, progress)
    choice = None
    if settings.friction == "choose":
        robot, choice = choose_friction(robot, filtered, progress)
    dynamics = compiled(robot)
    parts, places, reduction, objective, solution = _fitted(dynamics, filtered, settings, progress)
    blocks = tuple(block for part in parts for block in part)
    information = merge(blocks)
    base = base_parameters(information, dynamics.layout)
    estimate = estimate_base(base, information, groups=Groups(blocks, places.sums))
    p, spread = reduction.parameters(solution.x), settings.prior_spread
    uncertain = uncertainty(objective, reduction, information, base, estimate.noise)
    progress("comparing torques")
    errors = [torque_error(dynamics, p, *one) for one in filtered]
    used = [sum(block.samples for block in part) for part in parts]
    model = IdentifiedModel(
        deltaid=version("deltaid"),
        robot=robot,
        parameters=judged_parameters(p, reduction, uncertain, information.columns, spread),
        base_parameters=judged_base(base, estimate),
        consistency=eigenvalues(dynamics.layout, p),
        fit=_fit(solution, objective, information, base, reduction, _mean(errors, used)),
        settings=settings,
        friction_choice=choice,
        sources=tuple(
            _source(log, low_pass, count)
            for (log, low_pass), count in zip(filtered, used, strict=True)
        ),
        warnings=(
            *(f"{log.path}: {text}" for log, _ in filtered for text in log.warnings),
            *doubts(reduction, solution, objective, information, base, estimate, spread),
        ),
    )
    return Identification(
        model, base, estimate, information, blocks, reduction, solution, tuple(filtered)
    )


def _fitted(
    dynamics: Dynamics, filtered: Sequence[FilteredLog], settings: Settings, progress: Progress
) -> tuple[list[tuple[Information, ...]], Places, Reduction, Objective, Solution]:
    """Blocks of each recording, places of all of them, and the fit.

    Friction that depends on load sees the torques of the fit before, beginning with the prior,
    until its coefficients stay as they are.

    Raises:
        IdentificationError: they do not, or the fit fails.
    """
    robot, layout = dynamics.robot, dynamics.layout
    shares = [layout.names.index(f"load.{drive}") for drive in robot.load_drives]
    load = prior_parameters(robot) if shares else None
    for _ in range(_LOAD_ROUNDS):
        parts, places = [], places_of(dynamics, [log for log, _ in filtered])
        for log, low_pass in filtered:
            progress(f"evaluating {log.samples} samples of {log.path}")
            parts.append(gather(dynamics, log, low_pass, places, load))
        information = merge(block for part in parts for block in part)
        progress("fitting")
        reduction = build_reduction(robot, information.columns)
        objective = build_objective(information, reduction, settings)
        solution = solve(objective, reduction, settings)
        p = reduction.parameters(solution.x)
        if load is None or np.allclose(p[shares], load[shares], rtol=0, atol=_LOAD_SETTLED):
            return parts, places, reduction, objective, solution
        load = p
    raise IdentificationError(
        "friction that depends on load does not settle: the recording cannot tell it from the rest",
        cure="leave the load term out of the friction law",
    )


def build_objective(
    information: Information, reduction: Reduction, settings: Settings
) -> Objective:
    """Objective (15) for some information, with γ given or by maximum a posteriori."""
    gamma = settings.gamma or default_gamma(information, settings.prior_spread)
    regularizer = build_regularizer(settings.regularizer, reduction)
    return Objective(data_term(information, reduction), regularizer, gamma)


def solve(objective: Objective, reduction: Reduction, settings: Settings) -> Solution:
    """Minimise by the method asked for. The log-Cholesky route borrows the conic bound.

    Raises:
        IdentificationError: the solver did not converge.
    """
    if settings.method == "conic":
        return solve_conic(objective, reduction)
    solution = solve_log_cholesky(objective, reduction)
    if objective.regularizer.name == "riemannian":
        return solution
    bound = solve_conic(objective, reduction).bound
    return Solution(solution.x, solution.objective, bound, solution.iterations, solution.status)


def _fit(
    solution: Solution,
    objective: Objective,
    information: Information,
    base: BaseParameters,
    reduction: Reduction,
    error: TorqueError,
) -> Fit:
    certified = bool(np.isfinite(solution.bound))
    return Fit(
        objective=solution.objective,
        lower_bound=solution.bound if certified else None,
        duality_gap=solution.duality_gap if certified else None,
        gamma=objective.gamma,
        status=solution.status,
        iterations=solution.iterations,
        optimization_variables=reduction.size,
        base_parameters=base.rank,
        base_condition=base.condition,
        noise_level=noise_level(information),
        rms=tuple(map(float, error.rms)),
        nrmse=tuple(map(float, error.nrmse)),
        rms_unfiltered=tuple(map(float, error.rms_unfiltered)),
    )


def _mean(errors: list[TorqueError], weights: list[int]) -> TorqueError:
    """Torque errors over several recordings, weighted by their samples."""
    share = np.array(weights)[:, None] / sum(weights)

    def together(squares: list[np.ndarray]) -> np.ndarray:
        return np.sqrt(np.sum(share * np.array(squares), axis=0))

    rms = together([e.rms**2 for e in errors])
    torque = together([(e.rms / e.nrmse) ** 2 for e in errors])
    covariance = np.einsum("i,ijk->jk", share[:, 0], np.array([e.covariance for e in errors]))
    raw = together([e.rms_unfiltered**2 for e in errors])
    return TorqueError(rms, rms / torque, raw, covariance, errors[0].cutoff)


def _source(log: Log, low_pass: LowPass | None, used: int) -> Source:
    return Source(
        log=log.path.name,
        sha256=log.sha256,
        samples=log.samples,
        rate_hz=log.rate,
        cutoff_hz=low_pass.cutoff if low_pass else None,
        used_samples=used,
    )
