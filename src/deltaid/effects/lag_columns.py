"""Lags of torque channels as columns of the regression.

A torque that is recorded ε later than the motion beside it, τ_meas(t) = τ(t − ε), is to first order

    τ_meas,i = Y_i p − ε τ̇_i,

so a lag is one more free coefficient whose column is −τ̇. This is the slope of the *model's* torque:
noise on a measured one would pull ε towards zero. A first-order filter of time constant T has the
same first-order term, so what is found is the sum of dead time and time constants.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.estimation.additions import Addition, Own, Values, extended
from deltaid.estimation.traces import Trace
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import PRIOR_SPREAD, Parameter

# What a lag may be about the one that has been applied already: a standard deviation of half [s].
_SIZE = 0.02
# Lags that differ by more [s] are told to do so.
_APART = 3e-4
# Half a 95 % interval in standard deviations.
_NORMAL = 1.96

Torques = Float[np.ndarray, "dof samples"]


@dataclass(frozen=True)
class LagGroup:
    """Drives that have the same lag.

    Attributes:
        drives: their numbers.
        delay: what has been put right already [s].
        beside: what is known of the lag beside this from rows that no fit sees [s].
        deviation: its standard deviation; infinite if nothing is known [s].
        free: whether the fit may change it; where other rows contradict what is known, it may not.
    """

    drives: tuple[int, ...]
    delay: float
    beside: float = 0.0
    deviation: float = np.inf
    free: bool = True


@dataclass(frozen=True, eq=False)
class LagColumns(Addition):
    """The lags of one recording's torques, each of one drive or of several that have the same.

    Attributes:
        dynamics: of the robot.
        beside: columns whose torques lag with those of the robot.
        p: the parameters of both, in their order, whose torques have the slope τ̇.
        recording: which has these lags.
        groups: drives that lag; others do not.
        several: whether the fit has other recordings.
    """

    dynamics: Dynamics
    beside: tuple[Addition, ...]
    p: Parameters
    recording: Recording
    groups: tuple[LagGroup, ...]
    several: bool = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One lag a group that is free."""
        where = f"@{self.recording.path}" if self.several else ""
        return tuple(
            Parameter(
                "lag",
                ("+".join(subjects(group.drives, self._drives)) or "torques") + where,
                "lag",
                "s",
                -np.inf,
                np.inf,
                group.beside,
                min(group.deviation / PRIOR_SPREAD, _SIZE),
            )
            for group in self._free
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """One entry a drive that lags."""
        drives = [drive for group in self._free for drive in group.drives]
        columns = [k for k, group in enumerate(self._free) for _ in group.drives]
        return np.array(drives, dtype=int), np.array(columns, dtype=int)

    def is_of(self, recording: Recording) -> bool:
        """Whether these are lags of a recording."""
        return recording.log.sha256 == self.recording.log.sha256

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        """−τ̇ of each drive that lags."""
        drives, _ = self.pattern
        if not self.is_of(recording):
            return np.zeros((len(drives), own.shape[1]))
        values = np.vstack([own, *(one.entries(w, own, recording) for one in self.beside)])
        rows, columns = extended(self.dynamics, self.beside).regressor_pattern
        tau = w.carried.T.copy()  # of loads, which lag with all else
        for i in range(len(tau)):
            tau[i] += self.p[columns[rows == i]] @ values[rows == i]
        return -recording.log.rate * slope(tau, self._reversals(own))[drives]

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        """What has been applied, and what the fit found beside it; one for all, or one a drive."""
        delays, values = [group.delay for group in self.groups], iter(judged)
        spread = max(delays) - min(delays)
        found: list[Correction] = []
        for group in self.groups:
            if group.free:
                one = next(values)
                value = group.delay + one.value
                low, high = (None if x is None else group.delay + x for x in (one.low, one.high))
            else:
                value, half = group.delay + group.beside, _NORMAL * group.deviation
                low, high = value - half, value + half
            found += (
                Correction(
                    kind="lag",
                    subject=name,
                    log=self.recording.path.name,
                    value=value,
                    low=low,
                    high=high,
                    unit="s",
                    text=_sentence(value, spread, held=not group.free),
                )
                for name in subjects(group.drives, self._drives)
            )
        return tuple(found)

    @property
    def _free(self) -> tuple[LagGroup, ...]:
        return tuple(group for group in self.groups if group.free)

    @property
    def _drives(self) -> tuple[str, ...]:
        return self.dynamics.robot.drives

    def _reversals(self, own: Own) -> Bool[np.ndarray, "dof steps"]:
        """Whether a joint with friction turns round between a sample and the next, in whose row."""
        layout, (rows, columns) = self.dynamics.layout, self.dynamics.regressor_pattern
        turned = np.zeros((self.dynamics.dof, own.shape[1] - 1), dtype=bool)
        viscous = np.arange(len(layout.names))[layout.viscous]
        for k in np.flatnonzero(np.isin(columns, viscous)):
            turned[rows[k]] |= own[k, :-1] * own[k, 1:] < 0
        return turned


@dataclass(frozen=True, eq=False)
class UnknownLag(LagColumns):
    """A lag that may be none and is hardly known: the fit has none, and intervals allow for it."""

    @property
    def is_held(self) -> bool:
        return True

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        """Nothing has been put right."""
        del judged
        return ()


def alone(dof: int) -> tuple[LagGroup, ...]:
    """A lag for every drive, of which nothing is known."""
    return tuple(LagGroup((i,), 0.0) for i in range(dof))


def slopes(
    trace: Trace, p: Parameters, additions: Sequence[Addition] = ()
) -> Float[np.ndarray, "dof thinned"]:
    """−τ̇ of the torques of p, filtered: by what a drive's torque changes for each second that it
    comes late.

    Args:
        p: parameters of the robot, then those of additions.
    """
    dof, by_p = trace.dynamics.dof, replace(trace, load=p[: len(trace.dynamics.layout.names)])
    lags = LagColumns(trace.dynamics, tuple(additions), p, trace.recording, alone(dof))
    return trace.filtered(
        lambda w: lags.entries(w, by_p.entries(w), trace.recording), np.arange(dof), 1
    )


def slope(tau: Torques, turned: Bool[np.ndarray, "dof steps"]) -> Torques:
    """The rise of torques from sample to sample, without the steps of friction.

    Central differences; beside a reversal the difference of the side that has no step.

    Args:
        tau: (drives, samples), at least two.
        turned: between which samples and the next a joint turns round.
    """
    rise, counts = np.diff(tau, axis=1), (~turned).astype(float)
    rise = rise * counts
    total, number = np.zeros_like(tau), np.zeros_like(tau)
    total[:, :-1] += rise
    total[:, 1:] += rise
    number[:, :-1] += counts
    number[:, 1:] += counts
    return total / np.maximum(number, 1.0)


def subjects(group: Sequence[int], drives: Sequence[str]) -> tuple[str, ...]:
    """Names of drives that have something in common; one that is empty for all."""
    return ("",) if len(group) == len(drives) else tuple(drives[i] for i in group)


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
    if spread > _APART:
        text += f"; drives differ by {1e3 * spread:.2g} ms"
    return text
