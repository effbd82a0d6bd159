"""The fit of a geometry to the readings of all instruments, with outliers excluded.

Readings that nothing near the description explains are excluded before, of the others the worst
first, and those come back that the rest predicts after all: outliers may hide each other, and make
others look like some. Where residuals of an instrument are larger than its noise by more than
chance, its noise is what they show.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from deltaid.calibration.gauss_newton import GeometryFit, solved, start_of, tools_of
from deltaid.calibration.instruments import Instrument
from deltaid.calibration.loops import Loops
from deltaid.calibration.unknowns import Unknowns
from deltaid.errors import IdentificationError, KinematicsError

# A residual beyond this many standard deviations is none of noise: chance makes one of two million.
_OUTLIER = 5.0
# More excluded rows are no outliers.
_MOST = 0.2
# Noise that is so many times as large as stated, and residuals that are so many times what the
# description's uncertainty makes of readings, are no noise: something else was measured.
_GROWN, _BEYOND = 2.0, 3.0
_CURE = (
    "check that the description is of this robot, units, columns, and the drives' zeros; "
    "or state how far its numbers may be off with --lengths and --angles"
)
# Probability that residuals of stated noise are called larger than it.
_CHANCE = 0.01
# A robust standard deviation is the median of |residuals| over this.
_MEDIAN = 0.6745


def fit(loops: Loops, known: Unknowns, instruments: Sequence[Instrument]) -> GeometryFit:
    """The geometry that explains the readings, with outliers excluded.

    Raises:
        IdentificationError: no geometry is found, or more than a fifth of an instrument's readings
            fit none.
    """
    single = [x.repeats == np.arange(len(x.repeats)) for x in instruments]
    used = [
        _near(loops, known, instrument, own)
        for instrument, own in zip(instruments, single, strict=True)
    ]
    stated = [instrument.noise for instrument in instruments]
    try:
        found = _without_outliers(solved(loops, known, instruments, used, stated), stated)
        return _with_predicted(found, single, stated)
    except KinematicsError as error:
        raise IdentificationError(
            f"no geometry near the described one explains the readings: {error.what}",
            where=", ".join(instrument.source for instrument in instruments),
            cure="check the drives' signs, zeros and order, and the readings' signs",
        ) from None


def _without_outliers(found: GeometryFit, stated: Sequence[float]) -> GeometryFit:
    """The fit without readings that noise as stated does not explain, a fifth at most."""
    while True:
        worst = [
            _outliers(part, own, _spared(own), 1.0)
            for part, own in zip(found.residuals, found.used, strict=True)
        ]
        if not any(part.any() for part in worst):
            _require_most(found)
            return found
        used = [own & ~part for own, part in zip(found.used, worst, strict=True)]
        found = solved(found.loops, found.known, found.instruments, used, stated, found)


def _spared(used: Bool[np.ndarray, " readings"]) -> int:
    """How many more readings may be excluded."""
    return max(0, int(used.sum() - np.ceil((1 - _MOST) * len(used))))


def _with_predicted(
    found: GeometryFit, single: Sequence[Bool[np.ndarray, " _"]], stated: Sequence[float]
) -> GeometryFit:
    """With the noise that residuals show, and all readings that the others predict within it."""
    while True:
        grown = [_level(found, i) for i in range(len(found.rows))]
        now = [
            replace(x, noise=x.noise * more)
            for x, more in zip(found.instruments, grown, strict=False)
        ]
        known = found.known
        if known.torques is not None:
            known = replace(known, torques=known.torques.with_noise(grown[-1]))
        used = [
            own | (alone & (np.abs(part).max(axis=1) < _OUTLIER * more))
            for own, alone, part, more in zip(
                found.used, single, found.residuals, grown, strict=False
            )
        ]
        same = all(map(np.array_equal, used, found.used))
        if same and max(grown, default=1.0) <= 1.0:
            break
        found = solved(found.loops, known, now, used, stated, found)
    for i in range(len(found.instruments)):
        _require_fit(found, i)
    return found


def _near(
    loops: Loops, known: Unknowns, instrument: Instrument, used: Bool[np.ndarray, " readings"]
) -> Bool[np.ndarray, " readings"]:
    """Readings that some geometry near the described one may explain."""
    x, moved = tools_of(loops, known, instrument, np.zeros(known.G.shape[1]))
    while True:
        at = instrument.slopes(x, start_of(instrument, x, used))
        slopes = sum(tool @ slope for tool, slope in zip(at.tools, moved, strict=True))
        scale = np.sqrt(instrument.noise**2 + np.sum(np.square(slopes), axis=2))
        far = at.error / scale
        worst = _outliers(far, used, _spared(used), _scale(far, used))
        if not worst.any():
            return used
        used = used & ~worst


def _require_most(found: GeometryFit) -> None:
    """Refuse outliers that are left where no more may be excluded."""
    for instrument, part, own in zip(found.instruments, found.residuals, found.used, strict=True):
        if _outliers(part, own, len(own), _scale(part, own)).any():
            raise IdentificationError(
                f"more than {_MOST:.0%} of the {instrument.readings} fit no geometry near the "
                "described one",
                where=instrument.source,
                cure=_CURE,
            )


def _require_fit(found: GeometryFit, i: int) -> None:
    """Refuse residuals beyond all that the description's uncertainty could make of readings."""
    rows, n, instrument = found.rows[i], len(found.u), found.instruments[i]
    before = float(np.median(np.linalg.norm(rows.A[:, :n], axis=1)))
    left = float(np.sqrt(np.mean(rows.error**2)))
    if found.grown[i] > _GROWN and left > _BEYOND * before:
        raise IdentificationError(
            f"{instrument.readings} misfit every geometry near the described one by "
            f"{1e3 * left * instrument.noise:.3g} mm",
            where=instrument.source,
            cure=_CURE,
        )


def _scale(
    residuals: Float[np.ndarray, "readings values"], used: Bool[np.ndarray, " readings"]
) -> float:
    """Robust standard deviation of residuals, at least that of the noise."""
    return max(1.0, float(np.median(np.abs(residuals[used]))) / _MEDIAN)


def _outliers(
    residuals: Float[np.ndarray, "readings values"],
    used: Bool[np.ndarray, " readings"],
    most: int,
    scale: float,
) -> Bool[np.ndarray, " readings"]:
    """Readings that noise does not explain, of those at least half as far off as the worst, and
    not more than so many."""
    size = np.where(used, np.abs(residuals).max(axis=1), 0.0)
    worst = np.argsort(-size)[:most]
    outliers = np.zeros(len(used), dtype=bool)
    outliers[worst] = size[worst] > max(_OUTLIER * scale, 0.5 * size.max(initial=0.0))
    return outliers


def _level(found: GeometryFit, i: int) -> float:
    """How many times larger the noise of some rows is than assumed; 1 where chance explains it."""
    square, freedom = _chance(found, i)
    if freedom < 1 or square <= chi2.ppf(1 - _CHANCE, freedom):
        return 1.0
    return float(np.sqrt(square / freedom))


def is_quiet(found: GeometryFit, i: int) -> bool:
    """Whether noise so much smaller than assumed as to be stated wrongly explains some rows."""
    square, freedom = _chance(found, i)
    return bool(freedom >= 1 and square * _GROWN**2 < chi2.ppf(_CHANCE, freedom))


def _chance(found: GeometryFit, i: int) -> tuple[float, float]:
    """Sum of squares of some rows in units of their noise, and what it should be in the mean."""
    rows = found.rows[i]
    freedom = len(rows.error) - float(np.sum((rows.A @ found.knowledge.inverse) ** 2))
    return float(rows.error @ rows.error), freedom
