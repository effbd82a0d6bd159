"""Which drives have the same lag, or none, by Hotelling's T² of their estimates.

Drives have as few different lags as their estimates allow: none, then one for all or some drives,
then more. A hypothesis is a matrix S in δ = S ε, which defines whose lags are equal and whose are
zero; ε follows by generalised least squares, covariances from the scatter between stretches.

The lags, filters and clock of a recording's torques are its timing. Where a torque y is late by L
behind a filter of time constant T, the recording is read as τ = y + T ẏ, L − T later."""

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

# Probability of rejecting a true hypothesis that some lags are equal or zero.
_PROBABLE = 0.2
# Lags [s] that need no correction; and that hardly matter, while twice as much does harm. Good
# recordings of 15 s determine a lag to 5–20 µs, those of a few seconds to 0.1 ms.
HARMLESS, SMALL = 2e-5, 1.5e-4
# Number of drives up to which all hypotheses are tried: 7 drives have 1095.
_MANY = 6
# Prior standard deviations of lags [s], time constants [s] and rates of clocks.
LAG, _CONSTANT, _RATE = 0.01, 0.005, 1e-3

Estimates = Float[np.ndarray, " n"]
Covariance = Float[np.ndarray, "n n"]
Hypothesis = Float[np.ndarray, "n groups"]
All = Float[np.ndarray, " all"]  # lags, time constants, rate


@dataclass(frozen=True)
class LagGroup:
    """Drives that have the same lag."""

    drives: tuple[int, ...]  # their numbers
    delay: float  # lag that has been corrected already [s]
    remaining_lag: float = 0.0  # additional lag that reversals, which no fit has, determine [s]
    deviation: float = np.inf  # its standard deviation; infinite if nothing is known [s]
    free: bool = True  # whether the fit may change it; not where other rows contradict reversals

    def subjects(self, dynamics: Dynamics) -> tuple[str, ...]:
        """Names of these drives; one empty name for all of the robot's."""
        names = dynamics.robot.drives
        return ("",) if len(self.drives) == len(names) else tuple(names[i] for i in self.drives)


def alone(dof: int) -> tuple[LagGroup, ...]:
    """One unknown lag for every drive."""
    return tuple(LagGroup((i,), 0.0) for i in range(dof))


def chosen_groups(values: Estimates, covariance: Covariance) -> tuple[LagGroup, ...]:
    """The simplest hypothesis on lags [s] that their estimates do not contradict.

    Of equally simple ones, that with the fewest drives without a lag, then that with the least T²:
    a drive that hardly moves gets the lag of the others.
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
    """The lag of each drive that has been corrected [s]."""
    delays = {drive: group.delay for group in groups for drive in group.drives}
    return tuple(delays.get(drive, 0.0) for drive in range(dof))


def agree(values: Estimates, covariance: Covariance) -> bool:
    """Whether estimates do not contradict that all are equal."""
    _, distance = _fitted(values, covariance, np.ones((len(values), 1)))
    return distance <= limit(len(values) - 1, UNLIKELY)


def exceeded(values: Estimates, covariance: Covariance, rejected: float) -> bool:
    """Whether T² rejects that all estimates are zero, at this error probability."""
    if not np.all(np.diag(covariance) > 0):
        return False
    _, distance = _fitted(values, covariance, np.zeros((len(values), 0)))
    return distance > limit(len(values), rejected)


def limit(free: int, rejected: float) -> float:
    """The bound that T² of so many degrees of freedom exceeds by chance with this probability."""
    nu = STRETCHES - 1
    return free * nu / (nu - free + 1) * float(fdtri(free, nu - free + 1, 1 - rejected))


def common_lag(values: Estimates, covariance: Covariance) -> tuple[float, float]:
    """The common lag by generalised least squares, (1ᵀC⁻¹δ)/(1ᵀC⁻¹1), and its standard deviation
    [s]."""
    b, A = _whitened(values, covariance, np.ones((len(values), 1)))
    size = float(np.sum(A**2))
    return float(A[:, 0] @ b) / size, size**-0.5


def _whitened(
    values: Estimates, covariance: Covariance, S: Hypothesis
) -> tuple[Estimates, Hypothesis]:
    """Estimates and the columns of a hypothesis, scaled so that errors are independent and of
    variance 1."""
    scale = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(scale, scale))
    white = np.linalg.solve(root, np.column_stack([values, S]) / scale[:, None])
    return white[:, 0], white[:, 1:]


def _fitted(values: Estimates, covariance: Covariance, S: Hypothesis) -> tuple[Estimates, float]:
    """S ε by generalised least squares, and T² of the residual."""
    b, A = _whitened(values, covariance, S)
    free = np.linalg.lstsq(A, b, rcond=None)[0]
    return S @ free, float(np.sum((b - A @ free) ** 2))


def _contradicted(labels: tuple[int, ...], distance: float, together: float) -> bool:
    """Whether a hypothesis is rejected by its T², `distance`; `together` is that of one common
    lag."""
    free = len(labels) - max(labels)
    if not any(labels):
        common = distance - together > limit(1, 0.5 * CHANCE)
        return common or distance > limit(free, 0.5 * CHANCE)
    share = CHANCE if len(set(labels)) == 1 else _PROBABLE
    return free > 0 and distance > limit(free, share)


def _hypotheses(dof: int) -> list[tuple[int, ...]]:
    """For each drive the number of its group, or 0 for no lag; the simplest first.

    Drives of one make share a lag, or two. Where there are more, each drive has its own, and lags
    that agree do so by chance.
    """
    own = tuple(range(1, dof + 1))
    if dof > _MANY:
        return [(0,) * dof, (1,) * dof, own]
    labels: list[tuple[int, ...]] = [()]
    for _ in range(dof):
        labels = [(*head, k) for head in labels for k in range(min(max(head, default=0) + 2, 3))]
    return sorted([*labels, own] if dof > 2 else labels, key=_complexity)


def _complexity(labels: tuple[int, ...]) -> tuple[int, int]:
    """Number of different lags, and of drives without one."""
    return max(labels), labels.count(0)


@dataclass(frozen=True, eq=False)
class Timing:
    """How a recording's torques are sampled."""

    lags: Delay  # L of each drive [s]
    constants: Delay  # T of each drive's filter [s]; 0 without a filter
    rate: float  # ρ; 0 where clocks agree
    about: float  # t_0 [s]
    covariance: Covariance  # of lags, constants and rate; zero where these are not estimated
    p: Parameters  # fitted with these

    @property
    def values(self) -> All:
        return np.concatenate([self.lags, self.constants, [self.rate]])

    @property
    def pure(self) -> bool:
        """Whether filtered torques have no dead time beside: L = T."""
        filters = self.constants > 0
        return bool(np.all(self.lags[filters] == self.constants[filters]))

    @property
    def filters(self) -> list[int]:
        """Drives with a filter whose time constant is estimated beside the lag."""
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

    def corrected(self, trace: Trace) -> Trace:
        """A trace with lags corrected, and the model's torques filtered like the recorded ones."""
        constants = tuple(self.constants.tolist()) if np.any(self.constants) else ()
        trace, delays = replace(trace, constants=constants), self.lags - self.constants
        if not self.rate and not np.any(delays):
            return trace
        return trace.shifted(delays, growth=self.growth(trace))


@dataclass(frozen=True, eq=False)
class FreeTiming:
    """Which parts of a timing are estimated."""

    filters: Bool[np.ndarray, " dof"]  # drives whose torques may have passed a filter
    clock: bool  # whether torques may have another clock than positions
    pure: bool = False  # whether filters have no dead time beside: L = T

    @property
    def columns(self) -> Bool[np.ndarray, " all"]:
        lags, constants = np.ones(len(self.filters), bool), self.filters & (not self.pure)
        return np.concatenate([lags, constants, [self.clock]])

    @property
    def deviation(self) -> Float[np.ndarray, " free"]:
        dof = len(self.filters)
        return np.repeat([LAG, _CONSTANT, _RATE], [dof, dof, 1])[self.columns]

    def steps(self, problem: LinearProblem, first: int) -> tuple[All, Covariance]:
        """Steps of all values and their covariance, by the columns of a problem from `first` on;
        zero where a value is not estimated."""
        own = np.flatnonzero(self.columns)
        places, count = slice(first, first + len(own)), len(self.columns)
        step, covariance = np.zeros(count), np.zeros((count, count))
        step[own] = problem.x[places]
        covariance[np.ix_(own, own)] = problem.covariance(places)
        return step, covariance
