"""Steps of a drive's torque at its reversals: how late they are, and what blurred them.

In a torque that is δ late, the reversal at t_k is a step at t_k + δ. With u = t_n − t_k, the torque
less the model's without this step is

    r_n = o_k + J_k (α s(u − δ) + β u) + noise of level σ,

with the model's step J_k and s = ½ sgn. The offsets o_k of each reversal, and α and β of a drive,
absorb a wrong friction law. Given these,

    log L(δ) = Σ_k Σ_{u > δ} α J_k (r_n − o_k − β J_k u) / σ² + const

is a step function of δ whose steps lie at different phases between two samples for each reversal,
so δ is known far better than to a sample.

Behind a first-order filter of time constant T, s is ½ − exp(−(u − δ)/T) after the step, and the lag
is δ + T. This is tried where samples next to reversals do not fit a sharp step, or fit a filter
better. Averages over a time and filters of second order blur steps in other ways, which are tried
as well. Where steps fit none of these, as where friction yields before it slips, they give no lag.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from deltaid.estimation.problem import lengths
from deltaid.levels import NEGLIGIBLE, SURE

# Half the range in which a step's lag is searched about a rough one [s].
NEAR = 1.5e-3
# Largest misfit of samples next to a step behind a filter, in steps.
_ROUGH = 0.15
# Least number of steps, and least α.
_LEAST, _SEEN = 4, 0.3
# Samples next to a step, and standard deviations by which their scatter must exceed others'.
_NEXT, _EXCESS = 3, 4.0
# Range of time constants of filters in samples, after which blurs begin, and numbers of constants
# and lags that are tried.
_CONSTANTS, _GRID = (0.1, 4.0), (8, 61)
# Longest time over which torques are averaged, or lag of a filter of second order [s].
LONGEST = 0.016
# Sum of squares of a step of 1 over the samples next to it, beside the best line; about.
_OWN = 0.35
_TINY = np.finfo(float).tiny

Around = Float[np.ndarray, "reversals around"]
# A lag or another time, or those of several trials [s].
Times = float | Float[np.ndarray, "..."]
Shapes = Float[np.ndarray, "... reversals around"]
# A step of size 1 after reversals, by its lag and a time of its own.
Shape = Callable[[Around, Times, Times], Shapes]


@dataclass(frozen=True, eq=False)
class Steps:
    """Samples about the steps of one drive."""

    after: Around  # u, the time of each sample after its reversal [s]
    left: Around  # r, torques less those of the model without its steps
    jump: Float[np.ndarray, " reversals"]  # J of each reversal
    acceleration: Float[np.ndarray, " reversals"]  # its size at each reversal [rad/s² or m/s²]


@dataclass(frozen=True, eq=False)
class Local:
    """The residual of steps after least squares, and α."""

    left: Around
    step_share: float


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


def rounded(after: Around, place: Times, constant: Times) -> Shapes:
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


def ramped(after: Around, place: Times, length: Times) -> Shapes:
    """A step of size 1 in averages over this time."""
    return np.clip((after - place) / length, -0.5, 0.5)


def butterworth(after: Around, place: Times, lag: Times) -> Shapes:
    """A step of size 1 behind Butterworth's filter of second order, of corner √2 / lag."""
    x = np.maximum(after - (place - lag), 0.0) / lag
    return 0.5 - np.exp(-x) * (np.cos(x) + np.sin(x))


def twice_rounded(after: Around, place: Times, lag: Times) -> Shapes:
    """A step of size 1 behind two filters of first order, of half this lag each."""
    x = np.maximum(after - (place - lag), 0.0) / (0.5 * lag)
    return 0.5 - np.exp(-x) * (1.0 + x)


# Shapes of blurred steps, and the time to either side of the lag in which they pass all but some
# 3 % of a step, as a share of their own time.
_BLURRED: tuple[tuple[Shape, float], ...] = (
    (ramped, 0.5), (butterworth, 2.0), (twice_rounded, 2.0),
)  # fmt: skip


def yielding(steps: Steps) -> Shape:
    """Steps of friction that builds up over the distance ā T² (Dahl), with the usual acceleration ā
    at reversals and the time T."""
    pace = np.sqrt(steps.acceleration / np.median(steps.acceleration))[:, None]

    def shape(after: Around, place: Times, time: Times) -> Shapes:
        return 0.5 - np.exp(-0.5 * (pace * np.maximum(after - place, 0.0) / time) ** 2)

    return shape


@dataclass(frozen=True, eq=False)
class _Trials:
    """Least squares of steps for shapes of one kind, at the lags and times of a grid."""

    places: Float[np.ndarray, " lags"]
    times: Float[np.ndarray, " times"]
    misses: Float[np.ndarray, "lags times"]  # squares of residuals
    step_shares: Float[np.ndarray, "lags times"]  # α
    count: int  # of residuals

    @classmethod
    def of_shape(
        cls, steps: Steps, shape: Shape, places: np.ndarray, times: np.ndarray
    ) -> "_Trials":
        """By the normal equations of α and β, time after time to save memory."""
        jump = steps.jump[:, None]
        g, r = (x - x.mean(axis=1, keepdims=True) for x in (jump * steps.after, steps.left))
        gg, gr, rr = (float(np.sum(product)) for product in (g * g, g * r, r * r))
        misses, shares = (np.empty((len(places), len(times))) for _ in range(2))
        for k, time in enumerate(times.tolist()):
            s = jump * shape(steps.after, places[:, None, None], time)
            s -= s.mean(axis=2, keepdims=True)
            ss, sg, sr = (np.sum(s * x, axis=(1, 2)) for x in (s, g, r))
            apart = np.maximum(ss * gg - sg**2, NEGLIGIBLE * ss * gg + _TINY)
            shares[:, k] = (gg * sr - sg * gr) / apart
            misses[:, k] = rr - shares[:, k] * sr - (ss * gr - sg * sr) / apart * gr
        return cls(places, times, misses, shares, r.size)

    @property
    def best(self) -> tuple[int, int]:
        k, m = np.unravel_index(np.argmin(self.misses), self.misses.shape)
        return int(k), int(m)

    @property
    def least(self) -> float:
        return float(self.misses.min())

    @property
    def variance(self) -> float:
        return max(self.least / self.count, _TINY)

    @property
    def lag(self) -> tuple[float, float]:
        """Mean and standard deviation of the lag, all lags and times as probable before."""
        share = np.exp((self.least - self.misses) / (2 * self.variance)).sum(axis=1)
        share /= share.sum()
        mean = float(share @ self.places)
        scatter = np.sqrt(share @ (self.places - mean) ** 2)
        return mean, float(np.hypot(scatter, self.places[1] - self.places[0]))


def blurred(steps: Steps, known: float, period: float) -> tuple[float, float, float] | None:
    """Mean and standard deviation of the lag where steps are blurred, and the time to either side
    of it that they take.

    None unless this is more probable, beyond the number of trials, than any sharp step, any behind
    a filter of first order, and any of friction that yields before it slips.
    """
    if len(steps.jump) < _LEAST:
        return None
    places = known + np.linspace(-NEAR, NEAR, _GRID[1])
    times = np.geomspace(_CONSTANTS[1] * period, max(LONGEST, 2 * _CONSTANTS[1] * period), _GRID[0])
    constants = np.geomspace(_CONSTANTS[0] * period, times[-1], 3 * _GRID[0])
    kinds = [_Trials.of_shape(steps, shape, places, times) for shape, _ in _BLURRED]
    others = [
        _Trials.of_shape(steps, shape, places, constants) for shape in (rounded, yielding(steps))
    ]
    kind = int(np.argmin([trials.least for trials in kinds]))
    likeliest = kinds[kind]
    gain = (min(trials.least for trials in others) - likeliest.least) / (2 * likeliest.variance)
    if (
        gain < np.log(len(kinds) * likeliest.misses.size)
        or likeliest.step_shares[likeliest.best] < _SEEN
    ):
        return None
    return *likeliest.lag, _BLURRED[kind][1] * float(times[likeliest.best[1]])


def behind_filter(steps: Steps, known: float, period: float) -> tuple[float, float] | None:
    """Mean and standard deviation of the lag δ + T behind a first-order filter, with a uniform
    prior over a grid of lags and time constants."""
    constants = period * np.geomspace(*_CONSTANTS, _GRID[0])
    places = known + np.linspace(-NEAR, NEAR + constants[-1], _GRID[1])
    trials = _Trials.of_shape(steps, rounded, places, constants)
    k, m = trials.best
    place, constant = float(places[k]), float(constants[m])
    local = locally(steps, rounded(steps.after, place, constant))
    off = misfit(local, steps, place - constant)
    if local.step_share < _SEEN or off > _ROUGH:
        return None
    mean, deviation = trials.lag
    return mean, float(np.hypot(deviation, off * period))


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
    few = replace(steps, after=steps.after[:, part], left=steps.left[:, part])
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
