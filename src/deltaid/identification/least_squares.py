"""Least-squares values of the base parameters (Sec. IV A), without any thought of consistency.

p_B = (Y_BᵀWY_B)⁻¹ Y_BᵀW τ̄, solved by QR from the information. The weight W is the identity
(ordinary), diag(τ_max)⁻² (weighted) or Σ⁻¹ with the covariance Σ of the drives' torque residuals
(Gauss–Markov, of least variance when the noise is white in time).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import IdentificationError
from deltaid.identification.base import BaseParameters, base_parameters
from deltaid.identification.information import (
    Information,
    gather,
    gather_samples,
    merge,
    triangle,
    whitened,
)
from deltaid.identification.torque_error import torque_error
from deltaid.motion.random_motion import random_motion
from deltaid.recording.columns import ColumnMapping
from deltaid.recording.windows import FilteredLog, open_logs

LeastSquaresMethod = Literal["ordinary", "weighted", "gauss-markov"]


@dataclass(frozen=True)
class BaseEstimate:
    """Least-squares values of the base parameters with their standard deviations."""

    method: LeastSquaresMethod
    values: Float[np.ndarray, " base"]
    std: Float[np.ndarray, " base"]
    full: Float[np.ndarray, " parameters"]
    """A vector p with these base parameters: representatives carry the values, the rest is zero."""


def random_motion_base(dynamics: Dynamics, seed: int = 0) -> BaseParameters:
    """The base parameters that a generic motion within the robot's limits determines.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    motion = random_motion(dynamics.kinematics, np.random.default_rng(seed))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, 2000))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = np.zeros_like(z)
    if dynamics.robot.load_drives:
        tau = dynamics.torque(z, qd, qdd, prior_parameters(dynamics.robot))
    information = gather_samples(dynamics, z, qd, qdd, tau)
    return base_parameters(information, dynamics.layout)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for small matrices, threads only wait
def identify_base(
    dynamics: Dynamics,
    logs: Sequence[str | Path],
    method: LeastSquaresMethod = "weighted",
    *,
    columns: ColumnMapping | None = None,
    cutoff: float | None = None,
) -> tuple[BaseParameters, BaseEstimate]:
    """Base parameters and their values from recordings.

    Gauss–Markov takes Σ from the residuals of the weighted estimate and reads the logs twice more.

    Raises:
        RecordingError: a log cannot be used.
        IdentificationError: the motion does not determine the base parameters.
    """
    filtered = open_logs(logs, dynamics.kinematics, columns, cutoff)
    information = merge([block for one in filtered for block in gather(dynamics, *one)])
    base = base_parameters(information, dynamics.layout)
    if method != "gauss-markov":
        return base, estimate_base(base, information, method)
    first = estimate_base(base, information, "weighted")
    covariance = _residual_covariance(dynamics, first, filtered)
    try:
        L = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise IdentificationError(
            "the drives' torque residuals are linearly dependent, so they have no inverse "
            "covariance",
            cure="use weighted least squares",
        ) from None
    whitening = solve_triangular(L, np.eye(dynamics.dof), lower=True)
    factors = [whitened(dynamics, *one, whitening) for one in filtered]
    return base, estimate_gauss_markov(base, information, triangle(np.vstack(factors)))


def estimate_base(
    base: BaseParameters,
    information: Information,
    method: Literal["ordinary", "weighted"] = "weighted",
) -> BaseEstimate:
    """Ordinary (W = I) or weighted (W = diag(τ_max)⁻²) least squares, with standard deviations.

    Cov = σ̂² (Y_BᵀWY_B)⁻¹ with σ̂² from the residual.
    """
    dof = len(information.factors)
    weights = np.ones(dof) if method == "ordinary" else information.torque_max**-2.0
    rows = information.samples * dof
    return _least_squares(base, information, information.weighted(weights), method, rows)


def estimate_gauss_markov(
    base: BaseParameters,
    information: Information,
    whitened: Float[np.ndarray, "augmented augmented"],
) -> BaseEstimate:
    """Gauss–Markov estimate: W = Σ⁻¹ with the covariance Σ of the drives' residuals.

    Args:
        whitened: factor of Σ^-½ [Ȳ, τ̄], from `information.whitened`.
    """
    rows = information.samples * len(information.factors)
    return _least_squares(base, information, whitened, "gauss-markov", rows)


def _least_squares(
    base: BaseParameters,
    information: Information,
    factor: Float[np.ndarray, "augmented augmented"],
    method: LeastSquaresMethod,
    rows: int,
) -> BaseEstimate:
    columns = [group.representative for group in base.groups]
    at = np.searchsorted(information.columns, columns)
    norms = np.linalg.norm(factor[:, at], axis=0)
    Q, R = np.linalg.qr(factor[:, at] / norms)
    projected = Q.T @ factor[:, -1]
    values = solve_triangular(R, projected) / norms
    residual = np.linalg.norm(factor[:, -1] - Q @ projected)
    sigma = residual / np.sqrt(max(rows - base.rank, 1))
    inverse = solve_triangular(R, np.eye(base.rank)) / norms[:, None]
    full = np.zeros(len(base.layout.names))
    full[columns] = values
    return BaseEstimate(method, values, sigma * np.linalg.norm(inverse, axis=1), full)


def _residual_covariance(
    dynamics: Dynamics, estimate: BaseEstimate, filtered: Sequence[FilteredLog]
) -> Float[np.ndarray, "dof dof"]:
    """Σ: mean of e eᵀ over the samples of all logs, e the drives' torque residuals."""
    errors = [torque_error(dynamics, estimate.full, *one) for one in filtered]
    weights = np.array([log.samples for log, _ in filtered], dtype=float)
    return np.einsum("i,ijk->jk", weights / weights.sum(), np.array([e.covariance for e in errors]))
