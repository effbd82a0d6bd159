"""Numbers as text, for the terminal and reports."""

import math

from deltaid.model.verdict import FEW as FEW

_WORDS = (
    "no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven",
    "twelve",
)  # fmt: skip
# Range of numbers that are written without a power of ten.
_SMALL, _LARGE = 1e-4, 1e6


def number(value: float, digits: int = 4) -> str:
    """A number with this many significant digits."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < _LARGE else text


def measured(value: float, digits: int = 3) -> str:
    """A number with significant trailing zeros."""
    text = f"{value:#.{digits}g}".rstrip(".")
    plain = value == 0 or not math.isfinite(value) or "e" in text
    return number(value, digits) if plain else text


def with_uncertainty(value: float, std: float) -> tuple[str, str]:
    """Value and ± to the same decimal place, where ± has two digits."""
    if not std > 0 or not math.isfinite(std):
        return number(value), ""
    place = 1 - math.floor(math.log10(std))
    largest = max(abs(value), std)
    if largest >= _LARGE or largest < _SMALL or place > 7:
        digits = max(2, 1 + math.floor(math.log10(largest / std)) + 1)
        return f"{value:.{min(digits, 9) - 1}e}", f"{std:.1e}"
    if place < 0:  # rounded to tens or hundreds
        return f"{round(value, place):.0f}", f"{round(std, place):.0f}"
    return f"{value:.{place}f}", f"{std:.{place}f}"


def percent(value: float) -> str:
    """A share in per cent with two significant digits, or no decimals from 100 %."""
    share = 100 * value
    return f"{share:.0f} %" if 99.5 <= abs(share) < 1e5 else f"{measured(share, 2)} %"


def span(low: float, high: float) -> str:
    """An interval as 'low … high', to two digits of half its width."""
    half = 0.5 * (high - low)
    if not half > 0 or not math.isfinite(half):
        return number(0.5 * (low + high))
    place = 1 - math.floor(math.log10(half))
    largest = max(abs(low), abs(high))
    if not _SMALL <= largest < _LARGE or place > 7 or place < 0:
        return f"{number(low, 3)} … {number(high, 3)}"
    if place > 4 and half > 0.1 * largest:  # two digits suffice, and save zeros
        return f"{low:.2g} … {high:.2g}"
    return f"{low:.{place}f} … {high:.{place}f}"


def in_words(count: int) -> str:
    """A count in words up to twelve, then in digits."""
    return _WORDS[count] if 0 <= count < len(_WORDS) else str(count)
