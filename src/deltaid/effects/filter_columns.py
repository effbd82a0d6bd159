"""Filters that torques passed and clocks of their own: what remains of them, as columns of the fit.

Where a torque is late by L and its filter has the time constant T, the recording is read as
τ = y + T ẏ, L − T later. If T is longer by ε and L as it is, the torque that is read changes by
ε T τ̈ below the filter's corner, the column of ε. Where lags grow at the rate ρ, as clocks differ,
what remains of it has the column −(t − t_0) τ̇.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.effects.lag_columns import NORMAL, Column, TimingColumns
from deltaid.effects.lag_groups import common_lag
from deltaid.effects.sampling import Timing
from deltaid.estimation.additions import Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.windows import Samples

_FILTER = (
    "torques passed a first-order filter of this time constant, which is inverted: steps of "
    "friction at reversals have its tails"
)
_PURE = "; it is all that makes them late"
_PPM = 1e6


@dataclass(frozen=True, eq=False)
class UnknownFilter(TimingColumns):
    """Lags that may be those of filters: the fit has delays, and intervals allow for T = L."""

    @property
    def is_held(self) -> bool:
        return True

    @property
    def columns(self) -> Sequence[Column]:
        """By how much a response is wider than that of a delay, T², one a group."""

        def wider(w: Samples, late: Values, rise: Callable[[Values], Values]) -> Values:
            return -0.5 * rise(late)

        names = [f"filter.{'+'.join(group.subjects(self.dynamics))}" for group in self.groups]
        return [
            Column(group.drives, name, "s²", wider, 0.5 * group.delay**2)
            for name, group in zip(names, self.groups, strict=True)
        ]


@dataclass(frozen=True, eq=False, kw_only=True)
class RestOfTiming(TimingColumns):
    """What remains of time constants that are estimated beside lags, and of a clock's rate.

    Attributes:
        timing: what has been corrected.
    """

    timing: Timing

    @property
    def columns(self) -> Sequence[Column]:
        timing, names = self.timing, self.dynamics.robot.drives

        def longer(w: Samples, late: Values, rise: Callable[[Values], Values]) -> Values:
            return -timing.constants[:, None] * rise(late)

        def growing(w: Samples, late: Values, rise: Callable[[Values], Values]) -> Values:
            return (w.time - timing.about) * late

        columns = [
            Column((i,), f"filter.{names[i]}", "s", longer, float(timing.deviation[i]))
            for i in self._filters
        ]
        if timing.rate:
            deviation = float(timing.covariance[-1, -1]) ** 0.5
            columns.append(Column(range(len(names)), "clock", "1", growing, deviation))
        return columns

    @property
    def _filters(self) -> list[int]:
        """Drives whose time constants are not their lags."""
        return [] if self.timing.pure else np.flatnonzero(self.timing.constants).tolist()

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        corrections, names = list(self._pure_filters()), self.dynamics.robot.drives
        for i, rest in zip(self._filters, judged, strict=False):
            T = rest.moved(float(self.timing.constants[i]))
            ends = T.low, T.high
            corrections.append(self.correction("filter", T.value, ends, "s", _FILTER, names[i]))
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
