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
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.identification.additions import Addition, extended
from deltaid.identification.information import active_columns
from deltaid.identification.lag_columns import LagColumns, alone
from deltaid.identification.reduction import Reduction
from deltaid.identification.reversal_lags import lags_of_reversals
from deltaid.identification.rows_with_prior import Prior, Sheet, reduced, solved
from deltaid.identification.traces import Trace

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
    fit = _Fit(traces, additions, spread)
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
    refined = fit.swept(steps, np.where(known, steps, 0.0), held)
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
    additions: Sequence[Addition]
    spread: float

    @cached_property
    def _reduction(self) -> Reduction:
        return reduced(self.traces[0], self.additions)

    def swept(self, start: Delays, centre: Delays, deviation: Delays) -> "_Found":
        """The lags from a start on, given that they are near a centre.

        Args:
            start: lags to begin with [s].
            centre, deviation: what is known of them [s].
        """
        reduction = self._reduction
        prior = Prior.of(reduction, self.spread)
        delays, p = start, None
        for sweep in range(_SWEEPS):
            shifted = [
                one.shifted(by) if np.any(by) else one
                for one, by in zip(self.traces, delays, strict=True)
            ]
            if p is None:
                rough = solved([self._sheet(one, reduction) for one in shifted], prior)
                p = reduction.A @ rough.x + reduction.p_0
            sheets = [self._with_lags(one, k, reduction, p) for k, one in enumerate(shifted)]
            known = prior.beside((centre - delays).ravel(), deviation.ravel())
            found = solved(sheets, known)
            p, step = reduction.A @ found.x + reduction.p_0, found.a.reshape(delays.shape)
            delays = np.clip(delays + step, -REACH, REACH)
            if np.abs(step).max() < _SETTLED or sweep == _SWEEPS - 1:
                return _Found(delays, _each(found.covariance, len(delays)), p)
        raise AssertionError

    def _sheet(self, one: Trace, reduction: Reduction, p: Parameters | None = None) -> Sheet:
        """Filtered rows of a trace, with slopes −τ̇ of the torques of p, one column a drive."""
        dynamics, additions = one.dynamics, tuple(self.additions)
        more: tuple[Addition, ...] = ()
        if p is not None:
            if dynamics.robot.load_drives:
                one = replace(one, load=p[: len(dynamics.layout.names)])
            more = (LagColumns(dynamics, additions, p, one.recording, alone(dynamics.dof)),)
        Y = one.regressor((*additions, *more))
        active = active_columns(extended(dynamics, additions))
        columns, slopes = Y[:, :, : len(active)], Y[:, :, len(active) :]
        tau = one.torques(np.zeros(dynamics.dof)) - columns @ reduction.p_0[active]
        return Sheet(columns @ reduction.A[active], slopes, tau)

    def _with_lags(self, one: Trace, k: int, reduction: Reduction, p: Parameters) -> Sheet:
        """Rows of the k-th trace, with columns for the lags of all."""
        sheet, dof = self._sheet(one, reduction, p), one.dynamics.dof
        A = np.zeros((*sheet.tau.shape, len(self.traces) * dof))
        A[:, :, k * dof : (k + 1) * dof] = sheet.A
        return replace(sheet, A=A)


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
