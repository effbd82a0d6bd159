"""Places rows with uneven time stamps on an even grid.

A row n with stamp t_n has the level r_n = t_n/T − n = φ(n) + c_n + jitter: the staircase c_n counts
rows lost before it, and φ drifts slowly with the clock. T and φ follow from the angles of
exp(2πi r), which whole numbers of lost rows do not change. The staircase is the closest
non-decreasing one (isotonic regression), rounded. With large jitter or shared stamps, angles are
averaged over rows.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import median_filter, minimum_filter1d, uniform_filter1d

from deltaid.recording.time.clock import HIGHEST_RATE

Times = Float[np.ndarray, " rows"]

# Jitter above which single stamps do not determine a row's place [periods, rms].
SHARP = 0.1
# Jitter above which angles are averaged until it is below `SHARP` [periods, rms].
_BLURRED = 0.17
# Mean number of rows per stamp above which stamps count as rounded.
ROUNDED = 1.05
# Shortest usual step [s], which keeps places finite; so high a rate is refused later.
FASTEST = 0.5 / HIGHEST_RATE
# Step above which a gap may change the phase of the grid [periods times rows per stamp]; and rows
# on either side that must agree on a place.
FAR, AGREE = 20.0, 64
# Rows around a place whose median is its level, and largest jitter for which this holds [periods].
ABOUT, _CLEAR = 33, 0.6
# Stamps in long steps: rows over which the same time passes everywhere; share of the largest and of
# the smallest such times that lost rows may change; largest deviation of steps from multiples of
# the shortest; range of the shortest step [periods]; and least number of unusual steps over these
# rows.
_STEADY, _SOME, _WHOLE, _COARSE, _OFTEN = 1024, 0.05, 0.01, (0.3, 3.0), 8
# Fewest rows that determine a phase, and fewest rows of a stretch of constant phase.
FEWEST, _STRETCH = 16, 256


@dataclass(frozen=True, eq=False)
class Grid:
    """Places of consecutive rows on an even grid.

    Attributes:
        period: T [s].
        kept: rows that have a place; others are extra or late.
        lost: number of rows lost before each kept row; −1 if time restarts.
        off: stamps of kept rows minus the grid [periods].
    """

    period: float
    kept: Int[np.ndarray, " kept"]
    lost: Int[np.ndarray, " kept"]
    off: Float[np.ndarray, " kept"]

    def without(self, removed: Bool[np.ndarray, " kept"]) -> "Grid":
        index = np.cumsum(1 + np.maximum(self.lost, 0))[~removed]
        piece = np.cumsum(self.lost < 0)[~removed]
        lost = np.diff(index, prepend=index[:1] - 1) - 1
        lost[np.flatnonzero(np.diff(piece)) + 1] = -1
        return Grid(self.period, self.kept[~removed], lost, self.off[~removed])


def place(time: Times) -> Grid:
    """Places of consecutive rows by their stamps, none of which is wild; two must differ."""
    period, sharing = usual_step(time)
    pieces = np.split(np.arange(len(time)), far_steps(time, period, sharing))
    placed = [_placed(time[rows], period, sharing) for rows in pieces]
    enough = [piece for piece in placed if len(piece.kept) >= FEWEST and piece.period > FASTEST]
    rates = np.array([[len(piece.kept), piece.period] for piece in enough])
    if len(rates):
        period = float(rates[:, 0] @ rates[:, 1] / rates[:, 0].sum())
    lost = [piece.lost for piece in placed]
    kept = [rows[piece.kept] for rows, piece in zip(pieces, placed, strict=True)]
    for k in range(1, len(placed)):
        step = time[kept[k][0]] - time[kept[k - 1][-1]]
        off = period * (placed[k].off[0] - placed[k - 1].off[-1])
        missing = round((step - off) / period) - 1
        lost[k][0] = -1 if step < 0 else max(0, missing)
    return Grid(
        period, np.concatenate(kept), np.concatenate(lost), np.concatenate([p.off for p in placed])
    )


def repaired(time: Times, period: float, sharing: float) -> tuple[Times, Bool[np.ndarray, " rows"]]:
    """Stamps with wild ones replaced by interpolation, and whether each stamp is wild.

    Wild stamps are far off their neighbours on both sides. Causes are damaged files, and clocks
    that are read while they are set.

    Args:
        time: stamps of consecutive rows [s].
        period: the usual time between two rows [s].
        sharing: mean number of rows per stamp.
    """
    far = FAR * sharing
    if len(time) < 3 or np.abs(np.diff(time)).max() <= far * period:
        return time, np.zeros(len(time), dtype=bool)
    rows = np.arange(len(time))
    level = time / period - rows
    usual = medians(level, 2 * AGREE + 1)
    wild = np.abs(level - usual) > far
    return np.where(wild, period * (usual + rows), time), wild


def usual_step(time: Times) -> tuple[float, float]:
    """Estimate of the period [s], 0 if unknown, and mean number of rows per stamp.

    Rows do not count where time stands still: where far more rows share a stamp than elsewhere.
    """
    shared = np.diff(np.flatnonzero(np.diff(time, prepend=np.nan)), append=len(time))
    time = time[np.repeat(shared <= FAR * np.quantile(shared, 0.5, method="lower"), shared)]
    if len(time) < 2:
        return 0.0, 1.0
    steps = np.diff(time)
    sharing = max(1.0, len(steps) / max(1, np.count_nonzero(steps)))
    apart = min(int(np.ceil((16 if sharing > ROUNDED else 4) * sharing)), len(time) - 1)
    usual = float(np.median(time[apart:] - time[:-apart])) / apart
    usual = usual if usual > 0 else float(np.ptp(time)) / max(1, len(steps))
    return (max(usual, FASTEST) if usual else 0.0), sharing


def spread(off: Times) -> float:
    """Robust standard deviation of stamps: at most 0.75 times the distance of the quartiles."""
    low, high = np.quantile(off, [0.25, 0.75])
    return float(min(np.std(off), 0.75 * (high - low)))


def far_steps(time: Times, period: float, sharing: float) -> Int[np.ndarray, " breaks"]:
    """Rows before which time jumps."""
    return np.flatnonzero(np.abs(np.diff(time)) > FAR * sharing * period) + 1


def _placed(time: Times, period: float, sharing: float) -> Grid:
    rows = np.arange(len(time))
    if len(time) < FEWEST:
        return _counted(time, rows, period)
    if (rounded := _rounded_period(time)) is not None:
        level = (time - time[0]) / rounded - rows
        level -= _phase(level, _STRETCH)
        stairs = np.maximum.accumulate(np.round(_mean(level, _STRETCH)).astype(int))
        return _fitted(time, rows, level, stairs)
    noise = _noise(time / period, sharing)
    kept = np.flatnonzero(~_extra(time / period, noise, sharing))
    if len(kept) < FEWEST:
        return _counted(time, kept, period)
    period, level, width = _level(time[kept], period, noise, sharing)
    while (falls := _falls(level, noise, sharing)).size and len(kept) - len(falls) >= FEWEST:
        kept = np.delete(kept, falls)
        period, level, width = _level(time[kept], period, noise, sharing)
    return _fitted(time[kept], kept, level, _stairs(level, noise, sharing, width))


def _fitted(
    time: Times, kept: Int[np.ndarray, " kept"], level: Times, stairs: Int[np.ndarray, " kept"]
) -> Grid:
    lost = np.diff(stairs, prepend=stairs[:1])
    index = np.arange(len(time)) + stairs
    index = index - index.mean()
    fitted = float(index @ time / (index @ index))
    return Grid(max(fitted, FASTEST), kept, lost, level - stairs)


def _rounded_period(time: Times) -> float | None:
    """Period [s] of even rows whose stamps have long steps, like seconds in single precision after
    hours; None for other rows.

    Over a given number of rows, the same time passes up to one step, while lost rows come at
    random.
    """
    apart, steps = min(_STEADY, len(time) // 4), np.diff(time)
    quantum = float(np.min(steps, where=steps > 0, initial=np.inf))
    shares = quantum * len(steps) / max(float(time[-1] - time[0]), FASTEST)
    if apart < AGREE or steps.min() < 0 or not _COARSE[0] < shares < _COARSE[1]:
        return None
    times = steps / quantum
    others = np.count_nonzero(np.abs(times - np.median(times)) > 0.5)
    passed = time[apart:] - time[:-apart]
    low, high = np.quantile(passed, [_SOME, 1 - _SOME])
    is_whole = np.abs(times - np.round(times)).max() < _WHOLE
    if not is_whole or high - low > (1 + _WHOLE) * quantum or others * apart < _OFTEN * len(steps):
        return None
    return float(passed[(passed >= low) & (passed <= high)].mean()) / apart


def _counted(time: Times, kept: Int[np.ndarray, " kept"], period: float) -> Grid:
    level = time[kept] / period - np.arange(len(kept))
    lost = np.maximum(np.round(np.diff(level, prepend=level[:1])), 0).astype(int)
    return Grid(period, kept, lost, level - level[:1] - np.cumsum(lost))


def _level(time: Times, period: float, noise: float, sharing: float) -> tuple[float, Times, int]:
    """Period [s], levels of the rows relative to an even grid without drift, and number of rows
    over which angles were averaged."""
    width = _width(noise, sharing, len(time))
    level = time / period - np.arange(len(time))
    period *= 1 + _slope(level, width)
    level = (time - time[0]) / period - np.arange(len(time))
    return period, level - _phase(level, width), width


def _falls(level: Times, noise: float, sharing: float) -> Int[np.ndarray, " falls"]:
    """Extra rows: those at which the level falls by one and stays there."""
    if sharing > ROUNDED or noise > _CLEAR or len(level) < 2 * ABOUT:
        return np.zeros(0, dtype=int)
    stairs = np.round(medians(level, ABOUT))
    # Below all rows before it, because after a late row a level falls only back to its old value.
    return np.flatnonzero(stairs[1:] < _lowest(stairs)[:-1]) + 1


def _noise(place_: Times, sharing: float) -> float:
    """Jitter of single stamps [periods, rms]: residual of straight lines over the smoothest
    stretches, which have lost no rows."""
    size = min(int(16 * sharing), len(place_))
    count = len(place_) // size
    x = np.arange(size) - 0.5 * (size - 1)
    y = place_[: count * size].reshape(count, size)
    y = y - y.mean(axis=1, keepdims=True)
    y -= np.outer(y @ x / (x @ x), x)
    return float(np.quantile(np.sqrt((y**2).sum(axis=1) / (size - 2)), 0.25))


def _extra(place_: Times, noise: float, sharing: float) -> Bool[np.ndarray, " rows"]:
    """Rows that have no place: written between others, or late."""
    level = place_ - np.arange(len(place_))
    usual = medians(level, 9)
    back = np.diff(place_, prepend=-np.inf)
    late = (back < 0) & (level < usual - (0.5 if noise < SHARP else 3 + 6 * noise))
    if noise < SHARP:
        # Runs that belong before earlier rows, and single rows that belong after later ones.
        highest = _lowest(-medians(place_, 5))
        late[1:] |= place_[1:] < -highest[:-1] - 0.5
        late[:-1] |= (back[1:] < 0) & (level[:-1] > usual[:-1] + 1.5)
        late[0] = False
    if sharing > ROUNDED:
        return late
    low = medians(level, 5)
    # The lowest levels before and after are compared, so that a late stamp is no extra row.
    before, after = _lowest(low)[:-1], _lowest(low[::-1])[::-1][1:]
    falls = np.append(False, after - before < -0.5)
    return late | (falls & (np.abs(back) < (0.4 if noise < SHARP else 1e-9)))


def _lowest(x: Times) -> Times:
    """Least value of each row and those before it, `AGREE` rows in all."""
    return minimum_filter1d(x, AGREE, mode="nearest", origin=(AGREE - 1) // 2)


def _width(noise: float, sharing: float, rows: int) -> int:
    if noise < _BLURRED:
        return 1
    wide = 8 * sharing if sharing > ROUNDED else (noise / SHARP) ** 2
    return max(1, min(int(np.ceil(wide)), rows // 4))


def _slope(level: Times, width: int) -> float:
    """Rise of the level per row apart from whole steps, from short distances to long ones."""
    slope, apart, rows = 0.0, 1, np.arange(len(level))
    while apart < max(2, len(level) // 8):
        flat = _mean(level - slope * rows, width)
        turn = np.exp(2j * np.pi * (flat[apart:] - flat[:-apart])).mean()
        if abs(turn) < 0.05:
            break
        slope += float(np.angle(turn)) / (2 * np.pi * apart)
        apart *= 2
    return slope


def _phase(level: Times, width: int) -> Times:
    turns = np.exp(2j * np.pi * _mean(level, width))
    parts = np.array_split(turns, max(1, len(level) // max(_STRETCH, 4 * width)))
    angles = np.unwrap(np.angle([part.mean() for part in parts])) / (2 * np.pi)
    sizes = np.array([len(part) for part in parts])
    return np.interp(np.arange(len(level)), np.cumsum(sizes) - 0.5 * sizes, medians(angles, 5))


def _stairs(level: Times, noise: float, sharing: float, width: int) -> Int[np.ndarray, " rows"]:
    """Non-decreasing integers that are closest to the level."""
    # A stamp that is far off, or late, does not mean a lost row.
    smooth = medians(level, 2 * int(4 * sharing) + 1)
    low = np.minimum.accumulate(smooth[::-1])[::-1]
    high = np.minimum(low, np.maximum.accumulate(smooth))
    room = 0.5 + 3 * noise
    level = np.clip(level, high - room, low + room)
    if noise < SHARP:
        return np.maximum.accumulate(np.round(level).astype(int))
    from scipy.optimize import isotonic_regression

    # Both ends are extended by their mean, because a single stamp there would make a step.
    beyond, near = 2 * width, max(9, width)
    ends = [np.full(beyond, np.round(np.mean(x))) for x in (level[:near], level[-near:])]
    stairs = isotonic_regression(np.concatenate([ends[0], level, ends[1]])).x
    return np.round(stairs[beyond:-beyond]).astype(int)


def _mean(x: Times, width: int) -> Times:
    return x if width == 1 else uniform_filter1d(x, width, mode="nearest")


def medians(x: Times, width: int) -> Times:
    # A width larger than x is slow and gives the same result.
    return median_filter(x, min(width, len(x) - 1 + len(x) % 2), mode="nearest")
