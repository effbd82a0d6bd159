"""The lag of a torque as its steps show it, which friction makes where a drive turns round.

A reversal at t_k shows in a torque that is δ late as a step at t_k + δ. With u = t_n − t_k and what
the model's torques about it but for that step, the residual is

    r_n = o_k + J_k (α s(u − δ) + β u) + noise of level σ,

J_k the model's step and s = ½ sgn; α and β, the same for all reversals of a drive, and o_k are what
a wrong friction law would leave here. Given these,

    log L(δ) = Σ_k Σ_{u > δ} α J_k (r_n − o_k − β J_k u) / σ² + const

is a staircase whose stairs lie at other phases between two samples for each reversal, so δ is known
far better than to a sample, and better than by other rows. What varies smoothly, as a wrong
friction law, load or gain does, looks like a lag elsewhere but not here. A fit excludes these rows,
so their result is added to it as the prior of the lag.

Behind a first-order filter of time constant T, s is ½ − exp(−(u − δ)/T) after the step, and the lag
is δ + T; that is tried where the samples next to reversals are farther from a step than others, or
show none. Where they still are, as where friction yields before it slips, nothing is reported.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.lag_columns import slope
from deltaid.estimation.additions import Addition, torques_of
from deltaid.estimation.problem import lengths
from deltaid.estimation.traces import Delay, Trace
from deltaid.levels import SURE
from deltaid.recording.windows import WINDOW, SampleBlock

# Samples to either side of a reversal that are used beyond what may be lagged by; those nearer
# than the second number may not count because the joint turns round.
_AROUND, _MASKED = 8, 3
# Half the range of the search about the known lag, and then about the located one [s].
_FAR, _NEAR = 0.012, 1.5e-3
# How far samples next to a step, and to one behind a filter, may be from the model, in steps.
_SHARP, _ROUGH = 0.08, 0.15
# Share of a sample by which torque and position of a row may be apart, whatever is recorded.
_APART = 0.1
# Steps at least, and the least part of their size that must be observed.
_LEAST, _SEEN = 4, 0.3
# Samples next to a step, and how many standard deviations their scatter may exceed others'.
_NEXT, _EXCESS = 3, 4.0
# Time constants of filters in samples, and how many of these and of lags are tried.
_CONSTANTS, _GRID = (0.1, 4.0), (8, 61)
# Sum of squares of a step of 1 over these samples that is none of a slope.
_OWN = 0.35
_TINY = np.finfo(float).tiny

Around = Float[np.ndarray, "reversals around"]
Torques = Float[np.ndarray, "dof _"]  # each stretch as long as it is


class ReversalLags(NamedTuple):
    """Lags of the drives of one recording as their reversals show them."""

    values: Delay  # [s]
    deviation: Delay  # their standard deviations; infinite where reversals show none [s]
    filtered: Bool[np.ndarray, " dof"]  # whether the steps went through a filter
    # whether there are steps that friction and a filter do not explain
    doubtful: Bool[np.ndarray, " dof"]


@dataclass(frozen=True, eq=False)
class Steps:
    """Samples about the steps of one drive."""

    after: Around  # u, the time of each sample after its reversal [s]
    left: Around  # r, torques less those of the model without its step
    jump: Float[np.ndarray, " reversals"]  # J of each reversal


@dataclass(frozen=True, eq=False)
class Local:
    """What remains of steps without o_k, α and β; and α."""

    left: Around
    seen: float


def lags_of_reversals(
    trace: Trace, additions: Sequence[Addition], p: Parameters, known: Delay
) -> ReversalLags:
    """The lag of every drive by its reversals, for those by all other rows, `known` [s], and the
    parameters of robot and additions that go with them."""
    period, still = 1.0 / trace.low_pass.rate, np.zeros(len(known), dtype=bool)
    lags = ReversalLags(known.copy(), np.full(len(known), np.inf), still, still.copy())
    far, near = _FAR + period, _NEAR + period
    held = trace.recording.repairs.hold or (False,) * len(known)  # interpolated, so no step is left
    modelled = [_modelled(trace, additions, p, stretch) for stretch in trace.stretches]
    for i, start in enumerate(known.tolist()):
        rough = located(_about_reversals(trace, modelled, i, start, far), start, far)
        if held[i] or rough is None:
            continue
        steps = _about_reversals(trace, modelled, i, rough[0], near)
        place = located(steps, rough[0], near)
        if place is None:
            continue
        local = locally(steps, sharp(steps.after, place[0]))
        off = misfit(local, steps, place[0])
        at_once = off < _SHARP and is_abrupt(local, steps, place[0])
        if not at_once and (place := behind_filter(steps, rough[0], period)) is None:
            lags.doubtful[i] = True
            continue
        apart = period * max(_APART / np.sqrt(len(steps.jump)), off * at_once)
        lags.values[i], lags.deviation[i] = place[0], float(np.hypot(place[1], apart))
        lags.filtered[i] = not at_once
    return lags


def _modelled(
    trace: Trace, additions: Sequence[Addition], p: Parameters, stretch: SampleBlock
) -> tuple[Torques, Torques]:
    """Torques of the model along a stretch, and what of them is friction of the drive itself."""
    layout, names = trace.dynamics.layout, trace.dynamics.robot.drives
    drives, columns = trace.pattern(additions)
    owners = {k: t.owner for k, t in enumerate(layout.parameters) if t.kind == "friction"}
    pairs = zip(drives.tolist(), columns.tolist(), strict=True)
    own = np.array([owners.get(k) == names[i] for i, k in pairs])
    parts = list[tuple[Torques, Torques]]()
    for first in range(0, len(stretch.time), WINDOW):
        values = trace.entries(stretch.part(slice(first, first + WINDOW)), additions)
        tau = torques_of((drives, columns), len(names), values, p)
        friction = torques_of((drives[own], columns[own]), len(names), values[own], p)
        parts.append((tau, friction))
    tau, friction = (np.hstack(part) for part in zip(*parts, strict=True))
    return tau, friction


def _about_reversals(
    trace: Trace,
    modelled: Sequence[tuple[Torques, Torques]],
    drive: int,
    known: float,
    reach: float,
) -> Steps:
    """Samples of a drive near those of its reversals that lie well apart from others."""
    rate, parts = trace.low_pass.rate, list[tuple[np.ndarray, ...]]()
    late, width = round(known * rate), int(np.ceil(reach * rate)) + _AROUND
    offsets = np.arange(-width + 1, width + 1)
    for stretch, (tau, friction) in zip(trace.stretches, modelled, strict=True):
        speed, counts = stretch.qd[:, drive], stretch.weights[:, drive] > 0
        before = np.flatnonzero(speed[:-1] * speed[1:] < 0)
        first, last = width + max(0, -late), len(speed) - 1 - width - max(0, late)
        sure = (before >= first) & (before <= last)
        sure &= np.diff(before, prepend=-np.inf) > 2 * width
        sure &= np.diff(before, append=np.inf) > 2 * width
        before = before[sure]
        for shift in (0, late):  # where the motion, and where the torque is read
            off = offsets[(offsets + shift <= -_MASKED) | (offsets + shift > _MASKED)]
            before = before[np.all(counts[before[:, None] + off + shift], axis=1)]
        rows = before[:, None] + offsets
        share = speed[before] / (speed[before] - speed[before + 1])
        jump = friction[drive, before + 1] - friction[drive, before]
        smooth = tau[drive, rows] - 0.5 * jump[:, None] * np.where(offsets > 0, 1.0, -1.0)
        smooth += slope(smooth) * (late - known * rate)  # at the instant of each torque
        residual = stretch.tau[rows + late, drive] - smooth
        parts.append(((offsets + late - share[:, None]) / rate, residual, jump))
    return Steps(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def located(steps: Steps, known: float, reach: float) -> tuple[float, float] | None:
    """Mean and standard deviation of where steps are, equally likely within reach before.

    Twice, since α, β and o_k follow from the place. None where too little of a step is observed.
    """
    if len(steps.jump) < _LEAST:
        return None
    residual = steps.left - steps.left.mean(axis=1, keepdims=True)
    place = _posterior(steps, residual, 1.0, float(np.var(residual)), known, reach)
    for _ in range(2):
        shape = sharp(steps.after, place[0])
        local = locally(steps, shape)
        if local.seen < _SEEN:
            return None
        residual = local.left + local.seen * steps.jump[:, None] * shape
        variance = float(np.mean(local.left**2))
        place = _posterior(steps, residual, local.seen, variance, known, reach)
    return place


def sharp(after: Around, place: float) -> Around:
    return np.where(after > place, 0.5, -0.5)


def rounded(after: Around, place: float, constant: float) -> Around:
    """A step of size 1 behind a filter; `place` counts its time constant in."""
    return 0.5 - np.exp(-np.maximum(after - (place - constant), 0.0) / constant)


def behind_filter(steps: Steps, known: float, period: float) -> tuple[float, float] | None:
    """Mean and standard deviation of the lag where a first-order filter rounds the steps.

    Over a grid of lags and time constants, all as likely before.
    """
    constants = period * np.geomspace(*_CONSTANTS, _GRID[0])
    places = known + np.linspace(-_NEAR, _NEAR + constants[-1], _GRID[1])
    trials = [[locally(steps, rounded(steps.after, lag, T)) for T in constants] for lag in places]
    misses = np.array([[np.sum(trial.left**2) for trial in row] for row in trials])
    k, m = np.unravel_index(np.argmin(misses), misses.shape)
    best = trials[k][m]
    off = misfit(best, steps, float(places[k] - constants[m]))
    if best.seen < _SEEN or off > _ROUGH:
        return None
    variance = max(float(misses[k, m]) / steps.left.size, _TINY)
    share = np.exp((misses[k, m] - misses) / (2 * variance)).sum(axis=1)
    share /= share.sum()
    mean = float(share @ places)
    scatter = np.sqrt(share @ (places - mean) ** 2)
    return mean, float(np.linalg.norm([scatter, places[1] - places[0], off * period]))


def misfit(local: Local, steps: Steps, place: float) -> float:
    """By how much samples next to steps are farther from the model than others, in steps.

    Zero where that may be chance.
    """
    period = float(np.median(np.diff(steps.after, axis=1)))
    adjacent = np.abs(steps.after - place) < _NEXT * period
    near, far = np.mean(local.left[adjacent] ** 2), np.mean(local.left[~adjacent] ** 2)
    if near <= (1 + _EXCESS * np.sqrt(2 / max(np.count_nonzero(adjacent), 1))) * far:
        return 0.0
    return float(np.sqrt((near - far) / np.mean(steps.jump**2)) / local.seen)


def is_abrupt(local: Local, steps: Steps, place: float) -> bool:
    """Whether a step remains in the few samples next to it, fitted with a slope of their own.

    Friction that yields before it slips turns over many samples: from nearby, a slope.
    """
    k = int(np.argmin(np.abs(steps.after.mean(axis=0) - place)))
    part = slice(max(0, k - _NEXT), k + _NEXT + 1)
    few = Steps(steps.after[:, part], steps.left[:, part], steps.jump)
    near = locally(few, sharp(few.after, place))
    # Of a step and a slope: so much of a step is none of the slope's.
    scatter = np.sqrt(np.mean(near.left**2) / (_OWN * np.sum(steps.jump**2)))
    return local.seen - near.seen < max(0.5 * local.seen, SURE * float(scatter))


def locally(steps: Steps, shape: Around) -> Local:
    """Least squares of o_k, α and β for some shape of the step."""
    A = np.stack([shape, steps.after], axis=2) * steps.jump[:, None, None]
    A, b = (values - values.mean(axis=1, keepdims=True) for values in (A, steps.left))
    size = lengths(A.reshape(-1, 2))
    x = np.linalg.lstsq(A.reshape(-1, 2) / size, b.ravel(), rcond=None)[0] / size
    return Local(b - A @ x, float(x[0]))


def _posterior(
    steps: Steps, r: Around, seen: float, variance: float, known: float, reach: float
) -> tuple[float, float]:
    """Mean and standard deviation of the place of the step, equally likely within reach before, by
    what is left of its share that is seen."""
    gain = seen * steps.jump[:, None] * r / max(variance, _TINY)
    order = np.argsort(steps.after.ravel())
    times, gain = steps.after.ravel()[order], gain.ravel()[order]
    inner = np.abs(times - known) < reach
    edges = np.concatenate([[known - reach], times[inner], [known + reach]])
    # Beyond the last sample within reach the sum is the same for all.
    log = np.append(np.cumsum(gain[inner][::-1])[::-1], 0.0)
    width, middle = np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    share = width * np.exp(log - log.max())
    share /= share.sum()
    mean = float(share @ middle)
    return mean, float(np.sqrt(share @ ((middle - mean) ** 2 + width**2 / 12)))
