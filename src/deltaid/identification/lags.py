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
from deltaid.identification.additions import Addition, extended
from deltaid.identification.information import active_columns
from deltaid.identification.lag_columns import LagColumns, alone
from deltaid.identification.objective import NOISE_FLOOR
from deltaid.identification.reduction import Reduction, build_reduction
from deltaid.identification.regularizer import Euclidean, QuadraticTerm
from deltaid.identification.reversal_lags import lags_of_reversals
from deltaid.identification.traces import Trace

# Lags that can be found [s].
REACH = 0.02
# Sweeps at most, and the step [s] below which what is left is linear enough.
_SWEEPS, _SETTLED = 12, 1e-4
# Stretches of time of a recording whose scatter says how certain a lag is.
BLOCKS = 40
# Standard deviation of what a lag may be, and of one that reversals tell and other rows contradict
# [s], and how many standard deviations a contradiction is.
_PRIOR, _HELD, _AGREE = 0.01, 1e-7, 3.0
# What is added to the deviation of a lag by rows that do not follow the law of friction [s].
_DOUBTFUL = 3e-3

Rows = Float[np.ndarray, " rows"]
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


@dataclass(frozen=True, eq=False)
class _Sheet:
    """The rows of one trace for some delay: filtered columns, those of its lags, and torques.

    Attributes:
        X: columns of the free variables, (drives, samples, variables).
        slopes: −τ̇ (drives, samples).
        tau: torques less what is known of them.
    """

    X: Float[np.ndarray, "dof samples variables"]
    slopes: Float[np.ndarray, "dof samples"]
    tau: Float[np.ndarray, "dof samples"]


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

    def swept(self, start: Delays, centre: Delays, deviation: Delays) -> "_Solution":
        """The lags from a start on, given that they are near a centre.

        Args:
            start: lags to begin with [s].
            centre, deviation: what is known of them [s].
        """
        reduction = reduced(self.traces[0], self.additions)
        prior = Euclidean().regularizer(reduction).quadratic
        delays, p = start, None
        for sweep in range(_SWEEPS):
            shifted = [
                one.shifted(by) if np.any(by) else one
                for one, by in zip(self.traces, delays, strict=True)
            ]
            if p is None:
                sheets = [_sheet(one, self.additions, reduction, None) for one in shifted]
                x = _solved(sheets, prior, self.spread, None).x
                p = reduction.A @ x + reduction.p_0
            sheets = [_sheet(one, self.additions, reduction, p) for one in shifted]
            found = _solved(sheets, prior, self.spread, (centre - delays, deviation))
            p = reduction.A @ found.x + reduction.p_0
            moved = np.clip(delays + found.lags, -REACH, REACH)
            if np.abs(found.lags).max() < _SETTLED or sweep == _SWEEPS - 1:
                return replace(found, lags=moved, p=p)
            delays = moved
        raise AssertionError


@dataclass(frozen=True, eq=False)
class _Solution:
    """Free variables, lags with their covariance, and p."""

    x: Float[np.ndarray, " variables"]
    lags: Delays
    covariance: Float[np.ndarray, "recordings dof dof"]
    p: Parameters


def reduced(trace: Trace, additions: Sequence[Addition]) -> Reduction:
    """The free variables of a robot with additions."""
    regressor = extended(trace.dynamics, additions)
    added = [(one.parameters, one.free) for one in additions]
    return build_reduction(trace.dynamics.robot, active_columns(regressor), added)


def _sheet(
    trace: Trace, additions: Sequence[Addition], reduction: Reduction, p: Parameters | None
) -> _Sheet:
    """Filtered rows of a trace."""
    dynamics = trace.dynamics
    dof = dynamics.dof
    if dynamics.robot.load_drives and p is not None:
        trace = replace(trace, load=p[: len(dynamics.layout.names)])
    slope_of = np.zeros(len(reduction.p_0)) if p is None else p
    lags = LagColumns(dynamics, tuple(additions), slope_of, trace.recording, alone(dof))
    Y = trace.regressor((*additions, lags))
    active = active_columns(extended(dynamics, additions))
    columns, slopes = Y[:, :, :-dof], np.stack([Y[i, :, i - dof] for i in range(dof)])
    known = columns @ reduction.p_0[active]
    return _Sheet(columns @ reduction.A[active], slopes, trace.torques(np.zeros(dof)) - known)


def _solved(
    sheets: Sequence[_Sheet],
    prior: QuadraticTerm,
    spread: float,
    known: tuple[Delays, Delays] | None,
) -> _Solution:
    """Least squares over all recordings, each drive's rows by what is left of them.

    Args:
        sheets: rows of the recordings.
        prior, spread: of the parameters.
        known: what lags are beside those of the sheets, and its deviation; None for no lags.
    """
    lags = known is not None
    n, dof = sheets[0].X.shape[2], len(sheets[0].tau)
    width = n + (len(sheets) * dof if lags else 0)
    parts, right = [], []
    for k, sheet in enumerate(sheets):
        scale = _noise(sheet, lags=lags)
        rows = np.zeros((dof, sheet.X.shape[1], width))
        rows[:, :, :n] = sheet.X / scale[:, None, None]
        if lags:
            at = n + k * dof + np.arange(dof)
            rows[np.arange(dof), :, at] = sheet.slopes / scale[:, None]
        parts.append(rows.reshape(-1, width))
        right.append((sheet.tau / scale[:, None]).ravel())
    before = np.zeros((len(prior.D), width))
    before[:, :n] = prior.D / spread
    parts.append(before)
    right.append(prior.D @ prior.x_reg / spread)
    if known is not None:
        centre, deviation = known
        parts.append(np.hstack([np.zeros((width - n, n)), np.diag(1.0 / deviation.ravel())]))
        right.append((centre / deviation).ravel())
    A, b = np.vstack(parts), np.concatenate(right)
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0] = 1.0
    Q, R = np.linalg.qr(A / norms)
    solution = np.linalg.lstsq(R, Q.T @ b, rcond=None)[0] / norms
    x, delays = solution[:n], solution[n:].reshape(-1, dof)
    if not lags:
        return _Solution(x, delays, np.zeros((0, dof, dof)), np.zeros(0))
    # Each lag errs by the sum over rows of what is left times its influence.
    influence = Q @ np.linalg.pinv(R)[n:].T / norms[n:]
    left = b - A @ solution
    covariance, first = [], 0
    for k, sheet in enumerate(sheets):
        mine = slice(k * dof, (k + 1) * dof)
        covariance.append(np.zeros((dof, dof)))
        first = 0
        for other in sheets:
            rows = slice(first, first + other.tau.size)
            covariance[k] += _scatter(influence[rows, mine], left[rows], dof)
            first += other.tau.size
        covariance[k] += influence[first:, mine].T @ influence[first:, mine]  # of the prior
        assert sheet.tau.size
    return _Solution(x, delays, np.array(covariance), np.zeros(0))


def _noise(sheet: _Sheet, *, lags: bool) -> Float[np.ndarray, " dof"]:
    """What each drive's columns leave of its torques, root mean square."""
    noise = []
    for X, slopes, tau in zip(sheet.X, sheet.slopes, sheet.tau, strict=True):
        columns = np.column_stack([X, slopes]) if lags else X
        norms = np.linalg.norm(columns, axis=0)
        kept = norms > 0
        fitted = columns[:, kept] / norms[kept]
        left = tau - fitted @ np.linalg.lstsq(fitted, tau, rcond=1e-9)[0]
        floor = NOISE_FLOOR * max(float(np.abs(tau).max()), np.finfo(float).tiny)
        noise.append(max(float(np.sqrt(np.mean(left**2))), floor))
    return np.array(noise)


def _scatter(
    influence: Float[np.ndarray, "rows lags"], left: Rows, dof: int
) -> Float[np.ndarray, "lags lags"]:
    """Covariance of lags by the scatter between stretches of time, or white if that is wider."""
    samples = len(left) // dof
    starts = np.unique(-(-np.arange(BLOCKS) * samples // BLOCKS))
    shares = (influence * left[:, None]).reshape(dof, samples, -1)
    sums = np.add.reduceat(shares, starts, axis=1).sum(axis=0)
    scatter = sums.T @ sums * len(starts) / max(len(starts) - 1, 1)
    white = np.sum(influence**2, axis=0) * np.mean(left**2)
    grown = np.sqrt(np.maximum(white / np.maximum(np.diag(scatter), 1e-300), 1.0))
    return scatter * np.outer(grown, grown)
