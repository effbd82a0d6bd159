"""Single recordings that stand apart from their neighbours count less."""

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

# Neighbours on each side, and how many robust deviations are still usual.
_SIDE, _USUAL = 7, 3.0
_LEAST = 0.2


def inflation(
    y: Float[np.ndarray, "series n"], regressors: Float[np.ndarray, "series n regressors"]
) -> Float[np.ndarray, "series n"]:
    """By how much the variance of each recording grows: 1 where it is as its neighbours are.

    Args:
        y: series in percent, NaN where there is no recording.
        regressors: what explains it beside its level.
    """
    z = y - _explained(y, regressors)
    wide = np.pad(z, ((0, 0), (_SIDE, _SIDE)), constant_values=np.nan)
    apart = np.abs(z - _median(sliding_window_view(wide, 2 * _SIDE + 1, axis=1)))
    scale = np.maximum(1.4826 * _median(apart)[:, None], _LEAST)
    return np.nan_to_num(np.maximum(apart / (_USUAL * scale), 1.0) ** 2, nan=1.0)


def _median(values: Float[np.ndarray, "*rows n"]) -> Float[np.ndarray, "*rows"]:
    """Along the last axis, of what is there; NaN where nothing is."""
    found, some = np.full(values.shape[:-1], np.nan), np.isfinite(values).any(axis=-1)
    found[some] = np.nanmedian(values[some], axis=-1)
    return found


def _explained(
    y: Float[np.ndarray, "series n"], regressors: Float[np.ndarray, "series n regressors"]
) -> Float[np.ndarray, "series n"]:
    """Roughly: by changes from one recording to the next, great ones clipped."""
    found = np.zeros_like(y)
    if not regressors.shape[2]:
        return found
    for k, (own, X) in enumerate(zip(y, regressors, strict=True)):
        there = np.isfinite(own)
        dy, dX = np.diff(own[there]), np.diff(X[there], axis=0)
        slope = np.zeros(X.shape[1])
        for _ in range(3):
            left = dy - dX @ slope
            scale = max(1.4826 * np.median(np.abs(left)), _LEAST) if len(left) else 1.0
            target = dX @ slope + np.clip(left, -2.0 * scale, 2.0 * scale)
            ridge = np.vstack([dX, scale * 0.1 * np.eye(len(slope))])
            slope = np.linalg.lstsq(ridge, np.append(target, np.zeros(len(slope))), rcond=None)[0]
        found[k] = X @ slope
    return found
