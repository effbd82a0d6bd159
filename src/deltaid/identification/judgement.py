"""Which source decided each parameter of a fit (data, measured values, data with others' priors,
prior, or consistency), its interval, and the normal distribution of the base parameters by data.

Base parameters have the error R⁻¹ s (`scatter`), with the covariance V_0 by the recording's scatter
along each singular vector of R. Of all normal distributions with the deviations of the intervals,
the one nearest to this (Kullback–Leibler) is taken,

    V⁻¹ = V_0⁻¹ + diag(λ)    with    V_ii = (half an interval / 1.96)².

Scaling V_0 by rows and columns would have these deviations too, but spoil sums that are known a
hundred times better than their terms. Geometry is added with its own correlations.

Additions contribute K_a a with a ~ N(a_0, S): averaging over them adds K_a S K_aᵀ to V, and rows
without the robot then determine, by their correlations, a part of the others' errors."""

from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from deltaid.dynamics.parameters import inertia_size, stated_spreads
from deltaid.estimation.objective import Matrix, prior_scale
from deltaid.estimation.scatter import NORMAL, correlations, inverse, scaled_cholesky
from deltaid.identification.doubts import ambiguous
from deltaid.identification.fit import FittedProblem
from deltaid.identification.uncertainty import ConsistentRanges, Uncertainty, uncertainty
from deltaid.levels import FAINT, HARDLY, NEGLIGIBLE, ROUNDING
from deltaid.model.parameter_record import BaseParameter, Origin, Parameter, PosteriorRecord, Share
from deltaid.robot.inertia import MOMENTS_OF_INERTIA
from deltaid.robot.parameter import ADDED

# Data decides a parameter if its deviation is below this share of the prior's.
_SHRUNK = 0.5
# Usual asymmetry of a body: of its centre as a share of its radius of gyration, of inertias as a
# share of mass times this radius squared.
_ASYMMETRY = 0.3
# κ: share of a variance by which it may be missed per unit of λ.
_MISSED = 1e-3


def judged_parameters(problem: FittedProblem, first: int = 0) -> tuple[Parameter, ...]:
    """The parameters of a fit from the `first` on, those of additions behind the robot's, with
    intervals and the source that decided each."""
    judge = _Judge(problem)
    return tuple(judge.judged(i) for i in range(first, len(problem.layout.parameters)))


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


class _Judge:
    def __init__(self, problem: FittedProblem) -> None:
        reduction = problem.reduction
        self._problem, self._reduction, self._p = problem, reduction, problem.values
        self._parameters, self._moves = reduction.layout.parameters, ambiguous(problem)
        self._free = np.any(reduction.A != 0, axis=1)
        self._visible = np.isin(np.arange(len(self._p)), problem.information.columns)
        spread, scale = problem.settings.prior_spread, prior_scale(reduction)
        self._held_std = spread * scale
        # Deviation of the prior as widened, or of one that is wide enough for the fitted value.
        self._own_std = spread * np.maximum(
            scale / reduction.factors(reduction.widened), np.abs(self._p)
        )
        self._least_std = np.zeros(len(scale))  # of a prior that symmetry makes small
        stated = stated_spreads(problem.dynamics.robot)
        for body in reduction.layout.bodies:
            part = reduction.layout.body(body)
            size = _ASYMMETRY * inertia_size(reduction.p_reg[part])
            plain = [name not in stated for name in reduction.layout.names[part]]
            self._least_std[part] = np.where(plain, spread * size, 0.0)

    def judged(self, i: int) -> Parameter:
        value, prior = float(self._p[i]), float(self._reduction.p_reg[i])
        if self._free[i]:
            return self._of_added(i) if self._parameters[i].kind in ADDED else self._of_free(i)
        if value == 0:
            return self._parameter(i, "structure", 0.0, value, value)
        if self._visible[i]:
            return self._parameter(i, "fixed", 0.0, value, value)
        by = "prior" if np.isclose(value, prior, rtol=1e-9) else "consistency"
        return self._around_prior(i, by, self._held_std[i])

    def _of_added(self, i: int) -> Parameter:
        known, value = self._known, float(self._p[i])
        std, half = float(known.std[i]), float(known.interval[i])
        if std >= _SHRUNK * known.prior_std[i]:
            return self._around_prior(i, "prior", known.prior_std[i])
        share = Share.from_parts(known.shares[i])
        return self._parameter(i, "data", std, value - half, value + half, share=share)

    def _of_free(self, i: int) -> Parameter:
        """A free parameter of the robot.

        Data alone decides if the range without any prior is narrow. If it is not, but data and
        priors together know the parameter well, torques determine only a sum of it and others.
        """
        value, std = float(self._p[i]), float(self._known.std[i])
        prior_std = float(self._known.prior_std[i])
        if not self._visible[i]:
            # Consistency may have raised it above its value by the free variables.
            alone = self._reduction.A[i] @ self._problem.solution.x + self._reduction.p_0[i]
            raised = value > alone + NEGLIGIBLE * abs(alone)
            return self._around_prior(i, "consistency" if raised else "prior", prior_std)
        unit = np.eye(len(self._p))[i]
        low, high = self._ranges.ends(unit)
        ended, at_edge = np.isfinite(low) and np.isfinite(high), self._at_edge(i)
        if at_edge and value < HARDLY * self._reduction.p_reg[i]:
            low = self._parameters[i].low
            high = high if ended else self._prior_interval(i, prior_std)[2]
            return self._parameter(i, "limit", max(high - value, value - low) / NORMAL, low, high)
        enough = _SHRUNK * min(prior_std, float(self._own_std[i]))
        on = self._known.leading_priors(i, self._visible & self._free)
        half = 0.5 * (high - low)
        if half < NORMAL * enough or (ended and std < enough and not on):
            share = self._ranges.share(unit, low, high)
            by = "measured" if share.measured > 0.5 else "data"
            return self._parameter(i, by, min(std, half / NORMAL), low, high, share=share)
        if ended and std < enough:
            names = tuple(self._parameters[k].name for k in on)
            share = self._ranges.share(unit, low, high)
            return self._parameter(i, "sum", std, low, high, names, share)
        if ended and at_edge:  # the distance of the far end stands for a standard deviation
            return self._parameter(i, "limit", max(high - value, value - low) / NORMAL, low, high)
        return self._around_prior(i, "prior", prior_std)

    def _around_prior(self, i: int, by: Origin, std: float) -> Parameter:
        return self._parameter(i, by, *self._prior_interval(i, std))

    def _prior_interval(self, i: int, std: float) -> tuple[float, float, float]:
        """Standard deviation and ends of the prior's interval; log-normal for a moment of inertia,
        which is positive and known roughly."""
        prior, std = float(self._reduction.p_reg[i]), max(float(std), float(self._least_std[i]))
        if prior > 0 and self._parameters[i].symbol in MOMENTS_OF_INERTIA:
            factor = float(np.exp(NORMAL * np.sqrt(np.log1p((std / prior) ** 2))))
            return std, prior / factor, prior * factor
        return std, prior - NORMAL * std, prior + NORMAL * std

    def _parameter(
        self,
        i: int,
        by: Origin,
        std: float,
        low: float,
        high: float,
        rests_on: tuple[str, ...] = (),
        share: Share | None = None,
    ) -> Parameter:
        parameter, value = self._parameters[i], float(self._p[i])
        if by != "prior":
            # Ranges are those of the recording alone; the fitted value may be at their end.
            low, high = min(low, value - std), max(high, value + std)
        moved = self._moves.get(parameter.name, 0.0)
        low, high = min(low, low + moved), max(high, high + moved)
        return Parameter(
            name=parameter.name,
            value=value,
            std=float(std),
            low=float(min(max(low, parameter.low), value)),
            high=float(max(min(high, parameter.high), value)),
            unit=parameter.unit,
            prior=float(self._reduction.p_reg[i]),
            determined_by=by,
            rests_on=rests_on,
            share=share,
        )

    def _at_edge(self, i: int) -> bool:
        """Whether only consistency keeps a moment or a coefficient from being smaller."""
        parts = np.flatnonzero(self._reduction.A[i])
        factors, room = self._reduction.A[i][parts], self._room[parts]
        if np.any(factors < 0) or np.any(np.isnan(room)):
            return False
        return bool(factors @ room < HARDLY * (factors @ self._reduction.prior[parts]))

    @cached_property
    def _room(self) -> np.ndarray:
        """By how much each variable on the diagonal of a block could decrease, all others fixed."""
        room = np.full(self._reduction.size, np.nan)
        for block in self._reduction.blocks:
            # That of entry k is 1 / (M̄⁻¹)_kk, and M̄⁻¹ = L⁻ᵀL⁻¹ with M̄ = L Lᵀ.
            L = np.linalg.cholesky(block.matrix(self._problem.solution.x))
            places, diagonal = np.diag(block.index), np.sum(inverse(L.T) ** 2, axis=1)
            room[places[places >= 0]] = 1.0 / diagonal[places >= 0]
        return room

    @cached_property
    def _known(self) -> Uncertainty:
        return uncertainty(self._problem)

    @cached_property
    def _ranges(self) -> ConsistentRanges:
        return ConsistentRanges(self._problem)


def posterior_record(problem: FittedProblem) -> PosteriorRecord:
    problem = problem.with_own_friction
    reduction, base, n = problem.reduction, problem.base, len(problem.p)
    sigma = max(problem.noise, FAINT)
    spread = sigma / float(np.sqrt(problem.information.mean_samples * problem.objective.gamma))
    scale, K = prior_scale(reduction), base.combination()
    extra = K[:, n:] * (spread * scale[n:])
    V = base_covariance(problem) + extra @ extra.T
    b = problem.estimate.values - K[:, n:] @ reduction.p_reg[n:]
    robots = np.array(base.representatives) < n
    values, V = _given(b, V, robots)
    names, rows = reduction.layout.names, K[robots, :n]
    L, size = scaled_cholesky(V)
    return PosteriorRecord(
        spread=spread,
        wider={names[i]: float(w) for i, w in enumerate(reduction.wider[:n]) if w != 1},
        unseen=tuple(names[i] for i in np.setdiff1d(np.arange(n), problem.information.columns)),
        combinations=tuple(
            {names[i]: float(row[i]) for i in np.flatnonzero(terms > NEGLIGIBLE * terms.max())}
            for row, terms in zip(rows, np.abs(rows * scale[:n]), strict=True)
        ),
        values=tuple(values.tolist()),
        factor=tuple(
            tuple(float(f"{value:.6e}") for value in row[: k + 1])
            for k, row in enumerate(L * size[:, None])
        ),
    )


def base_covariance(problem: FittedProblem) -> Matrix:
    """Covariance of the base parameters' errors, with the deviations of their intervals."""
    noise, shifts = problem.estimate.noise, problem.geometry.shifts
    of_geometry = np.sum(shifts**2, axis=1)
    white = FAINT * np.linalg.norm(inverse(noise.root), axis=1)
    variances = np.maximum((problem.estimate.interval / NORMAL) ** 2 - of_geometry, white**2)
    # Noise has its own level along each singular vector.
    size = np.linalg.norm(noise.root, axis=0)
    U, S, Vt = np.linalg.svd(noise.root / size)
    level = np.maximum(noise.deviations(U)[0], max(noise.sigma, FAINT))
    half = Vt.T * (level / S) / size[:, None]
    return with_variances(half @ half.T, variances) + shifts @ shifts.T


def with_variances(V: Matrix, variances: Float[np.ndarray, " n"]) -> Matrix:
    """The covariance with these variances that is nearest to another one.

    It minimises the convex function −log det(C⁻¹ + diag λ) + Σ λ_i r_i + ½ κ Σ λ_i² with the
    correlations C and the ratios r of wanted and present variances, over their common level. κ > 0
    lets variances be missed where meeting them would spoil sums that are known far better.
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
        """The function without log det C; infinite where the sum is not positive definite."""
        values = np.linalg.eigvalsh(unit + (L.T * lam) @ L)
        if values[0] <= 0:
            return np.inf
        return float(lam @ ratio - np.log(values).sum() + 0.5 * _MISSED * lam @ lam)

    def curvature(lam: Float[np.ndarray, " n"]) -> Matrix:
        """Finite even where the value is not: SciPy asks for it before it rejects a step."""
        return (covariance(lam) ** 2 if np.isfinite(value(lam)) else 0.0) + _MISSED * unit

    solution = minimize(
        value,
        np.zeros(len(V)),
        method="trust-exact",
        jac=lambda lam: ratio - np.diag(covariance(lam)) + _MISSED * lam,
        hess=curvature,
        options={"gtol": NEGLIGIBLE, "max_trust_radius": np.inf},
    )
    return level * covariance(solution.x) * np.outer(size, size)


def _given(
    b: Float[np.ndarray, " n"], V: Matrix, robots: np.ndarray
) -> tuple[Float[np.ndarray, " own"], Float[np.ndarray, "own own"]]:
    """Distribution of the robot's base parameters, given the others, whose values are errors."""
    L, size = scaled_cholesky(V[np.ix_(~robots, ~robots)])
    rows = np.column_stack([V[np.ix_(~robots, robots)], b[~robots]]) / size[:, None]
    half = solve_triangular(L, rows, lower=True)
    explained = half.T @ half
    return b[robots] - explained[:-1, -1], V[np.ix_(robots, robots)] - explained[:-1, :-1]
