"""Numbers as people write them at a prompt: `200 mm`, `0.2`, `3 kg cm²`, `30°`."""

import re
from functools import cache
from typing import TYPE_CHECKING

from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    import pint

# A number, then units made of names, small powers, products and quotients, so that a text is never
# computed beyond that.
_GRAMMAR = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,2})?)\s*([A-Za-zµμ°²³^*/·\d\s]*)")
_LONGEST = 40


def quantity(text: str, unit: str, where: str = "the answer") -> float:
    """A number in `unit`; one without a unit is in it already. `where` names it in messages.

    Raises:
        DeltaidError: it is no number, or its unit is of another kind.
    """
    import pint

    text = text.strip()
    found = _GRAMMAR.fullmatch(text) if len(text) <= _LONGEST else None
    if found is None:
        comma = ", with a point and no comma" if "," in text else ""
        what = f"{text[:_LONGEST]!r} is not a number{comma}"
        raise DeltaidError(what, where=where, cure=f"write {_example(unit)}")
    number, words = float(found[1]), found[2].strip()
    if not words:
        return number
    for sign, name in (("°", "degree"), ("·", "*"), ("²", "**2"), ("³", "**3"), ("^", "**")):
        words = words.replace(sign, name)
    # Spaces between names are products.
    words = re.sub(r"(?<=[A-Za-zµμ\d])\s+(?=[A-Za-zµμ])", "*", words)
    try:
        given = _registry().parse_units(words)
        return float(_registry().Quantity(number, given).to(unit).magnitude)
    except (pint.PintError, ValueError, TypeError, AttributeError):
        raise DeltaidError(
            f"{found[2].strip()!r} is no unit for this",
            where=where,
            cure=f"write {_example(unit)}",
        ) from None


def _example(unit: str) -> str:
    """Two ways to write such a number."""
    other = {
        "m": "200 mm or 0.2 (m)",
        "kg": "800 g or 0.8 (kg)",
        "degree": "30° or 30 (degrees)",
        "degree/s": "400 rpm or 2400 (degrees/s)",
        "m/s": "2.5 m/s or 2.5",
        "kg*m**2": "12 kg cm² or 0.0012 (kg m²)",
        "N*m": "80 N m or 80",
        "N": "600 N or 600",
    }
    return other.get(unit, f"a number in {unit}")


@cache
def _registry() -> "pint.UnitRegistry[float]":
    import pint

    return pint.UnitRegistry()
