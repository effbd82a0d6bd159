"""Numbers and names as verdicts say them."""

from collections.abc import Sequence


def percent(share: float) -> str:
    """A share in per cent: two significant digits, or all before the decimal point."""
    number = 100 * share
    return f"{number:.0f} %" if abs(number) >= 9.95 else f"{number:.2g} %"


def listed(names: Sequence[str]) -> str:
    """'drive1', 'drive1 and drive3', 'drive1, drive2 and drive3'."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"
