"""Data's distribution of a robot's parameters, with all that was fitted with them averaged out.

Base parameters err by R⁻¹ s (`scatter`), whose size comes from the scatter of the recording along
each singular vector of R. Of all normal distributions whose deviations are those of the intervals,
the one nearest to that (Kullback–Leibler) is taken,

    V⁻¹ = V_0⁻¹ + diag(λ)    with    V_ii = (half an interval / 1.96)².

Scaling V_0 by rows and columns would have these deviations too, but would spoil sums that are known
a hundred times better than their terms. Geometry is added with its own correlations.

Additions contribute K_a a with a ~ N(a_0, S): averaging over them adds K_a S K_aᵀ to V, and rows
without the robot then determine, by their correlations, a part of the others' errors.
"""

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from deltaid.estimation.information import NOISE_FLOOR
from deltaid.estimation.objective import prior_scale
from deltaid.estimation.scatter import NORMAL, ROUNDING, correlations, inverse
from deltaid.identification.fit import FittedProblem
from deltaid.model.parameter_record import PosteriorRecord

# Steps at most, their largest length, and the gradient at the end.
_STEPS, _FAR, _AGREE = 200, 1e9, 1e-9
# κ: by which share of a variance it may be missed for each unit of λ.
_MISSED = 1e-3
# Digits of the factor that are kept: the noise itself is known to two.
_DIGITS = 7
# A coefficient below this share of its row's largest term is rounding.
_NEGLIGIBLE = 1e-9

Matrix = Float[np.ndarray, "n n"]


def posterior_record(problem: FittedProblem) -> PosteriorRecord:
    reduction, base, n = problem.reduction, problem.base, len(problem.p)
    sigma = max(problem.noise, NOISE_FLOOR)
    spread = sigma / float(np.sqrt(problem.information.mean_samples * problem.objective.gamma))
    scale, K = prior_scale(reduction), base.combination()
    extra = K[:, n:] * (spread * scale[n:])
    V = base_covariance(problem) + extra @ extra.T
    b = problem.estimate.values - K[:, n:] @ reduction.p_reg[n:]
    robots = np.array(base.representatives) < n
    values, V = _given(b, V, robots)
    names, rows = reduction.layout.names, K[robots, :n]
    L = np.linalg.cholesky(correlations(V)) * np.sqrt(np.diag(V))[:, None]
    return PosteriorRecord(
        spread=spread,
        wider={names[i]: float(w) for i, w in enumerate(reduction.wider[:n]) if w != 1},
        unseen=tuple(names[i] for i in np.setdiff1d(np.arange(n), problem.information.columns)),
        combinations=tuple(
            {names[i]: float(row[i]) for i in np.flatnonzero(terms > _NEGLIGIBLE * terms.max())}
            for row, terms in zip(rows, np.abs(rows * scale[:n]), strict=True)
        ),
        values=tuple(values.tolist()),
        factor=tuple(
            tuple(float(f"{value:.{_DIGITS - 1}e}") for value in row[: k + 1])
            for k, row in enumerate(L)
        ),
    )


def base_covariance(problem: FittedProblem) -> Matrix:
    """Covariance of the base parameters' errors, with the deviations that their intervals have."""
    noise, shifts = problem.estimate.noise, problem.geometry.shifts
    of_geometry = np.sum(shifts**2, axis=1)
    white = NOISE_FLOOR * np.linalg.norm(inverse(noise.root), axis=1)
    variances = np.maximum((problem.estimate.interval / NORMAL) ** 2 - of_geometry, white**2)
    # By noise with its own level in each direction that torques distinguish.
    size = np.linalg.norm(noise.root, axis=0)
    U, S, Vt = np.linalg.svd(noise.root / size)
    level = np.maximum(noise.deviations(U)[0], max(noise.sigma, NOISE_FLOOR))
    half = Vt.T * (level / S) / size[:, None]
    return with_variances(half @ half.T, variances) + shifts @ shifts.T


def with_variances(V: Matrix, variances: Float[np.ndarray, " n"]) -> Matrix:
    """The covariance with these variances that is nearest to another one.

    It minimises the convex function −log det(C⁻¹ + diag λ) + Σ λ_i r_i + ½ κ Σ λ_i², C the
    correlations and r what is wanted over what is there, both over their common level. κ > 0 lets
    variances be missed where having them would spoil sums that are known far better.
    """
    size = np.sqrt(np.diag(V))
    ratio = variances / size**2
    level = float(np.exp(np.mean(np.log(ratio))))
    w, U = np.linalg.eigh(correlations(V))
    L, ratio, unit = U * np.sqrt(np.maximum(w, ROUNDING)), ratio / level, np.eye(len(V))

    def covariance(lam: Float[np.ndarray, " n"]) -> Matrix:
        """(C⁻¹ + diag λ)⁻¹ = L (1 + Lᵀ diag(λ) L)⁻¹ Lᵀ with C = L Lᵀ, maybe nearly singular."""
        root = solve_triangular(np.linalg.cholesky(unit + (L.T * lam) @ L), L.T, lower=True)
        return root.T @ root

    def value(lam: Float[np.ndarray, " n"]) -> float:
        """But for log det C; infinite where there is no covariance."""
        values = np.linalg.eigvalsh(unit + (L.T * lam) @ L)
        if values[0] <= 0:
            return np.inf
        return float(lam @ ratio - np.log(values).sum() + 0.5 * _MISSED * lam @ lam)

    def curvature(lam: Float[np.ndarray, " n"]) -> Matrix:
        """Also where there is no covariance: SciPy asks for it before it rejects a step."""
        return (covariance(lam) ** 2 if np.isfinite(value(lam)) else 0.0) + _MISSED * unit

    solution = minimize(
        value,
        np.zeros(len(V)),
        method="trust-exact",
        jac=lambda lam: ratio - np.diag(covariance(lam)) + _MISSED * lam,
        hess=curvature,
        options={"gtol": _AGREE, "maxiter": _STEPS, "max_trust_radius": _FAR},
    )
    return level * covariance(solution.x) * np.outer(size, size)


def _given(
    b: Float[np.ndarray, " n"], V: Matrix, robots: np.ndarray
) -> tuple[Float[np.ndarray, " own"], Float[np.ndarray, "own own"]]:
    """Rows of the robot, given those that are errors alone."""
    size, others = np.sqrt(np.diag(V)), ~robots
    C, b = correlations(V), b / size
    if others.any():
        rows = np.column_stack([C[np.ix_(others, robots)], b[others]])
        half = solve_triangular(np.linalg.cholesky(C[np.ix_(others, others)]), rows, lower=True)
        C[np.ix_(robots, robots)] -= half[:, :-1].T @ half[:, :-1]
        b[robots] -= half[:, :-1].T @ half[:, -1]
    return (b * size)[robots], (C * np.outer(size, size))[np.ix_(robots, robots)]
