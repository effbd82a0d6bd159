"""Thinning curves for a picture, so that their smallest and largest values stay."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

# Rows of a block of which two are kept at first; a picture has fewer points than blocks.
_BLOCK = 128


class MinMax:
    """Curves of any length, of which two points a stretch are kept: its smallest and its largest.

    Rows come in pieces; memory is a sixty-fourth of what has come, or all of short curves.

    Args:
        curves: how many.
        points: at most so many are left of each.
        span: first and last time that count; None for all.
    """

    def __init__(self, curves: int, points: int, span: Any = None) -> None:
        self.rows, self._taken = 0, 0
        self._points = max(4, points)
        self._span = span
        self._times: list[np.ndarray] = []
        self._values: list[list[np.ndarray]] = [[] for _ in range(curves)]
        self._places: list[list[np.ndarray]] = [[] for _ in range(curves)]
        self._first, self._last = np.inf, -np.inf

    @property
    def seconds(self) -> float:
        """From the first to the last time."""
        return float(max(self._last - self._first, 0.0))

    def add(self, time: Float[np.ndarray, " rows"], values: Float[np.ndarray, "rows _"]) -> None:
        """Take a piece of rows."""
        self.rows += len(time)
        if len(time):
            self._first = min(self._first, float(time[0]))
            self._last = max(self._last, float(time[-1]))
        if self._span is not None:
            inside = (time >= self._span[0]) & (time <= self._span[1])
            time, values = time[inside], values[inside]
        self._taken += len(time)
        for k, column in enumerate(values.T):
            kept = _ends(column, _BLOCK) if self._taken > 8 * self._points else np.arange(len(time))
            self._places[k].append(time[kept])
            self._values[k].append(column[kept])

    def curve(self, k: int) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
        """Times and values of one curve."""
        if not self._values[k]:
            return np.empty(0), np.empty(0)
        time, values = np.concatenate(self._places[k]), np.concatenate(self._values[k])
        if len(time) > self._points:
            kept = _ends(values, int(np.ceil(2 * len(time) / self._points)))
            time, values = time[kept], values[kept]
        return time, values


def _ends(values: Float[np.ndarray, " rows"], block: int) -> Int[np.ndarray, " kept"]:
    """Where the smallest and the largest value of each block stand, in order."""
    whole = len(values) // block * block
    rest = _extremes(values[whole:].reshape(1, -1)) + whole if len(values) > whole else []
    return np.concatenate([_extremes(values[:whole].reshape(-1, block)), rest]).astype(int)


def _extremes(rows: Float[np.ndarray, "blocks width"]) -> Int[np.ndarray, " kept"]:
    """The same of the rows of an array, as places in all of it; NaN counts as neither."""
    if not rows.size:
        return np.empty(0, dtype=int)
    low = np.argmin(np.where(np.isnan(rows), np.inf, rows), axis=1)
    high = np.argmax(np.where(np.isnan(rows), -np.inf, rows), axis=1)
    both = np.sort(np.stack([low, high], axis=1), axis=1)
    return (both + rows.shape[1] * np.arange(len(rows))[:, None]).ravel()
