"""Filters that torques passed and clocks of their own: what remains of them, as columns of the fit.

Where a torque is late by L and its filter has the time constant T, the recording is read as
τ = y + T ẏ, L − T later. If T is longer by ε and L as it is, the torque that is read changes by
ε T τ̈ below the filter's corner, the column of ε. Where lags grow at the rate ρ, as clocks differ,
what remains of it has the column −(t − t_0) τ̇.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.effects.lag_columns import NORMAL, TimingColumns, ends_of
from deltaid.effects.lag_groups import common_lag
from deltaid.effects.sampling import Timing
from deltaid.estimation.additions import Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter

_FILTER = (
    "torques passed a first-order filter of this time constant, which is inverted: steps of "
    "friction at reversals have its tails"
)
_PURE = "; it is all that makes them late"
_PPM = 1e6


@dataclass(frozen=True, eq=False, kw_only=True)
class FilterColumns(TimingColumns):
    """Time constants of one recording's filters, one a drive, beside what has been corrected."""

    timing: Timing

    @property
    def drives(self) -> Sequence[Sequence[int]]:
        """Of filters that are estimated beside lags."""
        filters = np.flatnonzero(self.timing.constants).tolist()
        return [] if self.timing.pure else [(i,) for i in filters]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        names, deviations = self.dynamics.robot.drives, self.timing.deviation
        return tuple(
            self.parameter(f"filter.{names[i]}", "s", 0.0, float(deviations[i]))
            for (i,) in self.drives
        )

    def changes(self, w: Samples, late: Values, rise: Callable[[Values], Values]) -> Values:
        """T τ̈."""
        return -self.timing.constants[:, None] * rise(late)

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        corrections, names = list[Correction](), self.dynamics.robot.drives
        lags, constants = self.timing.lags, self.timing.constants
        for group in self.groups if self.timing.pure else ():
            drives = [i for i in group.drives if constants[i] > 0]
            if not drives:
                continue
            value, deviation = common_lag(lags[drives], self.timing.of_lags[np.ix_(drives, drives)])
            ends = value - NORMAL * deviation, value + NORMAL * deviation
            subjects = group.subjects(self.dynamics)
            subjects = subjects if len(drives) == len(group.drives) else [names[i] for i in drives]
            text = _FILTER + _PURE
            corrections += (self.correction("filter", value, ends, "s", text, s) for s in subjects)
        for (i,), rest in zip(self.drives, judged, strict=True):
            value, ends = float(constants[i]) + rest.value, ends_of(float(constants[i]), rest)
            corrections.append(self.correction("filter", value, ends, "s", _FILTER, names[i]))
        return tuple(corrections)


@dataclass(frozen=True, eq=False, kw_only=True)
class ClockColumn(TimingColumns):
    """The rate by which all lags of one recording grow, beside what has been corrected."""

    timing: Timing

    @property
    def drives(self) -> Sequence[Sequence[int]]:
        return [range(self.dynamics.dof)]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        deviation = float(self.timing.covariance[-1, -1]) ** 0.5
        return (self.parameter("clock", "1", 0.0, deviation),)

    def changes(self, w: Samples, late: Values, rise: Callable[[Values], Values]) -> Values:
        """−(t − t_0) τ̇."""
        return (w.time - self.timing.about) * late

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        (rest,), rate = judged, self.timing.rate
        low, high = (None if end is None else _PPM * end for end in ends_of(rate, rest))
        text = (
            f"the clock of torques runs {'slow' if rate > 0 else 'fast'} against that of "
            "positions, so their lag grows: torques are read so much later or earlier as time "
            "goes on"
        )
        return (self.correction("clock", _PPM * (rate + rest.value), (low, high), "ppm", text),)
