"""Lags of torque channels as columns of the regression.

A torque that is recorded δ later than its motion, τ_meas(t) = τ(t − δ), is to first order

    τ_meas,i = Y_i p − δ τ̇_i,

so a lag is one more free coefficient whose column is −τ̇. This is the slope of the *model's* torque:
noise on a measured one would pull δ towards zero. A first-order filter of time constant T has the
same first-order term, so the estimate is the sum of dead time and time constants. `lags` estimates
them, `Trace.shifted` applies them exactly.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.effects.lag_groups import LagGroup
from deltaid.estimation.additions import Addition, Own, Values, extended, torques_of
from deltaid.estimation.drive_rows import OfDrives
from deltaid.estimation.traces import Trace
from deltaid.model.corrections import Correction, Kind
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import PRIOR_SPREAD, Parameter

# What a lag may be about the one that has been applied already: a standard deviation of half [s].
_SIZE = 0.02
_UNSURE = "; a first-order filter of this time constant would look the same here"
# Lags that differ by more [s] are reported to do so.
_APART = 3e-4
# Half a 95 % interval in standard deviations.
NORMAL = 1.96

Ends = tuple[float | None, float | None]


@dataclass(frozen=True, eq=False)
class TimingColumns(Addition):
    """How the torques of one recording are sampled, as columns of derivatives of the model's.

    Attributes:
        dynamics, beside: the robot and the additions whose torques these are.
        p: the parameters of both, in their order.
        recording: which is sampled so.
        groups: drives that are; others are not.
        several: whether the fit has other recordings.
    """

    dynamics: Dynamics
    beside: tuple[Addition, ...]
    p: Parameters
    recording: Recording
    groups: tuple[LagGroup, ...]
    several: bool = False

    @property
    @abstractmethod
    def drives(self) -> Sequence[Sequence[int]]:
        """The drives of each column."""

    @abstractmethod
    def changes(self, w: Samples, late: Values, rise: Callable[[Values], Values]) -> Values:
        """Of every drive's torque, for a coefficient of 1, by −τ̇ and what gives x its rate ẋ."""

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        entries = [(drive, k) for k, drives in enumerate(self.drives) for drive in drives]
        drives, columns = np.array(entries, dtype=int).reshape(-1, 2).T
        return drives, columns

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        drives, _ = self.pattern
        if not self.is_of(recording):
            return np.zeros((len(drives), own.shape[1]))
        turned = self.reversals(own)

        def rise(x: Values) -> Values:
            return recording.log.rate * slope(x, turned)

        return self.changes(w, -rise(self.torques(w, own, recording)), rise)[drives]

    def is_of(self, recording: Recording) -> bool:
        return recording.log.sha256 == self.recording.log.sha256

    def torques(self, w: Samples, own: Own, recording: Recording) -> Values:
        """τ of each drive, with that of loads, which lags with all else."""
        values = np.vstack([own, *(term.entries(w, own, recording) for term in self.beside)])
        return w.carried.T + torques_of(self._columns, self.dynamics.dof, values, self.p)

    @cached_property
    def _columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Drive and parameter of every entry of torques."""
        return extended(self.dynamics, self.beside).regressor_pattern

    def reversals(self, own: Own) -> Bool[np.ndarray, "dof steps"]:
        """Whether a joint with friction turns round between a sample and the next, in whose row."""
        layout, (rows, columns) = self.dynamics.layout, self.dynamics.regressor_pattern
        viscous = np.isin(columns, np.arange(len(layout.names))[layout.viscous])
        turned = np.zeros((self.dynamics.dof, own.shape[1] - 1), dtype=bool)
        np.logical_or.at(turned, rows[viscous], own[viscous, :-1] * own[viscous, 1:] < 0)
        return turned

    def parameter(self, owner: str, unit: str, mean: float, deviation: float) -> Parameter:
        """A coefficient, named with the recording where there are several."""
        name = owner + (f"@{self.recording.path}" if self.several else "")
        scale = deviation / PRIOR_SPREAD
        return Parameter("lag", name, "lag", unit, -np.inf, np.inf, mean, scale)

    def correction(
        self, kind: Kind, value: float, ends: Ends, unit: str, text: str, subject: str = ""
    ) -> Correction:
        low, high = ends
        return Correction(kind=kind, subject=subject, log=self.recording.path.name, value=value,
                          low=low, high=high, unit=unit, text=text)  # fmt: skip


@dataclass(frozen=True, eq=False)
class LagColumns(TimingColumns):
    """The lags of one recording's torques, each of one drive or of several that have the same.

    Attributes:
        unsure: drives whose lag may be that of a filter as well as a delay.
    """

    unsure: tuple[int, ...] = ()

    @property
    def drives(self) -> Sequence[Sequence[int]]:
        return [group.drives for group in self.groups if group.free]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One lag a group that is free."""
        names = ("+".join(group.subjects(self.dynamics)) for group in self.groups)
        return tuple(
            self.parameter(
                name or "torques", "s", group.beside, min(group.deviation, PRIOR_SPREAD * _SIZE)
            )
            for name, group in zip(names, self.groups, strict=True)
            if group.free
        )

    def changes(self, w: Samples, late: Values, rise: Callable[[Values], Values]) -> Values:
        return late

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        """What has been applied plus what the fit adds to it."""
        delays, values = [group.delay for group in self.groups], iter(judged)
        corrections, spread = list[Correction](), max(delays) - min(delays)
        for group in self.groups:
            half, remaining = NORMAL * group.deviation, group.beside
            ends: Ends = (group.delay + remaining - half, group.delay + remaining + half)
            if group.free:
                fitted = next(values)
                remaining, ends = fitted.value, ends_of(group.delay, fitted)
            text = _sentence(group.delay + remaining, spread, held=not group.free)
            text += _UNSURE * bool(set(group.drives) & set(self.unsure))
            corrections += (
                self.correction("lag", group.delay + remaining, ends, "s", text, subject)
                for subject in group.subjects(self.dynamics)
            )
        return tuple(corrections)


@dataclass(frozen=True, eq=False)
class UnknownLag(LagColumns):
    """A lag that may be none and is hardly known: the fit has none, and intervals allow for it."""

    @property
    def is_held(self) -> bool:
        return True

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        """Nothing has been corrected."""
        return ()


@dataclass(frozen=True, eq=False)
class UnknownFilter(TimingColumns):
    """Lags that may be those of filters: the fit has delays, and intervals allow for T = L."""

    @property
    def is_held(self) -> bool:
        return True

    @property
    def drives(self) -> Sequence[Sequence[int]]:
        return [group.drives for group in self.groups]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """By how much a response is wider than that of a delay, T², one a group."""
        names = ("+".join(group.subjects(self.dynamics)) for group in self.groups)
        return tuple(
            self.parameter(f"filter.{name}", "s²", 0.0, 0.5 * group.delay**2)
            for name, group in zip(names, self.groups, strict=True)
        )

    def changes(self, w: Samples, late: Values, rise: Callable[[Values], Values]) -> Values:
        """½ τ̈."""
        return -0.5 * rise(late)


def slopes(trace: Trace, p: Parameters, additions: Sequence[Addition] = ()) -> OfDrives:
    """−τ̇ of the torques of p, filtered: by what a drive's torque changes for each second that it
    comes late; p of the robot, then of additions."""
    return timing_slopes(trace, p, additions, 0.0)[0]


def timing_slopes(
    trace: Trace, p: Parameters, additions: Sequence[Addition], about: float
) -> tuple[OfDrives, OfDrives, OfDrives]:
    """By what a drive's torque of p changes, filtered, for each second that it comes late, each
    second that its filter's time constant is longer and its dead time shorter, and each second
    that it comes later a second, t_0 = `about`:

        −ẏ,    d(y − y′)/dt,    −(t − t_0) ẏ,

    y the torque behind the filter that the trace has, y′ that behind it twice."""
    drives, rate = np.arange(trace.dynamics.dof), trace.low_pass.rate
    by_p = replace(trace, load=p[: len(trace.dynamics.layout.names)])
    columns = LagColumns(trace.dynamics, tuple(additions), p, trace.recording, ())
    sharp = ~np.array(trace.constants or np.zeros(len(drives)), dtype=bool)

    def derivatives(w: Samples) -> Values:
        own = by_p.entries(w)
        once = trace.behind(columns.torques(w, own, trace.recording), drives)
        twice = trace.behind(once.copy(), drives)
        late = -rate * slope(once, columns.reversals(own) & sharp[:, None])
        return np.vstack([late, rate * slope(once - twice), (w.time - about) * late])

    late, longer, growing = np.split(
        trace.filtered(derivatives, np.tile(drives, 3), trace.settling), 3
    )
    return late, longer, growing


def slope(tau: OfDrives, turned: Bool[np.ndarray, "dof steps"] | bool = False) -> OfDrives:
    """The rise of torques from sample to sample, without the steps of friction.

    Central differences; next to a reversal the difference of the side without a step.

    Args:
        tau: at least two samples.
        turned: between which samples and the next a joint turns round.
    """
    steps = np.diff(tau, axis=1)
    total, number = (
        np.pad(values, ((0, 0), (0, 1))) + np.pad(values, ((0, 0), (1, 0)))
        for values in (np.where(turned, 0.0, steps), np.where(turned, 0.0, np.ones_like(steps)))
    )
    return total / np.maximum(number, 1.0)


def ends_of(applied: float, rest: Judged) -> Ends:
    """The interval of what has been applied and what a fit adds to it."""
    low, high = (None if end is None else applied + end for end in (rest.low, rest.high))
    return low, high


def _sentence(value: float, spread: float, *, held: bool) -> str:
    late, later = ("late", "later") if value > 0 else ("early", "earlier")
    text = (
        f"torques come {late} against positions, drive filters counted in, and are read so much "
        f"{later}"
    )
    if held:
        return (
            f"{text}; only steps of friction tell it, other rows want another lag: friction law, "
            "load or torque constants are in doubt"
        )
    return f"{text}; drives differ by {1e3 * spread:.2g} ms" if spread > _APART else text
