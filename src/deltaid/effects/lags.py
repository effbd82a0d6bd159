"""Lags of all torque channels of several recordings, estimated together with the parameters.

Gauss–Newton: about the present lags δ, parameters p and remaining lags ε come from one linear least
squares with the fit's prior but without its cones; then torques are read δ + ε later, until ε is
small. Rows at reversals are excluded and evaluated separately (`reversals`).

The prior is needed: a drive's own columns, above all of a wrist, are nearly dependent and would
explain what the lag does (±0.7 ms for drive 4 of a 4-DOF Delta against ±0.04 ms with it).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.lag_columns import late
from deltaid.effects.lag_groups import HARMLESS, LAG, LagGroup, chosen_groups, common_lag
from deltaid.effects.reversals import lags_of_reversals
from deltaid.effects.windings import free_friction
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import STRETCHES, TraceRows, side_by_side
from deltaid.estimation.scatter import quantile
from deltaid.estimation.traces import Delay, Trace
from deltaid.levels import ROUNDS, SURE

# Largest lag that is estimated [s].
REACH = 0.02
# Standard deviation that holds a lag at that of reversals where other rows contradict it [s].
HELD = 1e-7

Delays = Float[np.ndarray, "recordings dof"]
Covariances = Float[np.ndarray, "recordings dof dof"]


@dataclass(frozen=True, eq=False)
class Lag:
    """The lag of each drive's torque or velocity in a recording, and its standard deviation [s]."""

    values: Delay
    deviation: Delay

    @property
    def interval(self) -> Delay:
        """Half widths of their 95 % intervals [s]."""
        return quantile(np.full(len(self.deviation), STRETCHES - 1.0)) * self.deviation


@dataclass(frozen=True, eq=False)
class Lags:
    """The lag of every drive in every recording."""

    values: Delays  # [s]; positive where torques come late
    covariance: Covariances  # of each recording's [s²]
    steps: Delays  # lags by reversals [s]
    step_std: Delays  # their standard deviations; infinite where reversals determine none [s]
    # whether the other rows agree with reversals; where they do not, something else is wrong
    agrees: Bool[np.ndarray, "recordings dof"]
    abrupt: Bool[np.ndarray, "recordings dof"]  # whether steps at reversals passed no filter
    blur: Delays  # time before and after lags over which steps are blurred; zero if not [s]
    p: Parameters  # of the robot and of additions, fitted with these lags

    def each(self, k: int) -> Lag:
        return Lag(self.values[k], np.sqrt(np.diag(self.covariance[k])))

    def blurred(self, k: int) -> tuple[float, ...]:
        """`Repairs.blur` of the k-th recording."""
        return tuple(self.blur[k].tolist()) if self.blur[k].any() else ()

    def common(self, k: int) -> Lag:
        """The common lag of all drives of the k-th recording."""
        value, deviation = common_lag(self.values[k], self.covariance[k])
        return Lag(np.full(len(self.values[k]), value), np.full(len(self.values[k]), deviation))

    def groups(self, k: int) -> tuple[LagGroup, ...]:
        """Drives of the k-th recording that have the same lag."""
        groups = list[LagGroup]()
        for group in chosen_groups(self.values[k], self.covariance[k]):
            drives = list(group.drives)
            weights = self.step_std[k, drives] ** -2.0
            if weights.any():
                by_steps = float(weights @ self.steps[k, drives] / weights.sum())
                free, deviation = bool(np.all(self.agrees[k, drives])), weights.sum() ** -0.5
                delay = group.delay if free else by_steps
                group = LagGroup(group.drives, delay, by_steps - delay, float(deviation), free)
            groups.append(group)
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

    Where reversals determine a lag, they decide: nothing else looks like a lag there.

    Args:
        traces: recordings without rows at reversals and without any lag corrected.
        additions: extra columns.
        spread: relative standard deviation of the prior.
        start: start values of the lags [s]; zero if not given.
        turning: the same recordings with positions of motors, where friction acts; `traces` if not
            given.
    """
    rows = TraceRows.for_dynamics(traces[0].dynamics, additions, spread)
    nothing = np.zeros((len(traces), rows.dynamics.dof))
    start = nothing if start is None else start
    values, covariance, p = _swept(rows, traces, start, nothing, np.full_like(nothing, LAG))
    reversals = [
        lags_of_reversals(trace, additions, p, lags)
        for trace, lags in zip(turning or traces, values, strict=True)
    ]
    parts = (np.array(part) for part in zip(*reversals, strict=True))
    steps, step_std, filtered, doubtful, blur = parts
    deviation = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    agrees = np.abs(steps - values) < SURE * np.hypot(step_std, deviation)
    # Friction that yields before it slips looks like a filter or a blur: other rows must confirm
    # the lag.
    yields = (filtered | (blur > 0)) & ~agrees
    step_std, blur = np.where(yields, np.inf, step_std), np.where(yields, 0.0, blur)
    known, own = np.isfinite(step_std), np.eye(rows.dynamics.dof)
    agrees |= ~known
    if known.any():
        held = np.where(known, np.where(agrees, step_std, HELD), LAG)
        remaining, errors, p = _swept(rows, traces, steps, np.where(known, steps, 0.0), held, p)
        # Both estimates are independent: they share no row.
        by_steps, by_rows = step_std**-2.0, agrees * deviation**-2.0
        weight = by_steps + by_rows
        values = np.where(known, (by_steps * steps + by_rows * values) / weight, remaining)
        unknown = ~known[:, :, None] & ~known[:, None, :]
        covariance = errors * unknown + (known / weight)[:, :, None] * own
    if np.any(unsure := (doubtful | yields) & ~known):
        # Steps contradict the friction law, so other rows may show a false lag: the mean of the
        # lags by steps and by rows with free friction, with half their difference as deviation.
        freely, errors, _ = _swept(
            rows, traces, values, nothing, np.full_like(nothing, LAG), p, any_friction=True
        )
        values = np.where(unsure, 0.5 * (freely + steps), values)
        errors = errors + 0.25 * ((freely - steps) ** 2)[:, :, None] * own
        apart = ~unsure[:, :, None] & ~unsure[:, None, :]
        covariance = covariance * apart + errors * unsure[:, :, None] * own
    return Lags(
        values, covariance, steps, step_std, agrees, known & ~filtered & (blur == 0), blur, p
    )


def _swept(
    rows: TraceRows,
    traces: Sequence[Trace],
    delays: Delays,
    centre: Delays,
    deviation: Delays,
    p: Parameters | None = None,
    *,
    any_friction: bool = False,
) -> tuple[Delays, Covariances, Parameters]:
    """Lags from start values `delays` with the prior `centre` ± `deviation`, their covariances, and
    p; beside columns of free friction, if asked."""
    sweep, every = 0, np.arange(delays.size).reshape(delays.shape)
    while True:
        pairs = zip(traces, delays, strict=True)
        shifted = [trace.shifted(delay) if np.any(delay) else trace for trace, delay in pairs]
        parts = [rows.of_trace(trace) for trace in shifted]
        if p is None:
            p = rows.parameters(rows.problem(parts).x)
        if rows.dynamics.robot.load_drives:
            shifted = [replace(trace, load=p) for trace in shifted]
            parts = [rows.of_trace(trace) for trace in shifted]
        lags = side_by_side([late(trace, p, rows.additions) for trace in shifted])
        parts = [part.with_columns(columns) for part, columns in zip(parts, lags, strict=True)]
        if any_friction:
            for k, trace in enumerate(shifted):
                parts[k] = parts[k].with_columns(free_friction(trace, p))
        problem = rows.problem(parts, (centre - delays).ravel(), deviation.ravel())
        own = slice(rows.size, rows.size + delays.size)
        p, step = rows.parameters(problem.x), problem.x[own].reshape(delays.shape)
        delays, sweep = np.clip(delays + step, -REACH, REACH), sweep + 1
        if np.abs(step).max() < HARMLESS or sweep == ROUNDS:
            covariance = problem.covariance(own)
            return delays, np.array([covariance[np.ix_(places, places)] for places in every]), p
