"""A sample of a recording's rows that shows which rows another recording has as well.

Each row has a number by its positions and torques alone, as if drawn at random. A sample keeps the
least numbers, so two recordings with the same rows keep the same ones, whatever their times and
however many other rows they have.
"""

from typing import TypeAlias

import numpy as np
from jaxtyping import Float, UInt64

# Numbers kept of a recording, of whose excerpt of a hundredth they keep ten; and in a file.
_KEPT, _IN_FILE = 1024, 16
# Hexadecimal digits of a number.
_DIGITS = 2 * np.dtype(np.uint64).itemsize
# Odd multiplier and shift of a multiplicative hash (Steele et al. 2014, splitmix64).
_ODD, _SHIFT = 0xBF58476D1CE4E5B9, np.uint64(31)

# Share of rows of another recording from which one repeats it: rows at rest may agree by chance,
# in all positions and torques to the last bit.
REPEATED = 0.1

RowSample: TypeAlias = UInt64[np.ndarray, " _"]
NO_ROWS: RowSample = np.zeros(0, dtype=np.uint64)


def sampled(sample: RowSample, rows: Float[np.ndarray, "rows numbers"]) -> RowSample:
    """The sample with more rows."""
    powers = [pow(_ODD, k, 1 << 64) for k in range(1, rows.shape[1] + 1)]
    numbers = (rows + 0.0).view(np.uint64) @ np.array(powers, dtype=np.uint64)  # -0 is 0
    numbers = (numbers ^ (numbers >> _SHIFT)) * np.uint64(_ODD)
    if len(sample) == _KEPT:
        numbers = numbers[numbers < sample[-1]]
    return np.unique(np.concatenate([sample, numbers]))[:_KEPT]


def shared_rows(a: RowSample, b: RowSample) -> float:
    """Share of the rows of the recording with fewer of them that the other has as well."""
    kept = (_KEPT, _IN_FILE)
    known = min((sample[-1] for sample in (a, b) if len(sample) in kept), default=None)
    if known is not None:  # beyond it one of them keeps none
        a, b = a[a <= known], b[b <= known]
    fewer = min(len(a), len(b))
    return len(np.intersect1d(a, b, assume_unique=True)) / fewer if fewer else 0.0


def in_text(sample: RowSample) -> str:
    """The least numbers, as they are kept in files."""
    return "".join(f"{number:0{_DIGITS}x}" for number in sample[:_IN_FILE].tolist())


def numbers_in(text: str) -> list[str]:
    """The numbers, each as it is kept."""
    return [text[first : first + _DIGITS] for first in range(0, len(text), _DIGITS)]


def from_text(text: str) -> RowSample:
    return np.array([int(digits, 16) for digits in numbers_in(text)], dtype=np.uint64)
