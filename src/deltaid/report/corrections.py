"""Table of what an identification put right, for the terminal and for pages alike."""

from collections.abc import Sequence

from deltaid.model.corrections import Correction
from deltaid.report.numbers import number
from deltaid.report.table import Table

# Units that are shown by a thousandth, with what they then are called.
_SMALLER = {"s": (1e3, "ms")}


def correction_table(corrections: Sequence[Correction]) -> Table | None:
    """All corrections in the order in which they were made; None if there are none."""
    if not corrections:
        return None
    several = len({one.log for one in corrections if one.log}) > 1
    rows = tuple(
        (
            one.kind,
            one.subject or "all",
            *((one.log or "all",) if several else ()),
            _size(one),
            one.text,
        )
        for one in corrections
    )
    return Table(
        ("corrected", "of", *(("recording",) if several else ()), "by (95 %)", "why"),
        rows,
        "What was put right before and in the fit. Intervals of the parameters hold with these "
        "corrections; each can be turned off.",
        title="corrections",
    )


def _size(one: Correction) -> str:
    """Value, interval and unit."""
    if one.value is None:
        return ""
    scale, unit = _SMALLER.get(one.unit, (1.0, one.unit))
    if one.low is None or one.high is None:
        return f"{number(scale * one.value)} {unit}".rstrip()
    half = 0.5 * scale * (one.high - one.low)
    return f"{number(scale * one.value)} ± {half:.1g} {unit}".rstrip()
