"""Lags of all torque channels of several recordings, estimated together with the parameters.

About lags δ that are known so far, p and the remaining lags, ε, come from one linear least squares
with the prior of the parameters, as the fit has it but without cones; torques are read δ + ε later
and it is repeated until ε is small. Rows at reversals are excluded and evaluated separately
(`reversals`).

The prior makes it sharp: a drive's own columns, of a wrist above all, are nearly dependent and
would take up what the lag explains (±0.7 ms for drive 4 of a 4-DOF Delta against ±0.04 ms).

Drives have as few lags as their estimates allow: none, if that is not contradicted, then one that
all or some of them have, then more. A hypothesis is a matrix S, δ = S ε, that defines whose lags
are equal and whose are zero; ε by generalised least squares, misfit of S by Hotelling's T².
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.hotelling import limit
from deltaid.effects.lag_columns import LagGroup, slopes
from deltaid.effects.reversals import lags_of_reversals
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import STRETCHES, of_own_drives
from deltaid.estimation.scatter import quantile
from deltaid.estimation.trace_rows import TraceRows
from deltaid.estimation.traces import Delay, Trace

# Lags that can be estimated [s].
REACH = 0.02
# Sweeps at most, and the step [s] below which the rest is linear enough.
_SWEEPS, _SETTLED = 12, 1e-4
# Standard deviation of what a lag may be, and of one that reversals show and other rows contradict
# [s], and how many standard deviations a contradiction is.
_PRIOR, _HELD, _AGREE = 0.01, 1e-7, 3.0
# What is added to the deviation of a lag by rows that do not follow the law of friction [s].
_DOUBTFUL = 3e-3
# How often it is rejected, if true, that there is no lag or that all drives have the same; and what
# else is equal or zero by chance only.
_REJECTED, _UNLIKELY, _SELDOM = 1e-3, 0.2, 0.01
# Lags [s] that do no harm, and need not be corrected.
_HARMLESS = 2e-5
# Drives beyond which only common lags and lags of single drives are distinguished.
_MANY = 6

Delays = Float[np.ndarray, "recordings dof"]
Covariances = Float[np.ndarray, "recordings dof dof"]
Covariance = Float[np.ndarray, "dof dof"]


@dataclass(frozen=True, eq=False)
class Lag:
    """By how much each drive's torque or rate comes late in a recording, and its deviation [s]."""

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
        values: [s]; positive where torques come late.
        covariance: of each recording's [s²].
        steps, told: those that reversals show, and standard deviations, infinite for others [s].
        agrees: whether the other rows agree; where they do not, something else is wrong.
        abrupt: whether reversals show steps at once, which no filter lets through.
        p: the parameters that go with them, of the robot and of additions.
    """

    values: Delays
    covariance: Covariances
    steps: Delays
    told: Delays
    agrees: Bool[np.ndarray, "recordings dof"]
    abrupt: Bool[np.ndarray, "recordings dof"]
    p: Parameters

    def each(self, k: int) -> Lag:
        """Those of the k-th recording."""
        return Lag(self.values[k], np.sqrt(np.diag(self.covariance[k])))

    def common(self, k: int) -> Lag:
        """The lag that all its drives have, (1ᵀC⁻¹δ)/(1ᵀC⁻¹1), for every drive."""
        value, deviation = common_lag(self.values[k], self.covariance[k])
        return Lag(np.full(len(self.values[k]), value), np.full(len(self.values[k]), deviation))

    def groups(self, k: int) -> tuple[LagGroup, ...]:
        """Which drives of the k-th recording lag, by how much."""
        choice, groups = chosen_groups(self.values[k], self.covariance[k]), list[LagGroup]()
        for members in choice.groups:
            drives, delay = list(members), choice.delay[members[0]]
            weights = self.told[k, drives] ** -2.0
            if not weights.any():
                groups.append(LagGroup(members, delay))
                continue
            by_steps = float(weights @ self.steps[k, drives] / weights.sum())
            free, deviation = bool(np.all(self.agrees[k, drives])), float(weights.sum() ** -0.5)
            delay = delay if free else by_steps
            groups.append(LagGroup(members, delay, by_steps - delay, deviation, free))
        return tuple(groups)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def estimate_lags(
    traces: Sequence[Trace],
    additions: Sequence[Addition] = (),
    *,
    spread: float,
    start: Delays | None = None,
    turning: Sequence[Trace] = (),
) -> Lags:
    """One lag a drive and recording, with covariances.

    Where reversals show a lag it is that of the reversals, which nothing else can imitate.

    Args:
        traces: of the recordings, without reversals and with torques as they came.
        additions: extra columns.
        spread: relative standard deviation of the prior.
        start: lags to begin with [s]; none if not given.
        turning: of the same recordings with positions of motors, which have the friction; traces
            themselves if not given.
    """
    rows = TraceRows.of(traces[0].dynamics, additions, spread)
    nothing = np.zeros((len(traces), rows.dynamics.dof))
    start = nothing if start is None else start
    values, covariance, p = _swept(rows, traces, start, nothing, np.full_like(nothing, _PRIOR))
    reversals = [
        lags_of_reversals(trace, additions, p, lags)
        for trace, lags in zip(turning or traces, values, strict=True)
    ]
    steps, step_std = np.array([(lag.values, lag.deviation) for lag in reversals]).swapaxes(0, 1)
    deviation = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    agrees = np.abs(steps - values) < _AGREE * np.hypot(step_std, deviation)
    # A filter and friction that yields look alike; one that no other rows confirm does not count.
    yields = np.array([lag.filtered for lag in reversals]) & ~agrees
    step_std = np.where(yields, np.inf, step_std)
    abrupt = np.isfinite(step_std) & ~np.array([lag.filtered for lag in reversals])
    known = np.isfinite(step_std)
    agrees |= ~known
    if known.any():
        held = np.where(known, np.where(agrees, step_std, _HELD), _PRIOR)
        remaining, errors, p = _swept(rows, traces, steps, np.where(known, steps, 0.0), held, p)
        # Both ways are independent: they share no row.
        by_steps, by_rows = step_std**-2.0, agrees * deviation**-2.0
        weight = by_steps + by_rows
        values = np.where(known, (by_steps * steps + by_rows * values) / weight, remaining)
        unknown = ~known[:, :, None] & ~known[:, None, :]
        covariance = errors * unknown + _diagonal(known / weight)
    # Where steps contradict a drive's friction law, other rows are not trusted.
    doubtful = (np.array([lag.doubtful for lag in reversals]) | yields) & ~known
    covariance = covariance + _DOUBTFUL**2 * _diagonal(doubtful)
    return Lags(values, covariance, steps, step_std, agrees, abrupt, p)


def _diagonal(entries: np.ndarray) -> Covariances:
    return entries[:, :, None] * np.eye(entries.shape[1])


def _swept(
    rows: TraceRows,
    traces: Sequence[Trace],
    delays: Delays,
    centre: Delays,
    deviation: Delays,
    p: Parameters | None = None,
) -> tuple[Delays, Covariances, Parameters]:
    """Lags from some on, given that they are `centre` ± `deviation`; covariances, and p."""
    dof, sweep = rows.dynamics.dof, 0
    while True:
        shifted = [
            trace.shifted(delay) if np.any(delay) else trace
            for trace, delay in zip(traces, delays, strict=True)
        ]
        parts = [rows.of_trace(trace) for trace in shifted]
        if p is None:
            p = rows.parameters(rows.problem(parts).x)
        if rows.dynamics.robot.load_drives:
            shifted = [replace(trace, load=p[: len(trace.load)]) for trace in shifted]
            parts = [rows.of_trace(trace) for trace in shifted]
        for k, (part, trace) in enumerate(zip(parts, shifted, strict=True)):
            columns = slopes(trace, p, rows.additions)[:, :, None]
            lags = np.zeros((*columns.shape[:2], delays.size))
            lags[:, :, k * dof : (k + 1) * dof] = of_own_drives(columns)
            parts[k] = replace(part, A=np.concatenate([part.A, lags], axis=2))
        problem = rows.problem(parts, (centre - delays).ravel(), deviation.ravel())
        p, step = rows.parameters(problem.x), problem.x[rows.size :].reshape(delays.shape)
        delays, sweep = np.clip(delays + step, -REACH, REACH), sweep + 1
        if np.abs(step).max() < _SETTLED or sweep == _SWEEPS:
            all_of_them = problem.covariance(slice(rows.size, None))
            blocks = all_of_them.reshape(*delays.shape, *delays.shape)
            return delays, np.array([blocks[k, :, k] for k in range(len(traces))]), p


@dataclass(frozen=True, eq=False)
class Choice:
    """Groups of drives that have the same lag, and the lag of every drive [s]."""

    groups: tuple[tuple[int, ...], ...]
    delay: tuple[float, ...]


def chosen_groups(values: Delay, covariance: Covariance) -> Choice:
    """The simplest hypothesis on lags that their estimates do not contradict.

    Of several that are as simple, the one with fewer drives without a lag is taken, then the one
    that is contradicted least: a drive that hardly moves has the lag of the others.

    Args:
        values: estimate of each drive's lag [s].
        covariance: of these, by scatter between `STRETCHES` stretches.
    """
    dof = len(values)
    _, together = _fitted(values, covariance, np.ones((dof, 1)))
    for (count, _), hypotheses in groupby(_hypotheses(dof), key=_complexity):
        candidates = list[tuple[float, tuple[int, ...], Delay]]()
        for labels in hypotheses:
            S = np.equal.outer(labels, np.arange(1, count + 1)).astype(float)
            delay, distance = _fitted(values, covariance, S)
            harmless = np.abs(values - delay).max() < _HARMLESS
            if harmless or not _contradicted(labels, distance, together):
                candidates.append((distance, labels, delay))
        if candidates:
            _, labels, delay = min(candidates, key=lambda candidate: candidate[0])
            members = (np.flatnonzero(np.equal(labels, k + 1)).tolist() for k in range(count))
            return Choice(tuple(map(tuple, members)), tuple(delay.tolist()))
    raise AssertionError  # a lag for every drive is never contradicted


def agree(values: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]) -> bool:
    """Whether estimates do not contradict that all are of the same size."""
    _, distance = _fitted(values, covariance, np.ones((len(values), 1)))
    return distance <= limit(len(values) - 1, _SELDOM)


def common_lag(values: Delay, covariance: Covariance) -> tuple[float, float]:
    """The lag that all drives have by generalised least squares, and its standard deviation [s]."""
    b, A = _whitened(values, covariance, np.ones((len(values), 1)))
    size = float(np.sum(A**2))
    return float(A[:, 0] @ b) / size, size**-0.5


def _whitened(
    values: Delay, covariance: Covariance, S: Float[np.ndarray, "dof groups"]
) -> tuple[Delay, Float[np.ndarray, "dof groups"]]:
    """Estimates, and the columns of a hypothesis, in units in which estimates err as 1."""
    scale = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(scale, scale))
    white = np.linalg.solve(root, np.column_stack([values, S]) / scale[:, None])
    return white[:, 0], white[:, 1:]


def _fitted(
    values: Delay, covariance: Covariance, S: Float[np.ndarray, "dof groups"]
) -> tuple[Delay, float]:
    """S ε by generalised least squares, and T² of what it leaves."""
    b, A = _whitened(values, covariance, S)
    free = np.linalg.lstsq(A, b, rcond=None)[0]
    return S @ free, float(np.sum((b - A @ free) ** 2))


def _contradicted(labels: tuple[int, ...], distance: float, together: float) -> bool:
    """Whether T² rejects a hypothesis.

    Args:
        distance, together: T² of what it leaves, and of what one lag for all leaves.
    """
    free = len(labels) - max(labels)
    if not any(labels):
        common = distance - together > limit(1, 0.5 * _REJECTED)
        return common or distance > limit(free, 0.5 * _REJECTED)
    share = _REJECTED if len(set(labels)) == 1 else _UNLIKELY
    return free > 0 and distance > limit(free, share)


def _hypotheses(dof: int) -> list[tuple[int, ...]]:
    """For each drive 0, no lag, or the number of its group; the simplest first."""
    if dof > _MANY:
        return [(0,) * dof, (1,) * dof, tuple(range(1, dof + 1))]
    labels: list[tuple[int, ...]] = [()]
    for _ in range(dof):
        labels = [(*head, k) for head in labels for k in range(max(head, default=0) + 2)]
    return sorted(labels, key=_complexity)


def _complexity(labels: tuple[int, ...]) -> tuple[int, int]:
    """How many lags there are, and how many drives have none."""
    return max(labels), labels.count(0)
