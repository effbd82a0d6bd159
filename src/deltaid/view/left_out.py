"""Table of what was left out of recordings, for the terminal and for pages alike."""

from collections.abc import Iterable, Sequence

from deltaid.model.left_out import LeftOut, Span
from deltaid.view.numbers import percent
from deltaid.view.table import Table

# Spans that a cell lists.
_SHOWN = 3


def left_out_table(logs: Iterable[tuple[str, Sequence[LeftOut]]]) -> Table | None:
    """Reason, share and times; None where nothing was left out but reversals.

    Args:
        logs: names of recordings, and what was left out of them.
    """
    logs = [(name, found) for name, found in logs if found]
    several = len(logs) > 1
    rows = tuple(
        (
            *((name,) if several else ()),
            one.reason,
            _named(one.drives),
            percent(one.share),
            _when(one.spans, one.more),
        )
        for name, found in logs
        for one in found
    )
    if not any(one.spans for _, found in logs for one in found):
        return None
    why = {one.reason: one.why for _, found in logs for one in found}
    words = "; ".join(f"{reason}: {text}" for reason, text in why.items())
    return Table(
        (*(("recording",) if several else ()), "left out", "drives", "of the rows", "when [s]"),
        rows,
        f"What was left out because it says nothing about the drives' torques, or something "
        f"wrong. {words[0].upper()}{words[1:]}. --keep-all (keep_all of the settings) goes without "
        "all of this.",
    )


def _named(drives: Sequence[str]) -> str:
    numbers = [drive.removeprefix("drive") for drive in drives]
    return ", ".join(numbers)


def _when(spans: Sequence[Span], more: int) -> str:
    shown = ", ".join(f"{span.start:.3f}–{span.end:.3f}" for span in spans[:_SHOWN])
    rest = len(spans) + more - _SHOWN
    return f"{shown} and {rest} more" if rest > 0 else shown


def reversals(found: Sequence[LeftOut]) -> str:
    """What was left out at reversals, as the end of a sentence; empty if nothing was."""
    return "".join(
        f", {percent(one.share)} left out at reversals" for one in found if not one.spans
    )
