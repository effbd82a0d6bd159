"""Least-squares values of the base parameters (Sec. IV A), without consistency.

p_B = (Y_BᵀWY_B)⁻¹ Y_BᵀW τ̄, solved by QR from the information. The weight W is the identity
(ordinary), diag(τ_max)⁻² (weighted) or Σ⁻¹ with the covariance Σ of the drives' torque residuals
(Gauss–Markov, of least variance when the noise is white in time).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import IdentificationError, RecordingError
from deltaid.estimation.base_parameters import BaseParameters, base_parameters
from deltaid.estimation.information import Information
from deltaid.estimation.objective import parameter_scale
from deltaid.estimation.problem import LinearProblem
from deltaid.estimation.scatter import Noise, half_width, inverse, observe
from deltaid.identification.gathering import Gathered, gather_all, gather_balanced
from deltaid.identification.geometric_rows import geometry
from deltaid.identification.torque_error import torque_error
from deltaid.model.options import LeastSquaresMethod
from deltaid.recording.mapping import ColumnMappings
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import PreparedRecording, open_recordings


@dataclass(frozen=True)
class BaseEstimate:
    """Least-squares values p_B of the base parameters with intervals.

    Attributes:
        method: the weight.
        full: a vector p with these base parameters: representatives have the values, others are 0.
        noise: of the rows.
        shifts: of p_B by the standard deviations of uncertain quantities.
    """

    method: LeastSquaresMethod
    values: Float[np.ndarray, " base"]
    full: Float[np.ndarray, " parameters"]
    noise: Noise
    shifts: Float[np.ndarray, "base quantities"]

    @cached_property
    def by_noise(self) -> tuple[Float[np.ndarray, " base"], Float[np.ndarray, " base"]]:
        """Standard deviations by noise alone, and their degrees of freedom."""
        return self.noise.deviations(inverse(self.noise.root).T)

    @property
    def std(self) -> Float[np.ndarray, " base"]:
        """Standard deviations by noise and shifts."""
        return np.hypot(self.by_noise[0], np.linalg.norm(self.shifts, axis=1))

    @property
    def interval(self) -> Float[np.ndarray, " base"]:
        """Half widths of the 95 % intervals."""
        return half_width(self.std, *self.by_noise)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def identify_base(
    dynamics: Dynamics,
    logs: RecordingLike | Sequence[RecordingLike],
    method: LeastSquaresMethod = "weighted",
    *,
    columns: ColumnMappings = None,
    cutoff: float | None = None,
    keep_all: bool = False,
) -> tuple[BaseParameters, BaseEstimate]:
    """Base parameters and their values from recordings.

    Gauss–Markov takes Σ from the residuals of the weighted estimate and reads the logs twice more.
    `keep_all` excludes nothing from the recordings, as that of `Settings`.

    Raises:
        RecordingError: a log cannot be used.
        IdentificationError: the motion does not determine the base parameters.
    """
    recordings = open_recordings(logs, dynamics.kinematics, columns, cutoff, keep_all=keep_all)
    for recording in recordings:
        if recording.log.columns.loads:
            raise RecordingError(
                "declares a load, and base parameters are those of the robot alone",
                where=str(recording.path),
                cure="give a recording without load; `deltaid identify` fits loads with the robot",
            )
    gathered = gather_balanced(dynamics, recordings)
    base = base_parameters(gathered.information, dynamics.layout)
    if method == "gauss-markov":
        whitening = _whitening(dynamics, recordings, estimate_base(base, gathered.information).full)
        white = gather_all(dynamics, recordings, whitening=whitening)
        information = replace(white.information, facts=gathered.information.facts)
        estimate = replace(estimate_base(base, information, "ordinary", white), method=method)
    else:
        estimate = estimate_base(base, gathered.information, method, gathered)
    # p nearest to the prior, by its sizes S: p_reg + S² Kᵀ (K S² Kᵀ)⁻¹ (p_B − K p_reg).
    K, prior = base.combination(), prior_parameters(dynamics.robot)
    S = np.diag(parameter_scale(dynamics.layout, prior))
    p = prior + S @ np.linalg.lstsq(K @ S, estimate.values - K @ prior, rcond=None)[0]
    shifts = geometry(dynamics, recordings, base, gathered.information, p).shifts
    return base, replace(estimate, shifts=shifts)


def estimate_base(
    base: BaseParameters,
    information: Information,
    method: Literal["ordinary", "weighted"] = "weighted",
    groups: Gathered | None = None,
) -> BaseEstimate:
    """Ordinary (W = I) or weighted (W = diag(τ_max)⁻²) least squares, with intervals.

    With groups of the samples, intervals come from the scatter between these (`scatter`). Without,
    the noise is taken to be white: Cov = σ̂² (Y_BᵀWY_B)⁻¹ with σ̂² from the residual.
    """
    ordinary = method == "ordinary"
    weights = np.ones(len(information.factors)) if ordinary else information.weights
    factor = information.weighted(weights if ordinary else None)
    columns = np.searchsorted(information.columns, base.representatives)
    places = np.append(columns, len(information.columns))
    problem = LinearProblem.of_triangle(factor[:, places], information.rows)
    sums = groups.weighted(weights) if groups else {}
    noise = observe(
        root=problem.root,
        values=problem.x,
        sigma=problem.noise,
        freedom=problem.freedom,
        groupings=((name, S[:, places][:, :, places]) for name, S in sums.items()),
    )
    full = np.zeros(len(base.layout.names))
    full[base.representatives] = problem.x
    return BaseEstimate(method, problem.x, full, noise, np.zeros((base.rank, 0)))


def _whitening(
    dynamics: Dynamics, recordings: Sequence[PreparedRecording], p: Parameters
) -> Float[np.ndarray, "dof dof"]:
    """Σ^-½ with the covariance Σ of the drives' torque residuals over all samples."""
    covariances = [torque_error(dynamics, p, recording).covariance for recording in recordings]
    samples = [recording.log.samples for recording in recordings]
    try:
        L = np.linalg.cholesky(np.average(covariances, axis=0, weights=samples))
    except np.linalg.LinAlgError:
        raise IdentificationError(
            "the drives' torque residuals are linearly dependent, so they have no inverse "
            "covariance",
            where="--method gauss-markov",
            cure="use weighted least squares",
        ) from None
    return inverse(L.T).T
