"""Least-squares values of the base parameters (Sec. IV A), without consistency.

p_B = (Y_BᵀWY_B)⁻¹ Y_BᵀW τ̄, solved by QR from the information. The weight W is the identity
(ordinary), diag(τ_max)⁻² (weighted) or Σ⁻¹ with the covariance Σ of the drives' torque residuals
(Gauss–Markov, of least variance when the noise is white in time).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import IdentificationError, RecordingError
from deltaid.estimation.base_parameters import BaseParameters, base_parameters
from deltaid.estimation.information import Information, triangle
from deltaid.estimation.problem import LinearProblem
from deltaid.estimation.scatter import (
    Groups,
    Noise,
    Sums,
    half_width,
    inverse,
    observe,
    quantile,
)
from deltaid.identification.balance import balanced
from deltaid.identification.gathering import gather_all, places_of, whitened
from deltaid.identification.geometry import geometry, nearest
from deltaid.identification.measured_rows import MeasuredRows
from deltaid.identification.torque_error import torque_error
from deltaid.model.options import LeastSquaresMethod
from deltaid.recording.mapping import ColumnMappings
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import Recording, open_recordings
from deltaid.sensors.weighings import weighings


@dataclass(frozen=True)
class BaseEstimate:
    """Least-squares values p_B of the base parameters and how far they can be trusted.

    Attributes:
        method: the weight.
        interval: half the widths of their 95 % intervals.
        full: a vector p with these base parameters: representatives carry the values, the rest is
            zero.
        noise: what standard deviations and intervals come from.
    """

    method: LeastSquaresMethod
    values: Float[np.ndarray, " base"]
    std: Float[np.ndarray, " base"]
    interval: Float[np.ndarray, " base"]
    full: Float[np.ndarray, " parameters"]
    noise: Noise

    @property
    def by_noise(self) -> tuple[Float[np.ndarray, " base"], Float[np.ndarray, " base"]]:
        """Standard deviations by noise alone, and their degrees of freedom."""
        return self.noise.deviations(inverse(self.noise.root).T)

    def with_shifts(self, shifts: Float[np.ndarray, "base quantities"]) -> "BaseEstimate":
        """The same with wider intervals, for quantities that shift p_B by their deviations."""
        by_noise, freedom = self.by_noise
        std = np.hypot(by_noise, np.linalg.norm(shifts, axis=1))
        return replace(self, std=std, interval=half_width(std, by_noise, freedom))


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
    facts = weighings(dynamics.robot)
    gathered = balanced(gather_all(MeasuredRows(dynamics, facts), recordings), facts)
    information, groups = gathered.information, Groups(gathered.blocks, gathered.places)
    base = base_parameters(information, dynamics.layout)
    if method == "gauss-markov":
        estimate = _gauss_markov(base, information, dynamics, recordings)
    else:
        estimate = estimate_base(base, information, method, groups)
    p = nearest(dynamics, base, estimate.values)
    return base, estimate.with_shifts(geometry(dynamics, recordings, base, information, p).shifts)


def estimate_base(
    base: BaseParameters,
    information: Information,
    method: Literal["ordinary", "weighted"] = "weighted",
    groups: Groups | None = None,
) -> BaseEstimate:
    """Ordinary (W = I) or weighted (W = diag(τ_max)⁻²) least squares, with intervals.

    With groups of the samples, intervals come from the scatter between these (`scatter`). Without,
    the noise is taken to be white: Cov = σ̂² (Y_BᵀWY_B)⁻¹ with σ̂² from the residual.
    """
    ordinary = method == "ordinary"
    weights = np.ones(len(information.factors)) if ordinary else information.weights
    sums = groups.weighted(weights) if groups else {}
    factor = information.weighted(weights if ordinary else None)
    return _least_squares(base, information, factor, method, sums)


def _gauss_markov(
    base: BaseParameters,
    information: Information,
    dynamics: Dynamics,
    recordings: Sequence[Recording],
) -> BaseEstimate:
    """W = Σ⁻¹ with the covariance Σ of the drives' torque residuals over all samples."""
    full = estimate_base(base, information, "weighted").full
    covariances = [torque_error(dynamics, full, recording).covariance for recording in recordings]
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
    whitening, places = inverse(L.T).T, places_of(dynamics, recordings)
    factors = [
        factor
        for recording in recordings
        for factor in whitened(dynamics, recording, whitening, places)
    ]
    sums = {
        "time": np.stack([factor.T @ factor for factor in factors]),
        "place": places.sums.sum(axis=1),
    }
    return _least_squares(base, information, triangle(np.vstack(factors)), "gauss-markov", sums)


def _least_squares(
    base: BaseParameters,
    information: Information,
    factor: Float[np.ndarray, "augmented augmented"],
    method: LeastSquaresMethod,
    sums: dict[str, Sums],
) -> BaseEstimate:
    columns = np.searchsorted(information.columns, base.representatives)
    problem = LinearProblem.of_triangle(factor, information.rows).of_columns(columns)
    places = np.append(columns, len(information.columns))
    noise = observe(
        root=problem.root,
        values=problem.x,
        sigma=problem.noise,
        freedom=problem.freedom,
        groupings=((name, S[:, places][:, :, places]) for name, S in sums.items()),
    )
    std, nu = noise.deviations(inverse(noise.root).T)
    full = np.zeros(len(base.layout.names))
    full[base.representatives] = problem.x
    return BaseEstimate(method, problem.x, std, quantile(nu) * std, full, noise)
