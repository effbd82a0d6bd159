"""Numbers as people read them, in the terminal and in the report."""

import math

# Half the 95 % interval of a normal distribution, in standard deviations.
WIDTH = 1.96


def number(value: float, digits: int = 4) -> str:
    """A number to so many significant digits."""
    return f"{value:.{digits}g}"


def with_uncertainty(value: float, std: float) -> tuple[str, str]:
    """Value and ± to the same decimal place: two digits of ± decide."""
    if not std > 0 or not math.isfinite(std):
        return number(value), ""
    place = 1 - math.floor(math.log10(std))
    if abs(value) >= 1e5 or place > 7 or place < 0:
        digits = max(2, 1 + math.floor(math.log10(max(abs(value), std) / std)) + 1)
        return f"{value:.{min(digits, 9) - 1}e}", f"{std:.1e}"
    return f"{value:.{place}f}", f"{std:.{place}f}"


def percent(value: float) -> str:
    """A share in per cent with two significant digits, or all before the decimal point."""
    digits = ".0f" if 99.5 <= 100 * abs(value) < 1e5 else ".2g"
    return f"{100 * value:{digits}} %"


def span(low: float, high: float) -> str:
    """An interval as 'low … high', two digits of half its width."""
    half = 0.5 * (high - low)
    if not half > 0 or not math.isfinite(half):
        return number(0.5 * (low + high))
    place = 1 - math.floor(math.log10(half))
    if max(abs(low), abs(high)) >= 1e5 or place > 7 or place < 0:
        return f"{low:.3g} … {high:.3g}"
    if place > 4 and half > 0.1 * max(abs(low), abs(high)):  # two digits say as much, without zeros
        return f"{low:.2g} … {high:.2g}"
    return f"{low:.{place}f} … {high:.{place}f}"
