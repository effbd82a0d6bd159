"""A table, for the terminal and for a page alike."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A table of finished cells.

    A page sets columns of numbers flush right, `muted` rows in grey, the first cell of `marked`
    rows in the colour of doubt, and the caption below; the terminal prints the title above. What
    `links` and `choices` say is for the pages of a site.

    Attributes:
        links: where the first cell of each row leads, empty for nowhere; none for no cell.
        choices: columns, by their numbers, of which one value can be chosen, in a table that one
            can search and sort; None for one that stays as it is.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    muted: frozenset[int] = frozenset()
    title: str = ""
    marked: frozenset[int] = frozenset()
    links: tuple[str, ...] = ()
    choices: tuple[int, ...] | None = None
