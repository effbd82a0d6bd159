"""Where in time torques step, given by how much: at once, behind a filter, or not at all.

What is left of the samples about a step of size J_k,

    r_n = o_k + J_k (α s(u_n) + β u_n) + noise of level σ,

with s a step from −½ to ½ at the place looked for, or ½ − exp(−(u − δ)/T) behind a filter; o_k, α
and β follow by least squares.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# Steps at least, and the least part of their size that must be seen.
_LEAST, _SEEN = 4, 0.3
# About a lag that is found filters are tried so far [s].
_NEAR = 1.5e-3
# Samples next to a step, and how many standard deviations their scatter may exceed others'.
_NEXT, _EXCESS = 3, 4.0
# Time constants of filters in samples, and how many of these and of lags are tried.
_CONSTANTS, _GRID = (0.1, 4.0), (8, 61)
# How much of a step may be missing next to it, beside so many standard deviations; sum of squares
# of a step of 1 over these samples that is none of a slope.
_MOSTLY, _SURE, _OWN = 0.5, 3.0, 0.35
# How far samples next to a step behind a filter may be from the model, in steps.
_ROUGH = 0.15

Around = Float[np.ndarray, "reversals around"]


@dataclass(frozen=True, eq=False)
class Steps:
    """Samples about the steps of one drive.

    Attributes:
        after: u, the time of each sample after its reversal [s].
        left: torques less those of the model without its step.
        jump: J of each reversal.
    """

    after: Around
    left: Around
    jump: Float[np.ndarray, " reversals"]


@dataclass(frozen=True, eq=False)
class Local:
    """Steps without o_k, α and β.

    Attributes:
        left: what remains.
        seen: α.
    """

    left: Around
    seen: float


def located(steps: Steps, known: float, reach: float) -> tuple[float, float] | None:
    """Mean and standard deviation of where steps are, equally likely within reach before.

    Twice, since α, β and o_k follow from the place. None where too little of a step is seen.
    """
    if len(steps.jump) < _LEAST:
        return None
    left, jump = steps.left - steps.left.mean(axis=1, keepdims=True), steps.jump
    place = _posterior(steps.after, left, jump, float(np.var(left)), known, reach)
    for _ in range(2):
        shape = sharp(steps.after, place[0])
        local = locally(steps, shape)
        if local.seen < _SEEN:
            return None
        left = local.left + local.seen * jump[:, None] * shape
        variance = float(np.mean(local.left**2))
        place = _posterior(steps.after, left, local.seen * jump, variance, known, reach)
    return place


def sharp(after: Around, place: float) -> Around:
    """A step of size 1."""
    return np.where(after > place, 0.5, -0.5)


def rounded(after: Around, place: float, constant: float) -> Around:
    """A step of size 1 behind a filter; `place` counts its time constant in."""
    since = np.maximum(after - (place - constant), 0.0)
    return 0.5 - np.exp(-since / constant)


def behind_filter(steps: Steps, known: float, period: float) -> tuple[float, float] | None:
    """Mean and standard deviation of the lag where a first-order filter rounds the steps.

    Over a grid of lags and time constants, all as likely before.
    """
    constants = period * np.geomspace(*_CONSTANTS, _GRID[0])
    places = known + np.linspace(-_NEAR, _NEAR + constants[-1], _GRID[1])
    misses = np.zeros((len(places), len(constants)))
    for k, place in enumerate(places):
        for m, constant in enumerate(constants):
            local = locally(steps, rounded(steps.after, place, constant))
            misses[k, m] = np.sum(local.left**2)
    k, m = np.unravel_index(np.argmin(misses), misses.shape)
    best = locally(steps, rounded(steps.after, places[k], constants[m]))
    off = misfit(best, steps, float(places[k] - constants[m]))
    if best.seen < _SEEN or off > _ROUGH:
        return None
    variance = max(float(misses[k, m]) / steps.left.size, np.finfo(float).tiny)
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
    beside = np.abs(steps.after - place) < _NEXT * period
    near, far = np.mean(local.left[beside] ** 2), np.mean(local.left[~beside] ** 2)
    if near <= (1 + _EXCESS * np.sqrt(2 / max(np.count_nonzero(beside), 1))) * far:
        return 0.0
    return float(np.sqrt((near - far) / np.mean(steps.jump**2)) / local.seen)


def is_abrupt(local: Local, steps: Steps, place: float) -> bool:
    """Whether a step is still seen in the few samples next to it, beside a slope of their own.

    Friction that yields before it slips turns over many samples. A step found far and wide is then
    a slope nearby.
    """
    at = int(np.argmin(np.abs(steps.after.mean(axis=0) - place)))
    part = slice(max(0, at - _NEXT), at + _NEXT + 1)
    few = Steps(steps.after[:, part], steps.left[:, part], steps.jump)
    near = locally(few, sharp(few.after, place))
    # Of a step and a slope: so much of a step is none of the slope's.
    scatter = np.sqrt(np.mean(near.left**2) / (_OWN * np.sum(steps.jump**2)))
    return local.seen - near.seen < max(_MOSTLY * local.seen, _SURE * float(scatter))


def locally(steps: Steps, shape: Around) -> Local:
    """Least squares of o_k, α and β for some shape of the step."""
    shapes = np.stack([shape, steps.after]) * steps.jump[:, None]
    centred = shapes - shapes.mean(axis=2, keepdims=True)
    left = steps.left - steps.left.mean(axis=1, keepdims=True)
    flat = centred.reshape(2, -1)
    size = np.maximum(np.linalg.norm(flat, axis=1), np.finfo(float).tiny)
    weights, *_ = np.linalg.lstsq((flat / size[:, None]).T, left.ravel(), rcond=None)
    left = left - np.tensordot(weights / size, centred, 1)
    return Local(left, float(weights[0] / size[0]))


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
