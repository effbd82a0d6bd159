"""Widening of priors that a recording contradicts.

Before the recording, its least-squares base parameters b are normal about K p_prior with the
covariance

    C = N + K A P⁻¹ Aᵀ Kᵀ,    P = Σ_j r_j r_jᵀ / s_j²

where N is their uncertainty by noise and geometry, r_j x the distance of entry j of p = A x + p_0
from its prior in stated standard deviations, and s_j ≥ 1 the factor by which this prior is widened.
The s of largest evidence log N(b; K p_prior, C) explain the recording best (empirical Bayes,
type-II maximum likelihood). Entries are widened one by one while one gains enough (as in Tipping
and Faul 2003), or all of a body together (another density), or its moments of inertia (another
size), each by the best of some factors. Of those that gain nearly the same, the one that needs the
least widening is taken. Friction is identifiable without prior. Tolerances of a sensor's pose, gain
and zero are priors too: if the description holds, q²/a of an entry, with s = 1 for it, is χ² of one
degree of freedom, u = K A P⁻¹ r/s, a = uᵀC⁻¹u, q = uᵀC⁻¹(b − K p_prior).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_solve, solve_triangular

from deltaid.dynamics.dynamics import Parameters
from deltaid.errors import Doubt
from deltaid.estimation.conic import SOLVERS, minimise
from deltaid.estimation.information import triangle
from deltaid.estimation.objective import parameter_scale, pose
from deltaid.estimation.scatter import inverse, scaled_cholesky, surprise
from deltaid.identification.fit import FittedProblem, posed, settled, with_geometry
from deltaid.levels import EXACT, ROUNDS
from deltaid.model.corrections import Correction
from deltaid.recording.recording import PreparedRecording

# Gains in twice the logarithm of the evidence: the least for a factor to count; the difference up
# to which two entries explain a recording alike; and the prior odds, e⁵, of a body that is off as a
# whole against a single entry.
_SIGNIFICANT, CLOSE, _LIKELIER = 15.0, 2.0, 10.0
# Largest factor of a prior.
_WIDEST = 1e5
# Factors that are tried.
_TRIED = tuple(float(factor) for factor in np.geomspace(1.5, _WIDEST, 24))
_KINDS = ("inertia", "rotor", "spring", "sensor")
# Surprise from which a tolerance of a sensor is doubted [decades].
_DOUBTED = 5.0
# What may be wrong with a sensor, by the first word of its unknown.
_CAUSES = {
    "position": "the sensor stands elsewhere than described",
    "rotation": "its axes are turned against those described",
    "gain": "its own factor, or torque constants that are off",
}

Factors = Float[np.ndarray, " rows"]


class _Wider(NamedTuple):
    """A factor for the priors of some entries, and its gain of evidence."""

    at: list[int]
    factor: float
    gain: float


@dataclass(frozen=True)
class PriorEvidence:
    """A recording's evidence against a prior."""

    names: tuple[str, ...]  # of the entries of p whose priors may be widened
    # which of them belong to one body, and which are moments of inertia of one
    bodies: tuple[list[int], ...]
    # r of all entries of p that x can change; those of `names` come first
    rows: Float[np.ndarray, "rows n"]
    columns: Float[np.ndarray, "base n"]  # K A
    d: Float[np.ndarray, " base"]  # b − K p_prior
    N: Float[np.ndarray, "base base"]  # covariance of b given the truth

    def contradicted(self) -> dict[str, float]:
        """Entries whose prior the recording contradicts, with the factor of its spread."""
        s = np.ones(len(self.rows))
        for _ in range(ROUNDS):
            entry = _least(self._widest(s, [[j] for j in range(len(self.names))]))
            body = _least(self._widest(s, self.bodies))
            likelier = body.gain >= max(_SIGNIFICANT, entry.gain - _LIKELIER)
            chosen = body if likelier else entry
            if chosen.gain < _SIGNIFICANT:
                break
            s[chosen.at] = np.maximum(s[chosen.at], chosen.factor)
        return {name: float(s[j]) for j, name in enumerate(self.names) if s[j] > 1}

    def farthest(self, name: str) -> tuple[int, float]:
        """The base parameter in which an entry's prior is contradicted most, and by how many
        standard deviations of noise and all priors together."""
        C, u = self._covariance(np.ones(len(self.rows)))
        response, variances = np.abs(u[:, self.names.index(name)]), np.diag(C)
        k = int(np.argmax(np.abs(self.d) * response / variances))
        return k, float(np.abs(self.d[k]) / np.sqrt(variances[k]))

    def surprise(self, name: str, factors: Mapping[str, float]) -> float:
        """−log₁₀ of the probability that an entry is so far from its prior, others as wide as
        `factors` have them."""
        s = np.ones(len(self.rows))
        s[: len(self.names)] = [factors.get(other, 1.0) for other in self.names]
        j = self.names.index(name)
        s[j] = 1.0
        C, responses = self._covariance(s)
        L, size = scaled_cholesky(C)
        u = responses[:, j] / size
        a, q = u @ (solved := cho_solve((L, True), u)), solved @ (self.d / size)
        return surprise(float(q**2 / a), 1) if a > np.finfo(float).eps else 0.0

    def _covariance(self, s: Factors) -> tuple[np.ndarray, np.ndarray]:
        """C and all u."""
        rows = self.rows / s[:, None]
        half = inverse(triangle(rows))  # P^-½
        of_rows, of_base = rows @ half, self.columns @ half
        return self.N + of_base @ of_base.T, of_base @ of_rows.T

    def _widest(self, s: Factors, groups: Iterable[list[int]]) -> Iterator[_Wider]:
        """Each group of entries with the best factor of some."""
        now = self._value(s)
        for entries in groups:
            tried = list[_Wider]()
            for factor in _TRIED:
                wider = s.copy()
                wider[entries] = np.maximum(s[entries], factor)
                tried.append(_Wider(entries, factor, self._value(wider) - now))
            yield max(tried, key=lambda wider: wider.gain)

    def _value(self, s: Factors) -> float:
        """Twice the logarithm of the evidence, but for a constant."""
        L, size = scaled_cholesky(self._covariance(s)[0])
        residual = solve_triangular(L, self.d / size, lower=True)
        return float(-residual @ residual - 2 * np.log(size * np.diag(L)).sum())


def _least(candidates: Iterable[_Wider]) -> _Wider:
    """Of those that gain nearly the most, the one that needs the least widening."""
    candidates = list(candidates)
    best = max((wider.gain for wider in candidates), default=0.0)
    close = (wider for wider in candidates if wider.gain >= best - CLOSE)
    return min(close, key=lambda wider: wider.factor, default=_Wider([], 1.0, -np.inf))


def evidence(problem: FittedProblem) -> PriorEvidence:
    reduction, base, estimate = problem.reduction, problem.base, problem.estimate
    changed = np.flatnonzero(np.any(reduction.A != 0, axis=1)).tolist()
    parameters = reduction.layout.parameters
    own = [i for i in changed if parameters[i].kind in _KINDS]
    order = own + [i for i in changed if parameters[i].kind not in _KINDS]
    spread = problem.settings.prior_spread * reduction.factors(reduction.stated)
    scale = spread * parameter_scale(reduction.layout, reduction.p_reg)
    K, A = base.combination(), reduction.A * reduction.scale  # x in its own sizes
    deviations = np.maximum(estimate.std, EXACT * np.linalg.norm(K * scale, axis=1))
    half = inverse(estimate.noise.root)
    half *= (deviations / np.linalg.norm(half, axis=1))[:, None]
    groups: dict[tuple[str, str], list[int]] = {}
    for j, parameter in enumerate(parameters[i] for i in own):
        if parameter.kind == "inertia":
            for which in ("", "I") if parameter.symbol.startswith("I") else ("",):
                groups.setdefault((parameter.owner, which), []).append(j)
    return PriorEvidence(
        tuple(parameters[i].name for i in own),
        tuple(groups.values()),
        A[order] / scale[order][:, None],
        K @ A,
        estimate.values - K @ reduction.p_reg,
        half @ half.T,
    )


def with_widened_prior(
    problem: FittedProblem, recordings: Sequence[PreparedRecording]
) -> FittedProblem:
    """The same fit with priors that its recordings contradict as wide as their evidence asks for.

    A weight γ of the prior that the user has chosen stays. What gears carry follows, so that where
    friction depends on it the fit is posed again until its shares stay as they are.
    """
    wide = widened(problem)
    if wide is problem or not problem.dynamics.robot.load_drives:
        return wide

    def again(load: Parameters | None) -> FittedProblem:
        fitted = posed(problem.dynamics, recordings, problem.settings, problem.additions, load)
        fitted = replace(fitted, moves=problem.moves, undetected=problem.undetected)
        return widened(with_geometry(fitted, recordings))

    return settled(again, wide.p)[0]


def widened(problem: FittedProblem) -> FittedProblem:
    """With wider priors and the rows as they are; itself where no prior is contradicted."""
    settings = problem.settings
    if settings.gamma is not None or not (factors := evidence(problem).contradicted()):
        return problem
    objective = pose(problem.information, replace(problem.reduction, widened=factors), settings)
    solution = minimise(objective, SOLVERS[settings.method])
    return replace(problem, objective=objective, solution=solution)


def doubted_sensors(problem: FittedProblem) -> Iterator[str]:
    """Poses, gains and zeros of sensors that lie beyond the tolerance of the description."""
    parameters = problem.layout.parameters
    if not any(parameter.kind == "sensor" for parameter in parameters):
        return
    against, factors = evidence(problem), problem.reduction.widened
    for parameter, value in zip(parameters, problem.values.tolist(), strict=True):
        if parameter.kind != "sensor" or parameter.name not in against.names:
            continue
        digits = against.surprise(parameter.name, factors)
        if digits < _DOUBTED:
            continue
        unit = parameter.unit
        yield Doubt(
            f"sensors.{parameter.owner}: {parameter.symbol} is {value:.3g} {unit}, and "
            f"{parameter.prior:.3g} ± {parameter.std:.2g} {unit} as described (probability "
            f"1e-{digits:.0f})",
            cause=_CAUSES.get(parameter.symbol.partition("_")[0], "it was not tared"),
            cure="measure it and correct the description, or state a larger tolerance",
        )


def widened_priors(problem: FittedProblem) -> Iterator[Correction]:
    """The priors that were widened, as corrections: one a body or joint."""
    base, estimate, factors = problem.base, problem.estimate, problem.reduction.widened
    against = evidence(problem)
    owners: dict[str, list[str]] = {}
    for parameter in base.layout.parameters:
        if parameter.name in factors:
            owners.setdefault(parameter.owner, []).append(parameter.name)
    for owner, names in owners.items():
        k, apart = max(map(against.farthest, names), key=lambda place: place[1])
        unit, value = base.layout.units[base.representatives[k]], estimate.values[k]
        largest = max(factors[name] for name in names)
        priors = ", ".join(f"{name} {factors[name]:.2g} times" for name in names)
        if len(names) > 2 and all(factors[name] == largest for name in names):
            second = all(name.startswith(f"{owner}.I") for name in names)
            whose = f"the moments of inertia of {owner}" if second else owner
            priors = f"those of {whose} {largest:.2g} times"
        text = (
            f"the recording alone gives {base.formulas[k]} = {value:.3g} ± "
            f"{estimate.interval[k]:.2g} {unit}, the description {value - against.d[k]:.3g} "
            f"{unit}, {apart:.2g} standard deviations away. Prior spread widened: {priors}. If "
            "only a sum is determined, another of its terms may be wrong"
        )
        yield Correction(kind="prior", subject=owner, value=largest, text=text)
