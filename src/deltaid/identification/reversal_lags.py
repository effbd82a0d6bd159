"""The lag of a torque as its steps tell it, which friction makes where a drive turns round.

A reversal at t_k shows in a torque that is δ late as a step at t_k + δ. With u = t_n − t_k and what
the model makes of the samples about it but for that step, what is left of them is

    r_n = o_k + J_k (α ½ sgn(u − δ) + β u) + noise of level σ,

J_k the model's step; α and β, the same for all reversals of a drive, and o_k are what a wrong
friction law would leave here. Given these,

    log L(δ) = Σ_k Σ_{u > δ} α J_k (r_n − o_k − β J_k u) / σ² + const

is a staircase whose stairs lie at other phases between two samples for each reversal, so δ is known
far better than to a sample, and to a part of what other rows tell. And nothing that varies smoothly
gets in: a wrong friction law, load or gain, which all look like a lag elsewhere, do not here. A fit
leaves these rows out, so what they tell is added to it as the prior of the lag.

Behind a first-order filter of time constant T, ½ sgn is ½ − exp(−(u − δ)/T) after the step, and the
lag is δ + T; that is tried where the samples next to reversals are farther from a step than others.
Where they still are, as where friction yields before it slips, nothing is told.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.identification.additions import Addition
from deltaid.identification.traces import Delay, Trace
from deltaid.recording.windows import WINDOW, Samples

# Samples to either side of a reversal that are looked at beyond what may be lagged by; those nearer
# than the second number may not count because the joint turns round.
_AROUND, _MASKED = 8, 3
# Reversals of a drive at least, and the least part of its friction that must be seen to turn.
_LEAST, _SEEN = 4, 0.3
# A lag is looked for so far around the known one, and then around the one that is found [s].
_FAR, _NEAR = 0.012, 1.5e-3
# Samples next to a step, and how many standard deviations their scatter may exceed others'.
_NEXT, _EXCESS = 3, 4.0
# Time constants of filters in samples, and how many of these and of lags are tried.
_CONSTANTS, _GRID = (0.1, 4.0), (8, 61)
# How far samples next to a step, and behind a filter, may be from the model, in steps.
_SHARP, _ROUGH = 0.08, 0.15
# Share of a sample by which torque and position of a row may be apart, whatever is recorded.
_APART = 0.1

Torques = Float[np.ndarray, "_ dof"]  # each stretch as long as it is
Around = Float[np.ndarray, "reversals around"]


@dataclass(frozen=True, eq=False)
class _Steps:
    """One drive near its reversals.

    Attributes:
        after: u, the time of each sample after its reversal [s].
        left: torques less those of the model without its step.
        jump: J of each reversal.
    """

    after: Around
    left: Around
    jump: Float[np.ndarray, " reversals"]


@dataclass(frozen=True, eq=False)
class Told:
    """Lags of the drives of one recording as their reversals tell them.

    Attributes:
        values: [s].
        deviation: their standard deviations; infinite where nothing is told [s].
        filtered: whether the steps went through a filter.
        doubtful: whether steps are seen, but none that friction and a filter explain.
    """

    values: Delay
    deviation: Delay
    filtered: Bool[np.ndarray, " dof"]
    doubtful: Bool[np.ndarray, " dof"]


def lags_of_reversals(
    trace: Trace, additions: Sequence[Addition], p: Parameters, known: Delay
) -> Told:
    """The lag of every drive by its reversals.

    Args:
        trace: a recording, reversals left out.
        additions: columns beside those of the robot.
        p: parameters of both, which go with the known lags.
        known: lags by the other rows [s].
    """
    period = 1.0 / trace.low_pass.rate
    still = np.zeros(len(known), dtype=bool)
    found = Told(known.copy(), np.full(len(known), np.inf), still, still.copy())
    modelled = [_modelled(trace, additions, p, one) for one in trace.stretches]
    for i, start in enumerate(known.tolist()):
        rough = _about_reversals(trace, modelled, i, start, _FAR + period)
        place = _located(rough, start, _FAR + period)
        if place is None:
            continue
        steps = _about_reversals(trace, modelled, i, place[0], _NEAR + period)
        near = _located(steps, place[0], _NEAR + period)
        if near is None:
            continue
        misfit = _misfit(_locally(steps, _sharp(steps.after, near[0])), steps, near[0])
        sharp = misfit < _SHARP
        if not sharp:
            near = _behind_filter(steps, place[0], period)
            if near is None:
                found.doubtful[i] = True
                continue
        apart = period * max(_APART / np.sqrt(len(steps.jump)), misfit * sharp)
        found.values[i], found.deviation[i] = near[0], float(np.hypot(near[1], apart))
        found.filtered[i] = not sharp
    return found


def _modelled(
    trace: Trace, additions: Sequence[Addition], p: Parameters, stretch: Samples
) -> tuple[Torques, Torques]:
    """Torques of the model along a stretch, and what of them is friction of the drive itself."""
    dynamics = trace.dynamics
    drives, columns = trace.pattern(additions)
    parameters, names = dynamics.layout.parameters, dynamics.robot.drives
    own = np.array(
        [
            k < len(parameters)
            and parameters[k].kind == "friction"
            and parameters[k].owner == names[i]
            for i, k in zip(drives, columns, strict=True)
        ]
    )
    tau, friction = np.zeros_like(stretch.tau), np.zeros_like(stretch.tau)
    for first in range(0, len(stretch.time), WINDOW):
        part = slice(first, first + WINDOW)
        values = trace.entries(stretch.part(part), additions) * p[columns, None]
        for i in range(dynamics.dof):
            tau[part, i] = values[drives == i].sum(axis=0)
            friction[part, i] = values[(drives == i) & own].sum(axis=0)
    return tau, friction


def _about_reversals(
    trace: Trace,
    modelled: Sequence[tuple[Torques, Torques]],
    drive: int,
    known: float,
    reach: float,
) -> _Steps:
    """What is seen of a drive near those of its reversals that lie well apart from others."""
    rate, parts = trace.low_pass.rate, list[_Steps]()
    late, width = round(known * rate), int(np.ceil(reach * rate)) + _AROUND
    at = np.arange(-width + 1, width + 1)
    for stretch, (tau, friction) in zip(trace.stretches, modelled, strict=True):
        speed, counts = stretch.qd[:, drive], stretch.weights[:, drive] > 0
        before = np.flatnonzero(speed[:-1] * speed[1:] < 0)
        first, last = width + max(0, -late), len(speed) - 1 - width - max(0, late)
        sure = (before >= first) & (before <= last)
        sure &= np.diff(before, prepend=-np.inf) > 2 * width
        sure &= np.diff(before, append=np.inf) > 2 * width
        before = before[sure]
        rows = before[:, None] + at
        sure = np.ones(len(rows), dtype=bool)
        for by in (0, late):  # where the motion, and where the torque is read
            off = (at + by <= -_MASKED) | (at + by > _MASKED)
            sure &= np.all(counts[rows + by][:, off], axis=1)
        before, rows = before[sure], rows[sure]
        share = speed[before] / (speed[before] - speed[before + 1])
        jump = friction[before + 1, drive] - friction[before, drive]
        smooth = tau[rows, drive] - 0.5 * jump[:, None] * np.where(at > 0, 1.0, -1.0)
        if len(rows):  # the model at the instant of each torque
            smooth += np.gradient(smooth, axis=1) * (late - known * rate)
        left = stretch.tau[rows + late, drive] - smooth
        parts.append(_Steps((at + late - share[:, None]) / rate, left, jump))
    return _Steps(
        np.concatenate([one.after for one in parts]),
        np.concatenate([one.left for one in parts]),
        np.concatenate([one.jump for one in parts]),
    )


def _located(steps: _Steps, known: float, reach: float) -> tuple[float, float] | None:
    """Mean and standard deviation of where steps are, equally likely within reach before.

    Twice, since α, β and o_k follow from the place. None where too little of a step is seen.
    """
    if len(steps.jump) < _LEAST:
        return None
    left, jump = steps.left - steps.left.mean(axis=1, keepdims=True), steps.jump
    place = _posterior(steps.after, left, jump, float(np.var(left)), known, reach)
    for _ in range(2):
        shape = _sharp(steps.after, place[0])
        local = _locally(steps, shape)
        if local.seen < _SEEN:
            return None
        left = local.left + local.seen * jump[:, None] * shape
        variance = float(np.mean(local.left**2))
        place = _posterior(steps.after, left, local.seen * jump, variance, known, reach)
    return place


def _sharp(after: Around, place: float) -> Around:
    """A step of size 1."""
    return np.where(after > place, 0.5, -0.5)


def _rounded(after: Around, place: float, constant: float) -> Around:
    """A step of size 1 behind a filter; `place` counts its time constant in."""
    since = np.maximum(after - (place - constant), 0.0)
    return 0.5 - np.exp(-since / constant)


def _behind_filter(steps: _Steps, known: float, period: float) -> tuple[float, float] | None:
    """Mean and standard deviation of the lag where a first-order filter rounds the steps.

    Over a grid of lags and time constants, all as likely before.
    """
    constants = period * np.geomspace(*_CONSTANTS, _GRID[0])
    places = known + np.linspace(-_NEAR, _NEAR + constants[-1], _GRID[1])
    misses = np.zeros((len(places), len(constants)))
    for k, place in enumerate(places):
        for m, constant in enumerate(constants):
            local = _locally(steps, _rounded(steps.after, place, constant))
            misses[k, m] = np.sum(local.left**2)
    k, m = np.unravel_index(np.argmin(misses), misses.shape)
    best = _locally(steps, _rounded(steps.after, places[k], constants[m]))
    misfit = _misfit(best, steps, float(places[k] - constants[m]))
    if best.seen < _SEEN or misfit > _ROUGH:
        return None
    variance = max(float(misses[k, m]) / steps.left.size, np.finfo(float).tiny)
    share = np.exp((misses[k, m] - misses) / (2 * variance)).sum(axis=1)
    share /= share.sum()
    mean = float(share @ places)
    scatter = np.sqrt(share @ (places - mean) ** 2)
    return mean, float(np.linalg.norm([scatter, places[1] - places[0], misfit * period]))


def _misfit(local: "_Local", steps: _Steps, place: float) -> float:
    """By how much samples next to steps are farther from the model than others, in steps.

    Zero where that may be chance.
    """
    period = float(np.median(np.diff(steps.after, axis=1)))
    beside = np.abs(steps.after - place) < _NEXT * period
    near, far = np.mean(local.left[beside] ** 2), np.mean(local.left[~beside] ** 2)
    if near <= (1 + _EXCESS * np.sqrt(2 / max(np.count_nonzero(beside), 1))) * far:
        return 0.0
    return float(np.sqrt((near - far) / np.mean(steps.jump**2)) / local.seen)


@dataclass(frozen=True, eq=False)
class _Local:
    """Steps without o_k, α and β.

    Attributes:
        left: what remains.
        seen: α.
    """

    left: Around
    seen: float


def _locally(steps: _Steps, shape: Around) -> _Local:
    """Least squares of o_k, α and β for some shape of the step."""
    shapes = np.stack([shape, steps.after]) * steps.jump[:, None]
    centred = shapes - shapes.mean(axis=2, keepdims=True)
    left = steps.left - steps.left.mean(axis=1, keepdims=True)
    flat = centred.reshape(2, -1)
    size = np.maximum(np.linalg.norm(flat, axis=1), np.finfo(float).tiny)
    weights, *_ = np.linalg.lstsq((flat / size[:, None]).T, left.ravel(), rcond=None)
    left = left - np.tensordot(weights / size, centred, 1)
    return _Local(left, float(weights[0] / size[0]))


def _posterior(
    after: Around,
    left: Around,
    jump: Float[np.ndarray, " reversals"],
    variance: float,
    known: float,
    reach: float,
) -> tuple[float, float]:
    """Mean and standard deviation of the place of the step, equally likely within reach before."""
    gain = (jump[:, None] * left / max(variance, np.finfo(float).tiny)).ravel()
    order = np.argsort(after.ravel())
    times, gain = after.ravel()[order], gain[order]
    inner = np.abs(times - known) < reach
    edges = np.concatenate([[known - reach], times[inner], [known + reach]])
    # Beyond the last sample within reach the sum is the same for all.
    log = np.append(np.cumsum(gain[inner][::-1])[::-1], 0.0)
    width, middle = np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    share = width * np.exp(log - log.max())
    share /= share.sum()
    mean = float(share @ middle)
    return mean, float(np.sqrt(share @ ((middle - mean) ** 2 + width**2 / 12)))
