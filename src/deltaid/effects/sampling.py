"""How torques of a recording are sampled: lags, filters and clocks, and what a fit has of these.

Where a torque is late by L and its filter has the time constant T, the recording is read as
τ = y + T ẏ, L − T later. If T is longer by ε and L as it is, the torque that is read changes by
ε T τ̈ below the filter's corner, the column of ε. Where lags grow at the rate ρ, as clocks differ,
what remains of it has the column −(t − t_0) τ̇.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.lag_columns import NORMAL, TimingColumn, TimingColumns
from deltaid.effects.lag_groups import common_lag
from deltaid.estimation.problem import LinearProblem
from deltaid.estimation.traces import Delay, Trace
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.recording.delay import LagGrowth

# Standard deviations of what lags [s], time constants [s] and rates of clocks may be.
_LAG, _CONSTANT, _RATE = 0.01, 0.005, 1e-3

_FILTER = (
    "torques passed a first-order filter of this time constant, which is inverted: steps of "
    "friction at reversals have its tails"
)
_PURE = "; it is all that makes them late"
# Rates of clocks are reported in parts per million.
_PPM = 1e6

All = Float[np.ndarray, " all"]  # lags, time constants, rate
Covariance = Float[np.ndarray, "all all"]


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


@dataclass(frozen=True, eq=False)
class UnknownFilter(TimingColumns):
    """Lags that may be those of filters: the fit has delays, and intervals allow for T = L."""

    is_held = True

    @property
    def columns(self) -> Sequence[TimingColumn]:
        """By how much a response is wider than that of a delay, T², one a group."""

        return [
            TimingColumn(
                group.drives,
                f"filter.{'+'.join(group.subjects(self.dynamics))}",
                "s²",
                lambda w, late, rise: -0.5 * rise(late),
                0.5 * group.delay**2,
            )
            for group in self.groups
        ]


@dataclass(frozen=True, eq=False, kw_only=True)
class RestOfTiming(TimingColumns):
    """What remains of time constants that are estimated beside lags, and of a clock's rate."""

    timing: Timing  # what has been corrected

    @property
    def columns(self) -> Sequence[TimingColumn]:
        timing, names = self.timing, self.dynamics.robot.drives
        columns = [
            TimingColumn(
                (i,),
                f"filter.{names[i]}",
                "s",
                lambda w, late, rise: -timing.constants[:, None] * rise(late),
                float(timing.deviation[i]),
            )
            for i in self._filters
        ]
        if timing.rate:
            columns.append(
                TimingColumn(
                    range(len(names)),
                    "clock",
                    "1",
                    lambda w, late, rise: (w.time - timing.about) * late,
                    float(timing.covariance[-1, -1]) ** 0.5,
                )
            )
        return columns

    @property
    def _filters(self) -> list[int]:
        return [] if self.timing.pure else np.flatnonzero(self.timing.constants).tolist()

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        corrections, names = list(self._pure_filters()), self.dynamics.robot.drives
        for i, rest in zip(self._filters, judged, strict=False):
            T = rest.moved(float(self.timing.constants[i]))
            corrections.append(
                self.correction("filter", T.value, (T.low, T.high), "s", _FILTER, names[i])
            )
        if rate := self.timing.rate:
            clock = judged[-1].moved(rate)
            low, high = (None if end is None else _PPM * end for end in (clock.low, clock.high))
            text = (
                f"the clock of torques runs {'slow' if rate > 0 else 'fast'} against that of "
                "positions, so their lag grows: torques are read so much later or earlier as time "
                "goes on"
            )
            corrections.append(
                self.correction("clock", _PPM * clock.value, (low, high), "ppm", text)
            )
        return tuple(corrections)

    def _pure_filters(self) -> Iterator[Correction]:
        """Of groups whose lag is the time constant of their filters."""
        lags, names = self.timing.lags, self.dynamics.robot.drives
        for group in self.groups if self.timing.pure else ():
            drives = [i for i in group.drives if self.timing.constants[i] > 0]
            if not drives:
                continue
            value, deviation = common_lag(lags[drives], self.timing.of_lags[np.ix_(drives, drives)])
            ends = value - NORMAL * deviation, value + NORMAL * deviation
            every = len(drives) == len(group.drives)
            for name in group.subjects(self.dynamics) if every else [names[i] for i in drives]:
                yield self.correction("filter", value, ends, "s", _FILTER + _PURE, name)
