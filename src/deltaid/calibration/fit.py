"""The fit of a geometry to the readings of all instruments, with outliers excluded.

Readings that nothing near the description explains are excluded before, of the others the worst
first, and those come back that the rest predicts after all: outliers may hide each other, and make
others look like some. Where residuals of an instrument are larger than its noise by more than
chance, its noise is what they show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from deltaid.calibration.gauss_newton import (
    GeometryFit,
    UsedReadings,
    WeightedRows,
    solved,
    tools_of,
)
from deltaid.calibration.instruments import Instrument, ProbeReadings
from deltaid.calibration.loops import Loops
from deltaid.calibration.unknowns import Unknowns
from deltaid.errors import IdentificationError, KinematicsError
from deltaid.sensors.planning.knowledge import Knowledge
from deltaid.sensors.planning.offers import PoseKind

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


@dataclass(frozen=True)
class MeasuringSession:
    """Readings of one file.

    Attributes:
        kind, source: of the instrument, and its file.
        readings: how many there are.
        excluded: what was excluded, in words.
        residual: of those used, root mean square [m].
        noise: standard deviation that the fit took [m].
        grown: how many times that is what was stated.
        quiet: whether residuals are far below that, as where noise is stated ten times too large.
    """

    kind: PoseKind
    source: str
    readings: int
    excluded: tuple[str, ...]
    residual: float
    noise: float
    grown: float
    quiet: bool


def fit(loops: Loops, known: Unknowns, instruments: Sequence[Instrument]) -> GeometryFit:
    """The geometry that explains the readings, with outliers excluded.

    Raises:
        IdentificationError: no geometry is found, or more than a fifth of an instrument's readings
            fit none.
    """
    readings = [_near(loops, known, instrument) for instrument in instruments]
    try:
        found = solved(loops, known, readings, np.zeros(known.G.shape[1]))
        return _with_predicted(_without_outliers(found))
    except KinematicsError as error:
        raise IdentificationError(
            f"no geometry near the described one explains the readings: {error.what}",
            where=", ".join(instrument.source for instrument in instruments),
            cure="check the drives' signs, zeros and order, and the readings' signs",
        ) from None


def _near(loops: Loops, known: Unknowns, instrument: Instrument) -> UsedReadings:
    """Readings that some geometry near the described one may explain."""
    n, used = known.G.shape[1], instrument.is_first
    own = n + np.arange(len(instrument.unknowns))
    x, by_u = tools_of(loops, known, instrument, np.zeros(n))
    while True:
        near = UsedReadings(instrument, used, instrument.start(x, used), instrument.noise)
        at = near.rows(x, by_u, own, n + len(own))
        far = at.errors / np.sqrt(1 + np.sum(np.square(at.slopes[..., :n]), axis=2))
        worst = _outliers(far, used, _spared(used), _scale(far, used))
        if not worst.any():
            return near
        used = used & ~worst


def _without_outliers(found: GeometryFit) -> GeometryFit:
    """The fit without readings that noise as stated does not explain, a fifth at most."""
    while True:
        worst = [
            _outliers(residuals, part.used, _spared(part.used), 1.0)
            for residuals, part in zip(found.residuals, found.readings, strict=True)
        ]
        if not any(map(np.any, worst)):
            break
        readings = [
            replace(part, used=part.used & ~outliers)
            for part, outliers in zip(found.readings, worst, strict=True)
        ]
        found = solved(found.loops, found.known, readings, found.u)
    for residuals, part in zip(found.residuals, found.readings, strict=True):
        if _outliers(residuals, part.used, len(part.used), _scale(residuals, part.used)).any():
            raise IdentificationError(
                f"more than {_MOST:.0%} of the {part.instrument.readings} fit no geometry near the "
                "described one",
                where=part.instrument.source,
                cure=_CURE,
            )
    return found


def _spared(used: Bool[np.ndarray, " readings"]) -> int:
    """How many more readings may be excluded."""
    return max(0, int(used.sum() - np.ceil((1 - _MOST) * len(used))))


def _with_predicted(found: GeometryFit) -> GeometryFit:
    """With the noise that residuals show, and all readings that the others predict within it."""
    while True:
        grown = [_level(rows, found.knowledge) for rows in found.rows]
        readings = []
        for part, residuals, more in zip(found.readings, found.residuals, grown, strict=False):
            explained = np.abs(residuals).max(axis=1) < _OUTLIER * more
            used = part.used | (part.instrument.is_first & explained)
            readings.append(replace(part, used=used, noise=part.noise * more))
        known = found.known
        if known.torques is not None:
            known = replace(known, torques=known.torques.with_noise(grown[-1]))
        same = all(
            np.array_equal(now.used, before.used)
            for now, before in zip(readings, found.readings, strict=True)
        )
        if same and max(grown, default=1.0) <= 1.0:
            break
        found = solved(found.loops, known, readings, found.u)
    for part, rows in zip(found.readings, found.rows, strict=False):
        before = float(np.median(np.linalg.norm(rows.used_slopes[:, : len(found.u)], axis=1)))
        left = float(np.sqrt(np.mean(rows.used_errors**2)))
        if part.grown > _GROWN and left > _BEYOND * before:
            raise IdentificationError(
                f"{part.instrument.readings} misfit every geometry near the described one by "
                f"{1e3 * left * part.noise:.3g} mm",
                where=part.instrument.source,
                cure=_CURE,
            )
    return found


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


def _level(rows: WeightedRows, knowledge: Knowledge) -> float:
    """How many times larger the noise of some rows is than assumed; 1 where chance explains it."""
    square, freedom = _chance(rows, knowledge)
    if freedom < 1 or square <= chi2.ppf(1 - _CHANCE, freedom):
        return 1.0
    return float(np.sqrt(square / freedom))


def _chance(rows: WeightedRows, knowledge: Knowledge) -> tuple[float, float]:
    """Sum of squares of some rows in units of their noise, and what it should be in the mean."""
    freedom = len(rows.used_errors) - float(np.sum((rows.used_slopes @ knowledge.inverse) ** 2))
    return float(rows.used_errors @ rows.used_errors), freedom


def sessions(found: GeometryFit) -> tuple[MeasuringSession, ...]:
    """What a fit says of the readings of each file."""
    made = []
    for part, rows in zip(found.readings, found.rows, strict=False):
        instrument, errors = part.instrument, part.noise * rows.errors
        square, freedom = _chance(rows, found.knowledge)
        made.append(
            MeasuringSession(
                instrument.kind,
                instrument.source,
                len(part.used),
                tuple(_excluded(part, errors, int(k)) for k in np.flatnonzero(~part.used)),
                float(np.sqrt(np.mean(rows.used_errors**2))) * part.noise,
                part.noise,
                part.grown,
                bool(freedom >= 1 and square * _GROWN**2 < chi2.ppf(_CHANCE, freedom)),
            )
        )
    return tuple(made)


def _excluded(part: UsedReadings, errors: Float[np.ndarray, "readings values"], k: int) -> str:
    """Why a reading is excluded: it stands there twice, or beside another's pose, or is off."""
    instrument, row = part.instrument, f"row {part.instrument.rows[k]}"
    if (first := instrument.repeats[k]) != k:
        return f"{row}: the same as row {instrument.rows[first]}"
    why = f"{row}: off by {1e3 * np.abs(errors[k]).max():.3g} mm"
    # another excluded row whose prediction this reading fits, to a hundredth of its error
    far = np.linalg.norm(instrument.values[k] - (instrument.values - errors), axis=1)
    others = np.flatnonzero(~part.used & (far < 0.01 * far[k]))
    if others.size and not isinstance(instrument, ProbeReadings):
        why += f", it fits the pose of row {instrument.rows[others[0]]}"
    return why
