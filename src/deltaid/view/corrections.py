"""Table of what an identification put right, for the terminal and for pages alike."""

from collections.abc import Sequence
from itertools import groupby

from deltaid.model.corrections import Correction
from deltaid.view.numbers import number, with_uncertainty
from deltaid.view.table import Table

# Units that are shown by a thousandth, with what they then are called.
_SMALLER = {"s": (1e3, "ms")}


def correction_table(corrections: Sequence[Correction]) -> Table | None:
    """All corrections in the order in which they were made; None if there are none.

    Drives that were corrected alike share a row.
    """
    if not corrections:
        return None
    several = len({one.log for one in corrections if one.log}) > 1
    alike = groupby(corrections, key=lambda one: (one.kind, one.log, _size(one), one.text))
    rows = tuple(
        (
            kind,
            ", ".join(one.subject for one in group if one.subject) or "all",
            *((log or "all",) if several else ()),
            size,
            text,
        )
        for (kind, log, size, text), group in alike
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
    small = abs(one.value) < 1
    scale, unit = _SMALLER.get(one.unit, (1.0, one.unit)) if small else (1.0, one.unit)
    if one.low is None or one.high is None:
        return f"{number(scale * one.value)} {unit}".rstrip()
    value, half = with_uncertainty(scale * one.value, 0.5 * scale * (one.high - one.low))
    return f"{value}{half and f' ± {half}'} {unit}".rstrip()
