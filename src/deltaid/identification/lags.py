"""Lags of all torque channels of several recordings, estimated together with the parameters.

Traces of the recordings are held in memory. About lags δ that are known so far, p and what is left
of the lags, ε, come from one linear least squares with the prior of the parameters, as the fit has
it but without cones; torques are read δ + ε later and it is repeated until ε is small. Rows at
reversals do not count in this; what they tell, they tell by themselves (`reversal_lags`).

The prior is what makes it sharp. A drive's own columns, of a wrist above all, are nearly dependent;
without a prior they take up what the lag explains (±0.7 ms for drive 4 of a 4-DOF Delta against
±0.04 ms).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.lag_columns import slopes
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import STRETCHES, of_own_drives
from deltaid.estimation.scatter import quantile
from deltaid.estimation.trace_rows import RecordingRows, TraceRows
from deltaid.estimation.traces import Delay, Trace
from deltaid.identification.lag_groups import common_lag
from deltaid.identification.reversal_lags import lags_of_reversals

# Lags that can be found [s].
REACH = 0.02
# Sweeps at most, and the step [s] below which what is left is linear enough.
_SWEEPS, _SETTLED = 12, 1e-4
# Standard deviation of what a lag may be, and of one that reversals tell and other rows contradict
# [s], and how many standard deviations a contradiction is.
_PRIOR, _HELD, _AGREE = 0.01, 1e-7, 3.0
# What is added to the deviation of a lag by rows that do not follow the law of friction [s].
_DOUBTFUL = 3e-3

Delays = Float[np.ndarray, "recordings dof"]


@dataclass(frozen=True, eq=False)
class Lag:
    """Lags of one recording's torques behind its positions.

    Attributes:
        values: of each drive [s]; positive where torques come late.
        deviation: their standard deviations [s].
    """

    values: Delay
    deviation: Delay

    @property
    def interval(self) -> Delay:
        """Half widths of their 95 % intervals [s]."""
        return quantile(np.full(len(self.deviation), STRETCHES - 1.0)) * self.deviation


@dataclass(frozen=True, eq=False)
class Lags:
    """The lag of every drive in every recording.

    Attributes:
        values: (recordings, drives) [s]; positive where torques come late.
        covariance: of each recording's (recordings, drives, drives) [s²].
        steps, told: those that reversals tell, and standard deviations, infinite for others [s].
        agrees: whether the other rows say the same; where they do not, something else is wrong.
        p: the parameters that go with them, of the robot and of additions.
    """

    values: Delays
    covariance: Float[np.ndarray, "recordings dof dof"]
    steps: Delays
    told: Delays
    agrees: Bool[np.ndarray, "recordings dof"]
    p: Parameters

    def each(self, k: int) -> Lag:
        """Those of the k-th recording."""
        return Lag(self.values[k], np.sqrt(np.diag(self.covariance[k])))

    def common(self, k: int) -> Lag:
        """The lag that all its drives have, (1ᵀC⁻¹δ)/(1ᵀC⁻¹1), for every drive."""
        value, deviation = common_lag(self.values[k], self.covariance[k])
        return Lag(np.full(len(self.values[k]), value), np.full(len(self.values[k]), deviation))


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def estimate_lags(
    traces: Sequence[Trace],
    additions: Sequence[Addition] = (),
    *,
    spread: float,
    start: Delays | None = None,
) -> Lags:
    """One lag a drive and recording, with what is to be known to judge them.

    Where reversals tell a lag it is that of the reversals, which nothing else can imitate.

    Args:
        traces: of the recordings, without reversals and with torques as they came.
        additions: columns beside those of the robot.
        spread: relative standard deviation of the prior.
        start: lags to begin with [s]; none if not given.
    """
    fit = _Fit(traces, TraceRows.of(traces[0].dynamics, additions, spread))
    nothing = np.zeros((len(traces), traces[0].dynamics.dof))
    start = nothing if start is None else start
    rough = fit.swept(start, nothing, np.full_like(nothing, _PRIOR))
    found = [
        lags_of_reversals(one, additions, rough.p, lags)
        for one, lags in zip(traces, rough.lags, strict=True)
    ]
    steps, told = np.array([(one.values, one.deviation) for one in found]).swapaxes(0, 1)
    deviation = np.sqrt(np.diagonal(rough.covariance, axis1=1, axis2=2))
    agrees = np.abs(steps - rough.lags) < _AGREE * np.hypot(told, deviation)
    # A filter and friction that yields look alike; so one that nothing else bears out is not told.
    yields = np.array([one.filtered for one in found]) & ~agrees
    told = np.where(yields, np.inf, told)
    known = np.isfinite(told)
    # Where steps are seen that are none of a drive's friction law, other rows are not believed.
    doubtful = (np.array([one.doubtful for one in found]) | yields) & ~known
    if not known.any():
        covariance = rough.covariance + _DOUBTFUL**2 * _diagonal(doubtful)
        return Lags(rough.lags, covariance, steps, told, ~known, rough.p)
    agrees |= ~known
    held = np.where(known, np.where(agrees, told, _HELD), _PRIOR)
    refined = fit.swept(steps, np.where(known, steps, 0.0), held, rough.p)
    values, covariance = refined.lags.copy(), refined.covariance.copy()
    for k, i in np.argwhere(known):
        # Both ways are independent: they share no row.
        weights = np.array([told[k, i] ** -2.0, agrees[k, i] * deviation[k, i] ** -2.0])
        values[k, i] = weights @ [steps[k, i], rough.lags[k, i]] / weights.sum()
        covariance[k, i, :] = covariance[k, :, i] = 0.0
        covariance[k, i, i] = 1 / weights.sum()
    covariance += _DOUBTFUL**2 * _diagonal(doubtful)
    return Lags(values, covariance, steps, told, agrees, refined.p)


def _diagonal(which: Bool[np.ndarray, "recordings dof"]) -> Float[np.ndarray, "recordings dof dof"]:
    return which[:, :, None] * np.eye(which.shape[1])


@dataclass(frozen=True, eq=False)
class _Fit:
    """Least squares of p and lags over the traces of recordings."""

    traces: Sequence[Trace]
    rows: TraceRows

    def swept(
        self, start: Delays, centre: Delays, deviation: Delays, p: Parameters | None = None
    ) -> "_Found":
        """The lags from a start on, given that they are near a centre.

        Args:
            start: lags to begin with [s].
            centre, deviation: what is known of them [s].
            p: parameters to begin with.
        """
        rows, delays = self.rows, start
        for sweep in range(_SWEEPS):
            shifted = [
                one.shifted(by) if np.any(by) else one
                for one, by in zip(self.traces, delays, strict=True)
            ]
            parts = [rows.of_trace(one) for one in shifted]
            if p is None:
                p = rows.parameters(rows.problem(parts).x)
            if rows.dynamics.robot.load_drives:
                shifted = [replace(one, load=p[: len(one.load)]) for one in shifted]
                parts = [rows.of_trace(one) for one in shifted]
            parts = [self._with_lags(*both, p) for both in zip(parts, shifted, strict=True)]
            known = rows.problem(parts, (centre - delays).ravel(), deviation.ravel())
            p, step = rows.parameters(known.x), known.x[rows.size :].reshape(delays.shape)
            delays = np.clip(delays + step, -REACH, REACH)
            if np.abs(step).max() < _SETTLED or sweep == _SWEEPS - 1:
                covariance = known.covariance(slice(rows.size, None))
                return _Found(delays, _each(covariance, len(delays)), p)
        raise AssertionError

    def _with_lags(self, part: RecordingRows, one: Trace, p: Parameters) -> RecordingRows:
        """Rows of a trace, with slopes −τ̇ of the torques of p for the lags of all."""
        own = of_own_drives(slopes(one, p, self.rows.additions)[:, :, None])
        lags = [
            own if trace.recording is one.recording else np.zeros_like(own) for trace in self.traces
        ]
        return replace(part, A=np.concatenate([part.A, *lags], axis=2))


@dataclass(frozen=True, eq=False)
class _Found:
    """Lags with the covariance of each recording's, and p."""

    lags: Delays
    covariance: Float[np.ndarray, "recordings dof dof"]
    p: Parameters


def _each(
    covariance: Float[np.ndarray, "lags lags"], recordings: int
) -> Float[np.ndarray, "recordings dof dof"]:
    """That of each recording's own."""
    dof = len(covariance) // recordings
    parts = covariance.reshape(recordings, dof, recordings, dof)
    return np.array([parts[k, :, k] for k in range(recordings)])
