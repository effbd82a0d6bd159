"""Filters of a recording's torques, and clocks of their own.

A filter 1/(1 + T s) is to first order a delay of T. With the lag L = δ + T of a drive, δ its dead
time, and the rate ρ by which lags grow,

    τ_meas(t) = y(t − L + T − ρ (t − t_0)),    T ẏ + y = τ,

whose slopes by L, T and ρ (`timing_slopes`) are columns of Gauss–Newton. Steps of friction
determine T: behind a filter they have tails. But friction that yields before it slips has tails as
well, so rows far from reversals must confirm a filter: they contradict a pure delay, or their lag L
equals the T of the tails. Friction that warms up looks like a clock to first order, so it has
columns of its own, t − t_0 times the friction of joints.

A filter or a clock is taken where it is as unlikely by chance as `DETECTED` and is possible: no
filter delays by more than the torque is late, and all torques have the same clock.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.account import DETECTED
from deltaid.effects.lag_columns import timing_slopes
from deltaid.effects.lag_groups import HARMLESS, FreeTiming, Timing, exceeded
from deltaid.estimation.drive_rows import ColumnsOfDrives, OfDrives, TraceRows, of_own_drives
from deltaid.estimation.problem import LinearProblem
from deltaid.estimation.scatter import CHANCE
from deltaid.estimation.traces import LARGEST_LAG, Delay, Trace
from deltaid.levels import LIKELY, ROUNDS, SURE
from deltaid.recording.masks.masks import least_about
from deltaid.recording.windows import SampleBlock

# Largest lag [s], time constant [s] and rate that are estimated; shortest time constant [samples].
_MOST, _SHORTEST = (LARGEST_LAG, 0.02, 5e-3), 0.5
# Time constants after a reversal until its tail has vanished: to e⁻⁵.
_TAIL = 5.0
# Largest error of a time constant and a lag that can be called equal, as a share of the former.
_KNOWN = 0.25

Drives = Bool[np.ndarray, " dof"]


def other_than_delays(
    rows: TraceRows, trace: Trace, lags: Delay, abrupt: Drives, blurred: Drives, p: Parameters
) -> tuple[Timing | None, Drives]:
    """The timing of a recording with filters or a clock, None without these; and the drives whose
    lags may be those of filters or of delays.

    Args:
        trace: without any lag corrected.
        lags: of each drive [s].
        abrupt: drives whose steps at reversals passed no filter.
        blurred: drives whose steps are blurred as by no filter of first order; by a clock they may.
    """
    dof = len(lags)
    about = float(np.concatenate([run.time for run in trace.stretches]).mean())
    none = Timing(lags, np.zeros(dof), 0.0, about, np.zeros((2 * dof + 1,) * 2), p)
    # Sharp steps at the same lag all over a recording exclude another clock.
    clock = 2 * int(np.count_nonzero(abrupt)) < dof and _may_be_clock(rows, trace, none)
    free = FreeTiming((lags > 1.0 / trace.low_pass.rate) & ~(abrupt | blurred), clock)
    unsure = np.zeros(dof, bool)
    while free.filters.any() or free.clock:
        start = replace(none, constants=np.where(free.filters, 0.5 * lags, 0.0))
        timing = _swept(rows, trace, start, free)
        kept = FreeTiming(
            _filtered(rows, trace, timing, free), free.clock and _is_clock(rows, trace, timing)
        )
        if np.array_equal(kept.columns, free.columns):
            return _simplest(rows, trace, timing, free), unsure & ~free.filters
        long = timing.constants + LIKELY * timing.deviation > 0.5 * timing.lags
        unsure |= free.filters & ~kept.filters & long
        free = kept
    return None, unsure


def _simplest(rows: TraceRows, trace: Trace, timing: Timing, free: FreeTiming) -> Timing:
    """The timing without dead times, if no filter needs one: then T is known as well as L."""
    dead, covariance = _dead_times(timing, free.filters)
    if not len(dead) or exceeded(dead, covariance, CHANCE):
        return timing
    start = replace(timing, constants=np.where(free.filters, timing.lags, 0.0))
    return _swept(rows, trace, start, replace(free, pure=True))


def _dead_times(
    timing: Timing, chosen: Drives
) -> tuple[Float[np.ndarray, " chosen"], Float[np.ndarray, "chosen chosen"]]:
    """L − T of the chosen drives, and its covariance."""
    each = np.eye(len(chosen))[chosen]
    S = np.hstack([each, -each, np.zeros((len(each), 1))])
    return S @ timing.values, S @ timing.covariance @ S.T


def _may_be_clock(rows: TraceRows, trace: Trace, none: Timing) -> bool:
    """Whether torques with lags corrected may have a clock of their own."""
    free = FreeTiming(np.zeros(len(none.lags), bool), clock=True)
    step, covariance = free.steps(_linear(rows, none.corrected(trace), none, free), rows.size)
    return exceeded(step[-1:], covariance[-1:, -1:], CHANCE)


def _swept(rows: TraceRows, trace: Trace, start: Timing, free: FreeTiming) -> Timing:
    """Lags, time constants of some drives, and the rate of a clock, by Gauss–Newton."""
    timing, dof, own = start, len(start.lags), np.flatnonzero(free.filters)
    low = _SHORTEST / trace.low_pass.rate
    duration = float(trace.stretches[-1].time[-1] - trace.stretches[0].time[0])
    last_step, share = np.zeros(2 * dof + 1), np.ones(2 * dof + 1)
    for _ in range(ROUNDS):
        problem = _linear(rows, timing.corrected(trace), timing, free)
        step, covariance = free.steps(problem, rows.size)
        # Steps of friction between two rows make steps of the timing alternate.
        alternates = -step * np.sign(last_step) > 0.5 * np.abs(last_step)
        share, last_step = np.where(alternates, 0.5 * share, share), step
        lags, constants, rate = np.split(timing.values + share * step, [dof, 2 * dof])
        # Torques are about linear in T², whose estimate may be negative.
        wide = timing.constants * (2 * constants - timing.constants)
        constants = np.sqrt(np.maximum(wide, 0.0))
        if free.pure:
            constants = lags
            covariance[np.ix_(dof + own, dof + own)] = covariance[np.ix_(own, own)]
        before, timing = timing, Timing(
            np.clip(lags, -_MOST[0], _MOST[0]),
            np.where(free.filters, np.clip(constants, low, _MOST[1]), 0.0),
            float(np.clip(rate[0], -_MOST[2], _MOST[2])), timing.about, covariance,
            rows.parameters(problem.x),
        )  # fmt: skip
        moved = np.abs(timing.values - before.values)
        if max(moved[:-1].max(), moved[-1] * duration) < HARMLESS:
            break
    return timing


def _linear(rows: TraceRows, trace: Trace, timing: Timing, free: FreeTiming) -> LinearProblem:
    """Least squares of the parameters, steps of the timing, and friction that warms up."""
    late, longer, growing = timing_slopes(trace, timing.p, rows.additions, timing.about)
    if free.pure:
        late = late + longer * free.filters[:, None]
    own = [of_own_drives(x[:, :, None]) for x in (late, longer)]
    steps = np.concatenate([*own, growing[:, :, None]], axis=2)[:, :, free.columns]
    part = rows.of_trace(trace)
    warm = _warm(rows, trace, timing) if free.clock else np.zeros((*part.tau.shape, 0))
    # Priors: friction that warms up may be as large as the torques.
    rms = np.sqrt(np.mean(warm**2, axis=(0, 1)))
    sizes = np.sqrt(np.mean(part.tau**2)) / np.where(rms > 0, rms, 1.0)  # zero for a resting drive
    return rows.problem(
        [part.with_columns(steps, warm)],
        np.concatenate([-timing.values[free.columns], np.zeros(len(sizes))]),
        np.concatenate([free.deviation, sizes]),
    )


def _warm(rows: TraceRows, trace: Trace, timing: Timing) -> ColumnsOfDrives:
    """(t − t_0) times each friction column of joints."""
    layout, (drives, columns) = trace.dynamics.layout, trace.pattern(rows.additions)
    friction = np.arange(len(layout.names))[layout.friction]
    which = np.flatnonzero(np.isin(columns, friction))

    def growing(w: SampleBlock) -> OfDrives:
        return (w.time - timing.about) * trace.entries(w, rows.additions)[which]

    return trace.columns(growing, (drives[which], np.arange(len(which))), len(which), 1)


def _filtered(rows: TraceRows, trace: Trace, timing: Timing, free: FreeTiming) -> Drives:
    """Drives whose torques passed a filter, beyond chance and confirmed far from reversals."""
    dof, row = len(timing.lags), 1.0 / trace.low_pass.rate
    kept = free.filters & (timing.constants > row)
    dead, errors = _dead_times(timing, np.ones(dof, bool))
    kept &= -dead < row + SURE * np.sqrt(np.diag(errors))
    kept &= _beyond_chance(timing, kept)
    if not kept.any():
        return kept
    reach = int(np.ceil(_TAIL * timing.constants.max() / row))
    away = [replace(run, weights=least_about(run.weights, reach)) for run in trace.stretches]
    trace = timing.corrected(replace(trace, stretches=tuple(away)))
    step, errors = free.steps(_linear(rows, trace, timing, free), rows.size)
    lags, constants = np.flatnonzero(kept), dof + np.flatnonzero(kept)
    of_constants, more = errors[np.ix_(constants, constants)], step[constants]
    T = timing.constants[kept]
    if exceeded(more, of_constants, CHANCE):
        return np.zeros(dof, bool)
    # v = T² of these rows alone, which is 0 for a delay; its slope by T is 2 T.
    slope = np.diag(2 * T)
    wide = exceeded(T**2 + 2 * T * more, slope @ of_constants @ slope, CHANCE)
    # Only behind a filter does the lag equal the T of the tails.
    dead = timing.lags[kept] + step[lags] - T
    variances = errors[np.ix_(lags, lags)] + timing.covariance[np.ix_(constants, constants)]
    known = np.all(np.sqrt(np.diag(variances)) < _KNOWN * T)
    pure = known and not exceeded(dead, variances, CHANCE)
    return kept if wide or pure else np.zeros(dof, bool)


def _beyond_chance(timing: Timing, chosen: Drives) -> Drives:
    """Which of the chosen drives have time constants beyond chance: all together, and each alone
    or by agreeing with the others."""
    drives, dof, seen = np.flatnonzero(chosen), len(chosen), np.zeros(len(chosen), bool)
    covariance = timing.covariance[np.ix_(dof + drives, dof + drives)]
    T, variance = timing.constants[drives], np.diag(covariance)
    if not len(drives) or not exceeded(T, covariance, 10**-DETECTED):
        return seen
    common = np.sum(T / variance) / np.sum(1 / variance)
    for k, drive in enumerate(drives.tolist()):
        own = variance[k].reshape(1, 1)
        alone = exceeded(T[[k]], own, 10**-DETECTED)
        seen[drive] = alone or not exceeded(T[[k]] - common, own, CHANCE)
    return seen


def _is_clock(rows: TraceRows, trace: Trace, timing: Timing) -> bool:
    """Whether lags grow beyond chance, and by the same rate for all drives."""
    if not exceeded(np.array([timing.rate]), timing.covariance[-1:, -1:], 10**-DETECTED):
        return False
    corrected, dof = timing.corrected(trace), len(timing.lags)
    late, _, growing = timing_slopes(corrected, timing.p, rows.additions, timing.about)
    lags, growths = (of_own_drives(x[:, :, None]) for x in (late, growing))
    beside = lags, _warm(rows, corrected, timing), growths
    problem = rows.problem([rows.of_trace(corrected).with_columns(*beside)])
    last = slice(problem.A.shape[1] - dof, None)
    return not exceeded(problem.x[last], problem.covariance(last), CHANCE)
