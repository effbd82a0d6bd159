"""Lags of torque channels as columns of the regression.

A torque that is recorded δ later than its motion, τ_meas(t) = τ(t − δ), is to first order

    τ_meas,i = Y_i p − δ τ̇_i,

so a lag is one more free coefficient whose column is −τ̇. This is the slope of the *model's* torque:
noise on a measured one would pull δ towards zero. A first-order filter of time constant T has the
same first-order term, so the estimate is the sum of dead time and time constants. `lags` estimates
them, `Trace.shifted` applies them exactly."""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.lag_groups import LAG, SMALL, LagGroup, Timing, common_lag
from deltaid.estimation.additions import Addition, Own, TorqueColumns, Values
from deltaid.estimation.drive_rows import ColumnsOfDrives, OfDrives, of_own_drives
from deltaid.estimation.scatter import NORMAL
from deltaid.estimation.traces import Trace
from deltaid.model.corrections import Correction, Kind
from deltaid.model.parameter_record import Parameter
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.parameter import PRIOR_SPREAD, PriorParameter

_UNSURE = "; a first-order filter of this time constant would look the same here"
_FILTER = (
    "torque passed a first-order filter of this time constant, which is inverted: steps of "
    "friction at reversals show its tail"
)
_PURE = "; it accounts for the whole lag"
_BLURRED = (
    "; steps of friction at reversals are blurred, as by averages or a second-order filter, so "
    "rows next to reversals are excluded"
)
# Lags that differ by more [s] do harm, and are reported to differ.
APART = 2.0 * SMALL

Ends = tuple[float | None, float | None]
# Change of the torques per unit of a coefficient, by samples, −τ̇ of every drive, and d/dt.
Change = Callable[[SampleBlock, Values, Callable[[Values], Values]], Values]


class TimingColumn(NamedTuple):
    """A coefficient of the torques of some drives: its owner, unit, standard deviation and mean."""

    drives: Sequence[int]
    owner: str
    unit: str
    change: Change
    deviation: float
    mean: float = 0.0


@dataclass(frozen=True, eq=False)
class TimingColumns(TorqueColumns):
    """How the torques of one recording are sampled, as columns of derivatives of the model's."""

    recording: PreparedRecording
    groups: tuple[LagGroup, ...]  # drives with a lag
    several: bool = False  # whether the fit has other recordings

    @property
    @abstractmethod
    def columns(self) -> Sequence[TimingColumn]:
        """Unknown coefficients of the sampling."""

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        """One a column, with the recording in its name where there are several."""
        of_recording = f"@{self.recording.path}" if self.several else ""
        return tuple(
            PriorParameter("lag", column.owner + of_recording, "lag", column.unit, -np.inf, np.inf,
                      column.mean, column.deviation / PRIOR_SPREAD)
            for column in self.columns
        )  # fmt: skip

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        entries = [(i, k) for k, column in enumerate(self.columns) for i in column.drives]
        drives, columns = np.array(entries, dtype=int).reshape(-1, 2).T
        return drives, columns

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        if not self.is_of(recording):
            return np.zeros((len(self.pattern[0]), own.shape[1]))
        turned = self.reversals(own)

        def rise(x: Values) -> Values:
            return recording.log.rate * slope(x, turned)

        late = -rise(self.torques(w, own, recording))
        parts = [column.change(w, late, rise)[list(column.drives)] for column in self.columns]
        return np.concatenate(parts or [late[:0]])

    def is_of(self, recording: PreparedRecording) -> bool:
        return recording.log.sha256 == self.recording.log.sha256

    def reversals(self, own: Own) -> Bool[np.ndarray, "dof steps"]:
        """For each drive and pair of samples, whether a joint whose friction acts on this drive
        turns round in between."""
        layout, (rows, columns) = self.dynamics.layout, self.dynamics.regressor_pattern
        viscous = np.isin(columns, np.arange(len(layout.names))[layout.viscous])
        turned = np.zeros((self.dynamics.dof, own.shape[1] - 1), dtype=bool)
        np.logical_or.at(turned, rows[viscous], own[viscous, :-1] * own[viscous, 1:] < 0)
        return turned

    def correction(
        self, kind: Kind, value: float, ends: Ends, unit: str, text: str, subject: str = ""
    ) -> Correction:
        low, high = ends
        return Correction(kind=kind, subject=subject, log=self.recording.path.name, value=value,
                          low=low, high=high, unit=unit, text=text)  # fmt: skip


@dataclass(frozen=True, eq=False)
class LagColumns(TimingColumns):
    """The lags of one recording's torques, one a group of drives, and what remains of its timing:
    of time constants that are estimated beside lags, and of the rate of a clock.

    If T is longer by ε at the same L, the torque as read changes by ε T τ̈ below the filter's
    corner, the column of ε. A lag that grows at the rate ρ has the column −(t − t_0) τ̇.
    """

    unsure: tuple[int, ...] = ()  # drives whose lag may be that of a filter or of a delay
    timing: Timing | None = None  # filters and clock that have been corrected
    blurred: tuple[int, ...] = ()  # drives whose steps of friction averages or filters blur

    @property
    def columns(self) -> Sequence[TimingColumn]:
        columns = [
            TimingColumn(
                group.drives,
                "+".join(group.subjects(self.dynamics)) or "torques",
                "s",
                lambda w, late, rise: late,
                min(group.deviation, LAG),
                group.remaining_lag,
            )
            for group in self.groups
            if group.free
        ]
        timing, names = self.timing, self.dynamics.robot.drives
        if timing is None:
            return columns
        constants = timing.constants[:, None]
        columns += [
            TimingColumn(
                (i,),
                f"filter.{names[i]}",
                "s",
                lambda w, late, rise: -constants * rise(late),
                float(timing.deviation[i]),
            )
            for i in timing.filters
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

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        """Lags, time constants and rate: what has been corrected plus what the fit adds."""
        delays, values = [group.delay for group in self.groups], iter(judged)
        corrections = list[Correction]()
        spread = max(delays, default=0.0) - min(delays, default=0.0)
        for group in self.groups:
            value, half = group.delay + group.remaining_lag, NORMAL * group.deviation
            ends: Ends = (value - half, value + half)
            if group.free:
                fitted = next(values).moved(group.delay)
                value, ends = fitted.value, (fitted.low, fitted.high)
            text = _sentence(value, spread, held=not group.free)
            text += _UNSURE * bool(set(group.drives) & set(self.unsure))
            text += _BLURRED * bool(set(group.drives) & set(self.blurred))
            corrections += (
                self.correction("lag", value, ends, "s", text, subject)
                for subject in group.subjects(self.dynamics)
            )
        if self.timing is not None:
            corrections += self._of_timing(self.timing, values)
        return tuple(corrections)

    def _of_timing(self, timing: Timing, judged: Iterator[Parameter]) -> Iterator[Correction]:
        names = self.dynamics.robot.drives
        for group in self.groups if timing.pure else ():  # their lags are those of their filters
            drives = [i for i in group.drives if timing.constants[i] > 0]
            if not drives:
                continue
            of_drives = np.ix_(drives, drives)
            value, deviation = common_lag(timing.lags[drives], timing.of_lags[of_drives])
            ends = value - NORMAL * deviation, value + NORMAL * deviation
            every = len(drives) == len(group.drives)
            for name in group.subjects(self.dynamics) if every else [names[i] for i in drives]:
                yield self.correction("filter", value, ends, "s", _FILTER + _PURE, name)
        for i in timing.filters:
            T = next(judged).moved(float(timing.constants[i]))
            yield self.correction("filter", T.value, (T.low, T.high), "s", _FILTER, names[i])
        if rate := timing.rate:
            clock = next(judged).moved(rate)
            low, high = (None if end is None else 1e6 * end for end in (clock.low, clock.high))
            text = (
                f"the clock of torques is {'slow' if rate > 0 else 'fast'} relative to that of "
                "positions, so the lag changes with time; torques are shifted accordingly"
            )
            yield self.correction("clock", 1e6 * clock.value, (low, high), "ppm", text)


@dataclass(frozen=True, eq=False)
class UnknownLag(LagColumns):
    """A lag that is hardly known and may be zero: the fit omits it, and intervals allow for it."""

    is_held = True

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        return ()


@dataclass(frozen=True, eq=False)
class UnknownFilter(TimingColumns):
    """Lags that may be those of filters: the fit takes them for delays, and intervals allow for
    filters with T = L."""

    is_held = True

    @property
    def columns(self) -> Sequence[TimingColumn]:
        """T² of each group: by how much a filter's response is wider than that of a delay."""
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


def slopes(trace: Trace, p: Parameters, additions: Sequence[Addition] = ()) -> OfDrives:
    """−τ̇ of the torques of p, filtered: their change per second of lag. p has the parameters of
    the robot, then of additions."""
    return timing_slopes(trace, p, additions, 0.0)[0]


def late(trace: Trace, p: Parameters, additions: Sequence[Addition] = ()) -> ColumnsOfDrives:
    """The same slopes, each drive's in a column of its own."""
    return of_own_drives(slopes(trace, p, additions)[:, :, None])


def timing_slopes(
    trace: Trace, p: Parameters, additions: Sequence[Addition], about: float
) -> tuple[OfDrives, OfDrives, OfDrives]:
    """Filtered slopes of a drive's torque by L, by T at the same L, and by ρ, with t_0 = `about`:

        −ẏ,    d(y − y′)/dt,    −(t − t_0) ẏ,

    where y is the torque behind the trace's filter, and y′ that behind this filter twice."""
    drives, rate = np.arange(trace.dynamics.dof), trace.low_pass.rate
    by_p = replace(trace, load=p)
    columns = LagColumns(trace.dynamics, tuple(additions), p, trace.recording, ())
    sharp = ~np.array(trace.constants or np.zeros(len(drives)), dtype=bool)

    def derivatives(w: SampleBlock) -> Values:
        own = by_p.entries(w)
        once = trace.behind(columns.torques(w, own, trace.recording), drives)
        twice = trace.behind(once.copy(), drives)
        late = -rate * slope(once, columns.reversals(own) & sharp[:, None])
        return np.vstack([late, rate * slope(once - twice), (w.time - about) * late])

    filtered = trace.filtered(derivatives, np.tile(drives, 3), trace.settling)
    late, longer, growing = np.split(filtered, 3)
    return late, longer, growing


def slope(tau: OfDrives, turned: Bool[np.ndarray, "dof steps"] | bool = False) -> OfDrives:
    """The rise of torques from sample to sample, without the steps of friction.

    Central differences; next to a reversal (`turned`), the difference on the side without a step.
    """
    steps = np.diff(tau, axis=1)
    total, number = (
        np.pad(values, ((0, 0), (0, 1))) + np.pad(values, ((0, 0), (1, 0)))
        for values in (np.where(turned, 0.0, steps), np.where(turned, 0.0, np.ones_like(steps)))
    )
    return total / np.maximum(number, 1.0)


def _sentence(value: float, spread: float, *, held: bool) -> str:
    text = (
        f"torque {'lags' if value > 0 else 'leads'} position, drive filters included, and is "
        "shifted by this"
    )
    if held:
        return (
            f"{text}; only steps of friction determine it, and other rows give a different lag: "
            "friction law, load or torque constants are in doubt"
        )
    return f"{text}; drives differ by {1e3 * spread:.2g} ms" if spread > APART else text
