"""Runs: consecutive rows that have something in common, as first and last row."""

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

Runs = Int[np.ndarray, "_ 2"]

NONE: Runs = np.zeros((0, 2), dtype=np.int64)


def runs_of(flags: Bool[np.ndarray, " rows"], row: int = 0) -> Runs:
    """Runs of true flags, the first of which belongs to `row`."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return edges.reshape(-1, 2) + np.array([row, row - 1])


def joined(runs: Shaped[np.ndarray, "_ 2"], gap: int = 0) -> Shaped[np.ndarray, "_ 2"]:
    """Ascending runs without what is between two with no more than `gap` rows between them."""
    if not len(runs):
        return runs
    runs = np.column_stack([runs[:, 0], np.maximum.accumulate(runs[:, 1])])
    apart = np.flatnonzero(runs[1:, 0] - runs[:-1, 1] > gap + 1)
    return np.column_stack([runs[np.append(0, apart + 1), 0], runs[np.append(apart, -1), 1]])


def joined_times(spans: Float[np.ndarray, "_ 2"]) -> Float[np.ndarray, "_ 2"]:
    """Spans of time in any order as ascending ones that are apart from each other."""
    return joined(spans[np.argsort(spans[:, 0])], gap=-1)


def without(runs: Runs, others: Runs) -> Runs:
    """Ascending runs less the rows of others."""
    kept = []
    for first, last in runs:
        start = first
        for a, b in others[(others[:, 1] >= first) & (others[:, 0] <= last)]:
            if a > start:
                kept.append((start, a - 1))
            start = b + 1
        if start <= last:
            kept.append((start, last))
    return np.array(kept, dtype=np.int64).reshape(-1, 2)


def rolling(
    x: Float[np.ndarray, "rows channels"], length: int
) -> tuple[Float[np.ndarray, "windows channels"], Float[np.ndarray, "windows channels"]]:
    """Least and largest value in every window of `length` rows."""
    return _extremes(np.minimum, x, length), _extremes(np.maximum, x, length)


def least_about(
    x: Float[np.ndarray, "rows channels"], reach: int
) -> Float[np.ndarray, "rows channels"]:
    """Least value within `reach` rows to either side; zero beyond the ends."""
    return _extremes(np.minimum, np.pad(x, ((reach, reach), (0, 0))), 2 * reach + 1)


def _extremes(
    extreme: np.ufunc, x: Float[np.ndarray, "rows channels"], length: int
) -> Float[np.ndarray, "windows channels"]:
    """Those of windows of `length` rows, from those of half as many."""
    found, size = x, 1
    while size < length:
        step = min(size, length - size)
        found, size = extreme(found[:-step], found[step:]), size + step
    return found
