"""Which drives have the same lag, or none, by Hotelling's T² of their estimates.

Drives have as few lags as their estimates allow: none, if that is not contradicted, then one that
all or some of them have, then more. A hypothesis is a matrix S, δ = S ε, that defines whose lags
are equal and whose are zero; ε by generalised least squares. Covariances come from the scatter
between stretches.

How torques of a recording are sampled, lags, filters and a clock, is its timing. Where a torque is
late by L behind a filter of time constant T, the recording is read as τ = y + T ẏ, L − T later."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import fdtri

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.drive_rows import STRETCHES
from deltaid.estimation.problem import LinearProblem
from deltaid.estimation.scatter import CHANCE
from deltaid.estimation.traces import Delay, Trace
from deltaid.levels import UNLIKELY
from deltaid.recording.delay import LagGrowth

# How often what is zero is taken to be so by chance only.
_PROBABLE = 0.2
# Lags [s] that need not be corrected; and that hardly matter, where twice as much does harm. Good
# recordings of 15 s determine a lag to 5–20 µs, those of a few seconds to 0.1 ms.
HARMLESS, SMALL = 2e-5, 1.5e-4
# Drives beyond which only common lags and lags of single drives are distinguished.
_MANY = 6
# Standard deviations of what lags [s], time constants [s] and rates of clocks may be.
LAG, _CONSTANT, _RATE = 0.01, 0.005, 1e-3

Estimates = Float[np.ndarray, " n"]
Covariance = Float[np.ndarray, "n n"]
Hypothesis = Float[np.ndarray, "n groups"]
All = Float[np.ndarray, " all"]  # lags, time constants, rate


@dataclass(frozen=True)
class LagGroup:
    """Drives that have the same lag."""

    drives: tuple[int, ...]  # their numbers
    delay: float  # what has been corrected already [s]
    beside: float = 0.0  # the further lag by rows that no fit has [s]
    deviation: float = np.inf  # its standard deviation; infinite if nothing is known [s]
    # whether the fit may change it; where other rows contradict what is known, it may not
    free: bool = True

    def subjects(self, dynamics: Dynamics) -> tuple[str, ...]:
        """Names of these drives; one that is empty for all of the robot's."""
        names = dynamics.robot.drives
        return ("",) if len(self.drives) == len(names) else tuple(names[i] for i in self.drives)


def alone(dof: int) -> tuple[LagGroup, ...]:
    """A lag for every drive, of which nothing is known."""
    return tuple(LagGroup((i,), 0.0) for i in range(dof))


def chosen_groups(values: Estimates, covariance: Covariance) -> tuple[LagGroup, ...]:
    """The simplest hypothesis on lags [s] that their estimates do not contradict.

    Of several that are as simple, the one with fewer drives without a lag is taken, then the one
    that is contradicted least: a drive that hardly moves has the lag of the others.
    """
    dof = len(values)
    _, together = _fitted(values, covariance, np.ones((dof, 1)))
    for (count, _), hypotheses in groupby(_hypotheses(dof), key=_complexity):
        candidates = list[tuple[float, tuple[int, ...], Estimates]]()
        for labels in hypotheses:
            S = np.equal.outer(labels, np.arange(1, count + 1)).astype(float)
            delay, distance = _fitted(values, covariance, S)
            harmless = np.abs(values - delay).max() < HARMLESS
            if harmless or not _contradicted(labels, distance, together):
                candidates.append((distance, labels, delay))
        if candidates:
            _, labels, delay = min(candidates, key=lambda candidate: candidate[0])
            members = [np.flatnonzero(np.equal(labels, k + 1)).tolist() for k in range(count)]
            return tuple(LagGroup(tuple(drives), float(delay[drives[0]])) for drives in members)
    raise AssertionError  # a lag for every drive is never contradicted


def delays_of(groups: Sequence[LagGroup], dof: int) -> tuple[float, ...]:
    """What has been corrected of each drive [s]."""
    delays = {drive: group.delay for group in groups for drive in group.drives}
    return tuple(delays.get(drive, 0.0) for drive in range(dof))


def agree(values: Estimates, covariance: Covariance) -> bool:
    """Whether estimates do not contradict that all are of the same size."""
    _, distance = _fitted(values, covariance, np.ones((len(values), 1)))
    return distance <= limit(len(values) - 1, UNLIKELY)


def exceeded(values: Estimates, covariance: Covariance, rejected: float) -> bool:
    """Whether zero is rejected for estimates, wrongly in this share of cases."""
    if not np.all(np.diag(covariance) > 0):
        return False
    _, distance = _fitted(values, covariance, np.zeros((len(values), 0)))
    return distance > limit(len(values), rejected)


def limit(free: int, rejected: float) -> float:
    """What T² with so many directions exceeds by chance in this share of cases."""
    nu = STRETCHES - 1
    return free * nu / (nu - free + 1) * float(fdtri(free, nu - free + 1, 1 - rejected))


def common_lag(values: Estimates, covariance: Covariance) -> tuple[float, float]:
    """The lag that all drives have by generalised least squares, (1ᵀC⁻¹δ)/(1ᵀC⁻¹1), and its
    standard deviation [s]."""
    b, A = _whitened(values, covariance, np.ones((len(values), 1)))
    size = float(np.sum(A**2))
    return float(A[:, 0] @ b) / size, size**-0.5


def _whitened(
    values: Estimates, covariance: Covariance, S: Hypothesis
) -> tuple[Estimates, Hypothesis]:
    """Estimates, and the columns of a hypothesis, in units in which estimates err as 1."""
    scale = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(scale, scale))
    white = np.linalg.solve(root, np.column_stack([values, S]) / scale[:, None])
    return white[:, 0], white[:, 1:]


def _fitted(values: Estimates, covariance: Covariance, S: Hypothesis) -> tuple[Estimates, float]:
    """S ε by generalised least squares, and T² of what it leaves."""
    b, A = _whitened(values, covariance, S)
    free = np.linalg.lstsq(A, b, rcond=None)[0]
    return S @ free, float(np.sum((b - A @ free) ** 2))


def _contradicted(labels: tuple[int, ...], distance: float, together: float) -> bool:
    """Whether T² rejects a hypothesis, by what it leaves and what one lag for all leaves."""
    free = len(labels) - max(labels)
    if not any(labels):
        common = distance - together > limit(1, 0.5 * CHANCE)
        return common or distance > limit(free, 0.5 * CHANCE)
    share = CHANCE if len(set(labels)) == 1 else _PROBABLE
    return free > 0 and distance > limit(free, share)


def _hypotheses(dof: int) -> list[tuple[int, ...]]:
    """For each drive 0, no lag, or the number of its group; the simplest first."""
    if dof > _MANY:
        return [(0,) * dof, (1,) * dof, tuple(range(1, dof + 1))]
    labels: list[tuple[int, ...]] = [()]
    for _ in range(dof):
        labels = [(*head, k) for head in labels for k in range(max(head, default=0) + 2)]
    return sorted(labels, key=_complexity)


def _complexity(labels: tuple[int, ...]) -> tuple[int, int]:
    """How many lags there are, and how many drives have none."""
    return max(labels), labels.count(0)


@dataclass(frozen=True, eq=False)
class Timing:
    """How a recording's torques are sampled."""

    lags: Delay  # L of each drive [s]
    constants: Delay  # T of each drive's filter [s]; 0 where there is none
    # rate, about: ρ and t_0 [s]; a rate of 0 where clocks agree
    rate: float
    about: float
    covariance: Covariance  # of lags, constants and rate; zero for what is none
    p: Parameters  # the parameters that go with them

    @property
    def values(self) -> All:
        return np.concatenate([self.lags, self.constants, [self.rate]])

    @property
    def pure(self) -> bool:
        """Whether filters are all that makes torques late that passed one."""
        filters = self.constants > 0
        return bool(np.all(self.lags[filters] == self.constants[filters]))

    @property
    def filters(self) -> list[int]:
        """Drives whose time constants are not their lags."""
        return [] if self.pure else np.flatnonzero(self.constants).tolist()

    @property
    def of_lags(self) -> Float[np.ndarray, "dof dof"]:
        return self.covariance[: len(self.lags), : len(self.lags)]

    @property
    def deviation(self) -> Delay:
        return np.sqrt(np.diag(self.covariance)[len(self.lags) : -1])

    def growth(self, trace: Trace) -> LagGrowth | None:
        if not self.rate:
            return None
        ends = [run.time[k] for run in trace.stretches for k in (0, -1)]
        log = trace.recording.log
        reach = max(abs(end - self.about) for end in ends) + log.samples / log.rate
        return LagGrowth(self.rate, self.about, float(reach))

    def beside(self, trace: Trace) -> Trace:
        """A trace as it came with torques beside their motion, the model's filtered as they are."""
        constants = tuple(self.constants.tolist()) if np.any(self.constants) else ()
        trace, delays = replace(trace, constants=constants), self.lags - self.constants
        if not self.rate and not np.any(delays):
            return trace
        return trace.shifted(delays, growth=self.growth(trace))


@dataclass(frozen=True, eq=False)
class FreeTiming:
    """What of a timing is estimated."""

    filters: Bool[np.ndarray, " dof"]  # whose torques may have passed a filter
    clock: bool  # whether torques may have a clock of their own
    pure: bool = False  # whether filters are all that makes torques late, L = T

    @property
    def columns(self) -> Bool[np.ndarray, " all"]:
        lags, constants = np.ones(len(self.filters), bool), self.filters & (not self.pure)
        return np.concatenate([lags, constants, [self.clock]])

    @property
    def deviation(self) -> Float[np.ndarray, " free"]:
        dof = len(self.filters)
        return np.repeat([LAG, _CONSTANT, _RATE], [dof, dof, 1])[self.columns]

    def steps(self, problem: LinearProblem, first: int) -> tuple[All, Covariance]:
        """Steps of all values that a problem has from some column on, and their covariance; zero
        for what is not estimated."""
        own = np.flatnonzero(self.columns)
        places, count = slice(first, first + len(own)), len(self.columns)
        step, covariance = np.zeros(count), np.zeros((count, count))
        step[own] = problem.x[places]
        covariance[np.ix_(own, own)] = problem.covariance(places)
        return step, covariance
