"""Series of log friction with regressors that explain them without a change.

Outliers among their neighbours have less weight.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view

from deltaid.estimation.scatter import ROBUST
from deltaid.fleets.drift_evidence import (
    FEWEST,
    SIZE,
    STEP,
    WEEK,
    YEAR,
    ChangeEvidence,
    Changes,
    evidence,
    first_prior,
    with_others,
)
from deltaid.fleets.drift_scatter import USUAL_SCATTER, whitened_sums
from deltaid.levels import SURE

# Prior standard deviations of coefficients in units of σ (about 1 %): temperature [1/K], its square
# [1/K²], the heaviest load, seasons without a known temperature, and a step at a tool change. The
# next line has the deviations of the first two between drives of one robot.
_TEMPERATURE, _CURVE, _LOAD, _SEASON, _TOOL = 1.5, 0.02, 10.0, 6.0, 0.4
_BETWEEN_TEMPERATURE, _BETWEEN_CURVE = 0.2, 0.003
# Daily errors of a sensor make the slope too small, so the slope of temperature over weeks may
# differ: prior deviation of the difference, and its deviation between drives [1/K].
_SLOW, _BETWEEN_SLOW = 0.4, 0.02
# Prior standard deviation of an unknown level.
FLAT = 1e4
# Outliers: neighbours on each side, least deviation [%].
_SIDE, _LEAST = 7, 0.2
# Largest relative deviation of friction that is used.
_VAGUE = 0.3


@dataclass(frozen=True, eq=False)
class Regressors:
    """Regressors of friction without a change, the level first.

    Attributes:
        scale: prior standard deviations of coefficients, in units of σ.
        between_drives: the same between drives of one robot; infinite for independent coefficients.
        unknown: standard deviation caused by missing values of a column [%].
    """

    names: tuple[str, ...]
    columns: Float[np.ndarray, "n regressors"]
    scale: Float[np.ndarray, " regressors"]
    between_drives: Float[np.ndarray, " regressors"]
    unknown: Float[np.ndarray, " n"]

    @classmethod
    def for_recordings(
        cls,
        days: Float[np.ndarray, " n"],
        temperature: Float[np.ndarray, " n"],
        load: Float[np.ndarray, " n"],
        tools: Sequence[float] = (),
    ) -> "Regressors":
        """Regressors of recordings.

        Args:
            temperature: [°C], NaN if unknown.
            load: [kg].
            tools: days on which a tool was changed.
        """
        rows = [("level", np.ones(len(days)), FLAT, np.inf)]
        known, unknown = np.isfinite(temperature), np.zeros(len(days))
        if known.any():
            T = np.where(known, temperature - temperature[known].mean(), 0.0)
            unknown[~known] = _TEMPERATURE * SIZE * temperature[known].std()
            rows += [
                ("temperature", T, _TEMPERATURE, _BETWEEN_TEMPERATURE),
                ("temperature²", T**2, _CURVE, _BETWEEN_CURVE),
                ("slow temperature", _slow(days, T, known), _SLOW, _BETWEEN_SLOW),
            ]
        else:
            waves = (("season", np.sin), ("season'", np.cos))
            angle = 2.0 * np.pi * days / YEAR
            rows += [(name, wave(angle), _SEASON, np.inf) for name, wave in waves]
        if np.ptp(load) > 0:
            rows.append(("load", load / np.max(np.abs(load)), _LOAD, np.inf))
        rows += [("tool", (days >= day).astype(float), _TOOL, np.inf) for day in tools]
        names, columns, *scales = zip(*rows, strict=True)
        scale, between_drives = map(np.array, scales)
        return cls(names, np.stack(columns, axis=1), scale, between_drives, unknown)


@dataclass(frozen=True, eq=False)
class Explained:
    """Series and the evidence for changes in them.

    Attributes:
        y: log friction [%] minus its median `start`; NaN if undetermined.
    """

    days: Float[np.ndarray, " n"]
    y: Float[np.ndarray, "series n"]
    start: Float[np.ndarray, " series"]
    regressors: Regressors
    changes: Changes
    evidence: ChangeEvidence


def _slow(
    days: Float[np.ndarray, " n"], T: Float[np.ndarray, " n"], known: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    weights = np.exp(-0.5 * ((days[:, None] - days[known]) / WEEK) ** 2)
    size = weights.sum(axis=1)
    return np.where(size > 0.0, weights @ T[known] / np.where(size > 0.0, size, 1.0), 0.0)


def in_percent(
    mean: Float[np.ndarray, "drives n"], std: Float[np.ndarray, "drives n"]
) -> tuple[Float[np.ndarray, "drives n"], Float[np.ndarray, "drives n"]]:
    """Log friction and its deviation [%]; NaN if unknown."""
    good = (mean > 0) & (std < _VAGUE * np.abs(mean)) & np.isfinite(std)
    safe = np.where(good, mean, 1.0)
    return np.where(good, 100.0 * np.log(safe), np.nan), np.where(good, 100.0 * std / safe, np.inf)


def explained(
    days: Float[np.ndarray, " n"],
    y: Float[np.ndarray, "series n"],
    std: Float[np.ndarray, "series n"],
    regressors: Sequence[Regressors],
) -> Explained:
    """Evidence of changes in the series of one robot, or of several with recordings on the same
    days.

    Args:
        y, std: as in `in_percent`, one robot after the other.
        regressors: of each robot, with the same number of columns.
    """
    drives, first = len(y) // len(regressors), regressors[0]
    X = np.repeat(np.stack([robot.columns for robot in regressors]), drives, axis=0)
    unknown = np.repeat(np.stack([robot.unknown for robot in regressors]), drives, axis=0)
    start = np.nan_to_num(_median(y))
    z = y - start[:, None]
    variance = 1.0 + (std / SIZE) ** 2 + (unknown / SIZE) ** 2
    changes = Changes.over(days)
    return Explained(
        days, z, start, first, changes,
        evidence_of(days, z, variance, X, changes, first.scale, first.between_drives, drives),
    )  # fmt: skip


def evidence_of(
    days: Float[np.ndarray, " n"],
    z: Float[np.ndarray, "series n"],
    variance: Float[np.ndarray, "series n"],
    X: Float[np.ndarray, "series n regressors"],
    changes: Changes,
    scale: Float[np.ndarray, " regressors"],
    between_drives: Float[np.ndarray, " regressors"],
    drives: int,
) -> ChangeEvidence:
    """Evidence of changes with regressors, of which the first is the level.

    Args:
        z: series, NaN without a recording.
        variance: of each recording, in units of σ² of white scatter; increased for outliers.
        scale, between_drives: as in `Regressors`.
        drives: number of consecutive series of one robot.
    """
    variance = np.where(np.isfinite(z), variance * inflation(z, X[..., 1:]), np.inf)
    base = np.concatenate([X, np.nan_to_num(z)[..., None]], axis=2)
    sums = whitened_sums(days, variance, base, changes.columns, USUAL_SCATTER)
    prior = first_prior(scale, USUAL_SCATTER, len(z))
    result = evidence(sums, changes, prior)
    if drives > 1:
        prior = with_others(result, changes, prior, between_drives, drives)
        result = evidence(sums, changes, prior)
    few = sums.count < FEWEST
    if not few.any():
        return result
    # σ absorbs the change, so priors in units of σ would be too wide.
    prior = replace(prior, precision=STEP**2 * prior.precision)
    exact = evidence(sums, changes, prior, freedom=0.0)
    return replace(result, R=np.where(few, np.minimum(result.R, exact.R), result.R))


def inflation(
    y: Float[np.ndarray, "series n"], regressors: Float[np.ndarray, "series n regressors"]
) -> Float[np.ndarray, "series n"]:
    """Factor of the variance of each recording: 1 if it agrees with its neighbours.

    Args:
        y: series in percent, NaN without a recording.
        regressors: without the level.
    """
    z = y - _explained(y, regressors)
    wide = np.pad(z, ((0, 0), (_SIDE, _SIDE)), constant_values=np.nan)
    residual = np.abs(z - _median(sliding_window_view(wide, 2 * _SIDE + 1, axis=1)))
    scale = np.maximum(ROBUST * _median(residual)[:, None], _LEAST)
    return np.nan_to_num(np.maximum(residual / (SURE * scale), 1.0) ** 2, nan=1.0)


def _median(values: Float[np.ndarray, "*rows n"]) -> Float[np.ndarray, "*rows"]:
    """Medians along the last axis without NaN; NaN where all are."""
    medians, some = np.full(values.shape[:-1], np.nan), np.isfinite(values).any(axis=-1)
    medians[some] = np.nanmedian(values[some], axis=-1)
    return medians


def _explained(
    y: Float[np.ndarray, "series n"], regressors: Float[np.ndarray, "series n regressors"]
) -> Float[np.ndarray, "series n"]:
    """Fit regressors robustly, by clipped changes between consecutive recordings."""
    fitted, count = np.zeros_like(y), regressors.shape[2]
    for k, (series, X) in enumerate(zip(y, regressors, strict=True) if count else ()):
        recorded = np.isfinite(series)
        dy, dX = np.diff(series[recorded]), np.diff(X[recorded], axis=0)
        slope = np.zeros(count)
        for _ in range(3):
            residual = dy - dX @ slope
            scale = max(ROBUST * np.median(np.abs(residual)), _LEAST) if len(residual) else 1.0
            target = dX @ slope + np.clip(residual, -2.0 * scale, 2.0 * scale)
            ridge = np.vstack([dX, scale * 0.1 * np.eye(count)])
            slope = np.linalg.lstsq(ridge, np.append(target, np.zeros(count)), rcond=None)[0]
        fitted[k] = X @ slope
    return fitted
