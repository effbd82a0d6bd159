"""The lag of a torque by its steps at reversals, where friction changes its sign.

In a torque that is δ late, the reversal at t_k is a step at t_k + δ. With u = t_n − t_k, the torque
less the model's without this step is

    r_n = o_k + J_k (α s(u − δ) + β u) + noise of level σ,

with the model's step J_k and s = ½ sgn. The offsets o_k of each reversal, and α and β of a drive,
absorb a wrong friction law. Given these,

    log L(δ) = Σ_k Σ_{u > δ} α J_k (r_n − o_k − β J_k u) / σ² + const

is a step function of δ whose steps lie at different phases between two samples for each reversal,
so δ is known far better than to a sample. Smooth errors, as of a friction law, load or gain, look
like a lag in other rows but not here. A fit excludes these rows, so their result enters it as the
prior of the lag.

Behind a first-order filter of time constant T, s is ½ − exp(−(u − δ)/T) after the step, and the lag
is δ + T. This is tried where samples next to reversals do not fit a sharp step, or fit a filter
better. Where they fit neither, as where friction yields before it slips, reversals give no lag.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import logsumexp

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.lag_columns import slope
from deltaid.estimation.additions import Addition, torques_of
from deltaid.estimation.problem import lengths
from deltaid.estimation.traces import Delay, Trace
from deltaid.levels import SURE
from deltaid.recording.windows import WINDOW, SampleBlock

# Samples to either side of a reversal that are used beyond the range of lags; and samples next to
# it that may have no weight, for masks exclude reversals.
_AROUND, _MASKED = 8, 3
# Half the range of the first search about the known lag, and of the second about its result [s].
_FAR, _NEAR = 0.012, 1.5e-3
# Largest misfit of samples next to a sharp step, and to one behind a filter, in steps.
_SHARP, _ROUGH = 0.08, 0.15
# Share of a sample by which the instants of a row's torque and position may differ.
_APART = 0.1
# Least number of steps, and least α.
_LEAST, _SEEN = 4, 0.3
# Samples next to a step, and standard deviations by which their scatter must exceed others'.
_NEXT, _EXCESS = 3, 4.0
# Range of time constants of filters in samples, and numbers of constants and lags that are tried.
_CONSTANTS, _GRID = (0.1, 4.0), (8, 61)
# Sum of squares of a step of 1 over the samples next to it, beside the best line; about.
_OWN = 0.35
_TINY = np.finfo(float).tiny

Around = Float[np.ndarray, "reversals around"]
Torques = Float[np.ndarray, "dof _"]  # each stretch as long as it is


class ReversalLags(NamedTuple):
    """Lags of the drives of one recording by reversals."""

    values: Delay  # [s]
    deviation: Delay  # their standard deviations; infinite where reversals give no lag [s]
    filtered: Bool[np.ndarray, " dof"]  # whether steps passed a filter
    doubtful: Bool[np.ndarray, " dof"]  # whether steps fit neither a sharp step nor a filter


@dataclass(frozen=True, eq=False)
class Steps:
    """Samples about the steps of one drive."""

    after: Around  # u, the time of each sample after its reversal [s]
    left: Around  # r, torques less those of the model without its steps
    jump: Float[np.ndarray, " reversals"]  # J of each reversal


@dataclass(frozen=True, eq=False)
class Local:
    """The residual of steps after least squares, and α."""

    left: Around
    step_share: float


def lags_of_reversals(
    trace: Trace, additions: Sequence[Addition], p: Parameters, known: Delay
) -> ReversalLags:
    """The lag of every drive by its reversals; `known` and p are lags [s] and parameters by all
    other rows."""
    period, still = 1.0 / trace.low_pass.rate, np.zeros(len(known), dtype=bool)
    lags = ReversalLags(known.copy(), np.full(len(known), np.inf), still, still.copy())
    far, near = _FAR + period, _NEAR + period
    held = trace.recording.repairs.hold or (False,) * len(known)  # interpolated, so no step is left
    modelled = [_modelled(trace, additions, p, stretch) for stretch in trace.stretches]
    for i, by_rows in enumerate(known.tolist()):
        if held[i]:
            continue
        # Lags by other rows may be something else, as motors that saturate: no lag is in reach too.
        middle, reach = 0.5 * by_rows, 0.5 * abs(by_rows) + far
        rough = located(_about_reversals(trace, modelled, i, middle, reach), middle, reach)
        if rough is None:
            continue
        steps = _about_reversals(trace, modelled, i, rough[0], near)
        place = located(steps, rough[0], near)
        if place is None:
            continue
        local = locally(steps, sharp(steps.after, place[0]))
        off = misfit(local, steps, place[0])
        at_once = off < _SHARP and is_abrupt(local, steps, place[0])
        at_once = at_once and (off > 0 or not is_rounded(local, steps, place[0], period))
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
    """Torques of the model along a stretch, and the part that is the drive's own friction."""
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
    """Mean and standard deviation of the steps' time after reversals, with a uniform prior within
    reach of the known lag. Repeated, since α, β and o_k depend on it. None where α is small."""
    if len(steps.jump) < _LEAST:
        return None
    residual = steps.left - steps.left.mean(axis=1, keepdims=True)
    place = _posterior(steps, residual, 1.0, float(np.var(residual)), known, reach)
    for _ in range(2):
        shape = sharp(steps.after, place[0])
        local = locally(steps, shape)
        if local.step_share < _SEEN:
            return None
        residual = local.left + local.step_share * steps.jump[:, None] * shape
        variance = float(np.mean(local.left**2))
        place = _posterior(steps, residual, local.step_share, variance, known, reach)
    return place


def sharp(after: Around, place: float) -> Around:
    return np.where(after > place, 0.5, -0.5)


def rounded(after: Around, place: float, constant: float) -> Around:
    """A step of size 1 behind a filter; `place` is δ + T."""
    return 0.5 - np.exp(-np.maximum(after - (place - constant), 0.0) / constant)


def is_rounded(local: Local, steps: Steps, place: float, period: float) -> bool:
    """Whether steps behind a filter of any time constant are more probable than sharp ones, all
    constants as probable before. A filtered step looks sharp in noise, and then seems earlier by up
    to its constant."""
    misses = np.array([
        min(
            float(np.sum(locally(steps, rounded(steps.after, place + late, T)).left ** 2))
            for late in np.linspace(0.0, T, _GRID[0])
        )
        for T in period * np.geomspace(*_CONSTANTS, _GRID[0])
    ])  # fmt: skip
    variance = max(float(misses.min()) / steps.left.size, _TINY)
    gain = (float(np.sum(local.left**2)) - misses) / (2 * variance)
    return bool(logsumexp(gain) > np.log(len(gain)))


def behind_filter(steps: Steps, known: float, period: float) -> tuple[float, float] | None:
    """Mean and standard deviation of the lag δ + T behind a first-order filter, with a uniform
    prior over a grid of lags and time constants."""
    constants = period * np.geomspace(*_CONSTANTS, _GRID[0])
    places = known + np.linspace(-_NEAR, _NEAR + constants[-1], _GRID[1])
    trials = [[locally(steps, rounded(steps.after, lag, T)) for T in constants] for lag in places]
    misses = np.array([[np.sum(trial.left**2) for trial in row] for row in trials])
    k, m = np.unravel_index(np.argmin(misses), misses.shape)
    best = trials[k][m]
    off = misfit(best, steps, float(places[k] - constants[m]))
    if best.step_share < _SEEN or off > _ROUGH:
        return None
    variance = max(float(misses[k, m]) / steps.left.size, _TINY)
    share = np.exp((misses[k, m] - misses) / (2 * variance)).sum(axis=1)
    share /= share.sum()
    mean = float(share @ places)
    scatter = np.sqrt(share @ (places - mean) ** 2)
    return mean, float(np.linalg.norm([scatter, places[1] - places[0], off * period]))


def misfit(local: Local, steps: Steps, place: float) -> float:
    """Excess misfit of samples next to steps over that of others, as a share of the step; zero
    where it may be chance."""
    period = float(np.median(np.diff(steps.after, axis=1)))
    adjacent = np.abs(steps.after - place) < _NEXT * period
    near, far = np.mean(local.left[adjacent] ** 2), np.mean(local.left[~adjacent] ** 2)
    if near <= (1 + _EXCESS * np.sqrt(2 / max(np.count_nonzero(adjacent), 1))) * far:
        return 0.0
    return float(np.sqrt((near - far) / np.mean(steps.jump**2)) / local.step_share)


def is_abrupt(local: Local, steps: Steps, place: float) -> bool:
    """Whether the few samples next to a step still fit a step beside a slope of their own.

    Friction that yields before it slips changes over many samples: from nearby, it is a slope.
    """
    k = int(np.argmin(np.abs(steps.after.mean(axis=0) - place)))
    part = slice(max(0, k - _NEXT), k + _NEXT + 1)
    few = Steps(steps.after[:, part], steps.left[:, part], steps.jump)
    near = locally(few, sharp(few.after, place))
    scatter = np.sqrt(np.mean(near.left**2) / (_OWN * np.sum(steps.jump**2)))
    return local.step_share - near.step_share < max(0.5 * local.step_share, SURE * float(scatter))


def locally(steps: Steps, shape: Around) -> Local:
    """Least squares of o_k, α and β for a shape s of the step."""
    A = np.stack([shape, steps.after], axis=2) * steps.jump[:, None, None]
    A, b = (values - values.mean(axis=1, keepdims=True) for values in (A, steps.left))
    size = lengths(A.reshape(-1, 2))
    x = np.linalg.lstsq(A.reshape(-1, 2) / size, b.ravel(), rcond=None)[0] / size
    return Local(b - A @ x, float(x[0]))


def _posterior(
    steps: Steps, r: Around, step_share: float, variance: float, known: float, reach: float
) -> tuple[float, float]:
    """Mean and standard deviation of δ by log L of the residuals r without o_k and β; `step_share`
    is α, the prior is uniform within reach of the known lag."""
    gain = step_share * steps.jump[:, None] * r / max(variance, _TINY)
    order = np.argsort(steps.after.ravel())
    times, gain = steps.after.ravel()[order], gain.ravel()[order]
    inner = np.abs(times - known) < reach
    edges = np.concatenate([[known - reach], times[inner], [known + reach]])
    # Samples beyond reach add the same to all.
    log = np.append(np.cumsum(gain[inner][::-1])[::-1], 0.0)
    width, middle = np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    share = width * np.exp(log - log.max())
    share /= share.sum()
    mean = float(share @ middle)
    return mean, float(np.sqrt(share @ ((middle - mean) ** 2 + width**2 / 12)))
