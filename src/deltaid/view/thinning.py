"""Which of many samples a figure draws."""

import numpy as np
from jaxtyping import Float, Int


def stretch_length(samples: int, most: int) -> int:
    """Samples a stretch, so that there are at most `most` stretches."""
    return max(1, -(-samples // most))


def even_rows(samples: int, most: int) -> slice:
    """At most `most` rows at equal distances: for clouds of points."""
    return slice(None, None, stretch_length(samples, most))


def peak_rows(size: Float[np.ndarray, " samples"], most: int) -> Int[np.ndarray, " rows"]:
    """Of each of at most `most` stretches the row of the largest size; NaN is the smallest."""
    return _largest(size, stretch_length(len(size), most))


def extreme_rows(values: Float[np.ndarray, " samples"], length: int) -> Int[np.ndarray, " rows"]:
    """Rows of the least and the largest value of each stretch of `length` samples, in order.

    NaN counts only where a stretch holds nothing else.
    """
    return np.sort(np.concatenate([_largest(-values, length), _largest(values, length)]))


def _largest(values: Float[np.ndarray, " samples"], length: int) -> Int[np.ndarray, " rows"]:
    blocks = np.full((-(-len(values) // length), length), -np.inf)
    blocks.flat[: len(values)] = np.where(np.isnan(values), -np.inf, values)
    return np.arange(0, len(values), length) + blocks.argmax(axis=1)
