"""How torques of a recording are sampled, as a value: lags, time constants and a clock's rate."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.estimation.problem import LinearProblem
from deltaid.estimation.traces import Delay, Trace
from deltaid.recording.delay import Growth

# Standard deviations of what lags [s], time constants [s] and rates of clocks may be.
_LAG, _CONSTANT, _RATE = 0.01, 0.005, 1e-3

All = Float[np.ndarray, " all"]  # lags, time constants, rate
Covariance = Float[np.ndarray, "all all"]


@dataclass(frozen=True, eq=False)
class Timing:
    """How a recording's torques are sampled.

    Attributes:
        lags: L of each drive [s].
        constants: T of each drive's filter [s]; 0 where there is none.
        rate, about: ρ and t_0 [s]; a rate of 0 where clocks agree.
        covariance: of lags, constants and rate; zero for what is none.
        p: the parameters that go with them.
    """

    lags: Delay
    constants: Delay
    rate: float
    about: float
    covariance: Covariance
    p: Parameters

    @property
    def values(self) -> All:
        return np.concatenate([self.lags, self.constants, [self.rate]])

    @property
    def pure(self) -> bool:
        """Whether filters are all that makes torques late that passed one."""
        filters = self.constants > 0
        return bool(np.all(self.lags[filters] == self.constants[filters]))

    @property
    def of_lags(self) -> Float[np.ndarray, "dof dof"]:
        """Covariance of lags [s²]."""
        return self.covariance[: len(self.lags), : len(self.lags)]

    @property
    def deviation(self) -> Delay:
        """Standard deviations of time constants [s]."""
        return np.sqrt(np.diag(self.covariance)[len(self.lags) : -1])

    def growth(self, trace: Trace) -> Growth | None:
        """Of lags in all of a trace's recording."""
        if not self.rate:
            return None
        ends = [run.time[k] for run in trace.stretches for k in (0, -1)]
        log = trace.recording.log
        reach = max(abs(end - self.about) for end in ends) + log.samples / log.rate
        return Growth(self.rate, self.about, float(reach))

    def beside(self, trace: Trace) -> Trace:
        """A trace as it came with torques beside their motion, the model's filtered as they are."""
        constants = tuple(self.constants.tolist()) if np.any(self.constants) else ()
        trace, delays = replace(trace, constants=constants), self.lags - self.constants
        if not self.rate and not np.any(delays):
            return trace
        return trace.shifted(delays, growth=self.growth(trace))


@dataclass(frozen=True, eq=False)
class Free:
    """What of a timing is estimated.

    Attributes:
        filters: whose torques may have passed a filter.
        clock: whether torques may have a clock of their own.
        pure: whether filters are all that makes torques late, L = T.
    """

    filters: Bool[np.ndarray, " dof"]
    clock: bool
    pure: bool = False

    @property
    def columns(self) -> Bool[np.ndarray, " all"]:
        lags, constants = np.ones(len(self.filters), bool), self.filters & (not self.pure)
        return np.concatenate([lags, constants, [self.clock]])

    @property
    def deviation(self) -> Float[np.ndarray, " free"]:
        dof = len(self.filters)
        return np.repeat([_LAG, _CONSTANT, _RATE], [dof, dof, 1])[self.columns]

    def steps(self, problem: LinearProblem, first: int) -> tuple[All, Covariance]:
        """Steps of all values that a problem has from some column on, and their covariance; zero
        for what is not estimated."""
        own = np.flatnonzero(self.columns)
        places, count = slice(first, first + len(own)), len(self.columns)
        step, covariance = np.zeros(count), np.zeros((count, count))
        step[own] = problem.x[places]
        covariance[np.ix_(own, own)] = problem.covariance(places)
        return step, covariance
