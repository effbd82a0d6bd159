"""Numbers as the sum of two floats, in exported code: what its functions for them are made of."""

from dataclasses import dataclass
from math import factorial

import numpy as np

from deltaid.exports.text import SINGLE

# Terms of Taylor's series about zero up to an eighth of a turn, which end below 1e-14: the first
# ones as pairs, the others as floats.
_AS_PAIRS, _SINE, _COSINE = 4, 7, 8


@dataclass(frozen=True)
class TaylorSeries:
    """c₀ + z (c₁ + z (…)) with z = x².

    Attributes:
        pairs: the first coefficients, each a float and its rest.
        tail: those of the rest, floats.
    """

    pairs: tuple[tuple[float, float], ...]
    tail: tuple[float, ...]


def _series(first: int, count: int) -> TaylorSeries:
    """Of the sine over x (first 1) or of the cosine (first 0)."""
    c = [(-1) ** k / factorial(first + 2 * k) for k in range(count)]
    return TaylorSeries(tuple(map(split, c[:_AS_PAIRS])), tuple(c[_AS_PAIRS:]))


def split(x: float) -> tuple[float, float]:
    """The nearest float, and what is left of a number as another one."""
    return float(np.float32(x)), x - float(np.float32(x))


SINE, COSINE, QUARTER = _series(1, _SINE), _series(0, _COSINE), split(np.pi / 2)


def pairs_of_c(text: str) -> dict[str, object]:
    """What templates/pairs.c.jinja asks: which functions a text calls, and their numbers."""
    used = {name for name in ("sum", "product", "quotient", "root", "sine", "cosine")
            if f"pair_{name}(" in text}  # fmt: skip
    number = SINGLE.c_number
    return {
        "used": used,
        "quarter": [number(x) for x in QUARTER],
        "over_quarter": number(2 / np.pi),
        "series": {
            name: ([number(x) for pair in series.pairs for x in pair], _tail(series.tail))
            for name, series in (("sine", SINE), ("cosine", COSINE))
        },
    }


def _tail(c: tuple[float, ...]) -> str:
    """A polynomial in z."""
    number, rest = SINGLE.c_number(c[0]), c[1:]
    return f"{number} + z * ({_tail(rest)})" if rest else number
