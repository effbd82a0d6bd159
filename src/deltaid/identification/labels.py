"""What decided each parameter of a fit: data, measured values, data with others' priors, prior, or
consistency."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deltaid.dynamics.parameters import inertia_size, stated_spreads
from deltaid.estimation.regularizer import prior_scale
from deltaid.estimation.scatter import NORMAL, inverse
from deltaid.identification.fit import FittedProblem
from deltaid.identification.uncertainty import ConsistentRanges, Uncertainty, uncertainty
from deltaid.model.parameter_record import Origin, Share
from deltaid.robot.inertia import MOMENTS_OF_INERTIA
from deltaid.robot.parameter import ADDED

# The data decides a parameter that it knows to less than this share of the prior's deviation.
_SHRUNK = 0.5
# A positive parameter below this share of its prior has fallen to its bound, and one whose body
# leaves less room than this share of the prior below it is at the edge of consistency.
_FELL = 1e-3
# Measured values have decided what they leave more than this share of open.
_MOSTLY = 0.5
# A share of a value that is rounding.
_ROUNDING = 1e-9
# How far a body may be from the symmetry of its description: its centre as a share of its radius of
# gyration, its inertias as one of its mass times that squared.
_ASYMMETRY = 0.3


@dataclass(frozen=True)
class Label:
    """What decided a parameter, its standard deviation, and the ends of its 95 % interval."""

    by: Origin
    std: float
    low: float
    high: float
    rests_on: tuple[str, ...] = ()  # other parameters whose priors it rests on, if it does
    share: Share | None = None  # what its interval comes from, where data has a part in it


class Labels:
    """Decides for each parameter of a fit what decided it."""

    def __init__(self, problem: FittedProblem) -> None:
        reduction = problem.reduction
        self._problem, self._reduction, self._p = problem, reduction, problem.values
        self._parameters = reduction.layout.parameters
        self._free = np.any(reduction.A != 0, axis=1)
        self._visible = np.isin(np.arange(len(self._p)), problem.information.columns)
        spread, scale = problem.settings.prior_spread, prior_scale(reduction)
        self._held_std = spread * scale
        # The deviation of a prior that is wide enough for a value of this size.
        self._own_std = spread * np.maximum(scale / reduction.factors, np.abs(self._p))
        self._least_std = np.zeros(len(scale))  # of a prior that symmetry makes small
        stated = stated_spreads(problem.dynamics.robot)
        for body in reduction.layout.bodies:
            part = reduction.layout.body(body)
            size = _ASYMMETRY * inertia_size(reduction.p_reg[part])
            plain = [name not in stated for name in reduction.layout.names[part]]
            self._least_std[part] = np.where(plain, spread * size, 0.0)

    def label(self, i: int) -> Label:
        value, prior = float(self._p[i]), float(self._reduction.p_reg[i])
        if self._free[i]:
            return self._of_added(i) if self._parameters[i].kind in ADDED else self._of_free(i)
        if value == 0:
            return Label("structure", 0.0, value, value)
        if self._visible[i]:
            return Label("fixed", 0.0, value, value)
        by = "prior" if np.isclose(value, prior, rtol=1e-9) else "consistency"
        return self._around_prior(i, by, self._held_std[i])

    def _of_added(self, i: int) -> Label:
        known, value = self._known, float(self._p[i])
        if known.std[i] >= _SHRUNK * known.prior_std[i]:
            return self._around_prior(i, "prior", known.prior_std[i])
        low, high = value - float(known.interval[i]), value + float(known.interval[i])
        return Label(
            "data", float(known.std[i]), low, high, share=Share.from_parts(known.shares[i])
        )

    def _of_free(self, i: int) -> Label:
        """One that the fit may change.

        Data alone decides where its range without any prior is narrow. Where it is not, but data
        and priors together know the parameter well, torques show only a sum of it and others.
        """
        value, std = float(self._p[i]), float(self._known.std[i])
        prior_std = float(self._known.prior_std[i])
        if not self._visible[i]:
            # Whether it grew beyond the free variables to keep its body consistent.
            alone = self._reduction.A[i] @ self._problem.solution.x + self._reduction.p_0[i]
            raised = value > alone + _ROUNDING * abs(alone)
            return self._around_prior(i, "consistency" if raised else "prior", prior_std)
        unit = np.eye(len(self._p))[i]
        low, high = self._ranges.ends(unit)
        ended, at_edge = np.isfinite(low) and np.isfinite(high), self._at_edge(i)
        around = self._around_prior(i, "prior", prior_std)
        if at_edge and value < _FELL * self._reduction.p_reg[i]:
            low, high = self._parameters[i].low, high if ended else around.high
            return Label("limit", max(high - value, value - low) / NORMAL, low, high)
        enough = _SHRUNK * min(prior_std, float(self._own_std[i]))
        on = self._known.rests_on(i, self._visible & self._free)
        half = 0.5 * (high - low)
        if half < NORMAL * enough or (ended and std < enough and not on):
            share = self._ranges.share(unit, low, high)
            by = "measured" if share.measured > _MOSTLY else "data"
            return Label(by, min(std, half / NORMAL), low, high, share=share)
        if ended and std < enough:
            names = tuple(self._parameters[k].name for k in on)
            return Label("sum", std, low, high, names, self._ranges.share(unit, low, high))
        if ended and at_edge:  # the distance of the far end stands for a standard deviation
            return Label("limit", max(high - value, value - low) / NORMAL, low, high)
        return around

    def _around_prior(self, i: int, by: Origin, std: float) -> Label:
        """The prior's own interval. A moment of inertia, positive and of a size that is known at
        most roughly, is log-normal."""
        prior, std = float(self._reduction.p_reg[i]), max(float(std), float(self._least_std[i]))
        if prior > 0 and self._parameters[i].symbol in MOMENTS_OF_INERTIA:
            factor = float(np.exp(NORMAL * np.sqrt(np.log1p((std / prior) ** 2))))
            return Label(by, std, prior / factor, prior * factor)
        return Label(by, std, prior - NORMAL * std, prior + NORMAL * std)

    def _at_edge(self, i: int) -> bool:
        """Whether consistency alone keeps a moment or a coefficient from being smaller."""
        parts = np.flatnonzero(self._reduction.A[i])
        factors, room = self._reduction.A[i][parts], self._room[parts]
        if np.any(factors < 0) or np.any(np.isnan(room)):
            return False
        return bool(factors @ room < _FELL * (factors @ self._reduction.prior[parts]))

    @cached_property
    def _room(self) -> np.ndarray:
        """How much smaller each variable on the diagonal of a block could be, all else as it is."""
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
