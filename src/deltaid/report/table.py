"""A table, for the terminal and for a page alike."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A table of finished cells.

    A page sets columns of numbers flush right, `muted` rows in grey, the first cell of `marked`
    rows in the colour of doubt, and the caption below; the terminal prints the title above.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    muted: frozenset[int] = frozenset()
    title: str = ""
    marked: frozenset[int] = frozenset()
