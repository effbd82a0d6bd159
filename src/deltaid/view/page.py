"""A page as data: text, tables and figures, headed by verdict, picture and origin.

Builders of this room compose pages of these classes; `html.py` renders them, and the terminal and
notebooks print the same tables. Imports are fast, because short commands print tables too.
"""

import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import plotly.graph_objects as go
    from markupsafe import Markup

# Default height of figures [px].
HEIGHT = 450
# Longest readable line [characters].
WIDEST = 100
_COMMAND = "deltaid"


@dataclass(frozen=True)
class Text:
    """Plain text; an empty line starts a new paragraph."""

    text: str


@dataclass(frozen=True)
class Table:
    """A table of formatted cells.

    A page aligns columns of numbers to the right, shows `muted` rows in grey, the first cell of
    `marked` rows in the colour of doubt, and the caption below; the terminal prints the title
    above. `links` and `choices` are for the pages of a site.

    Attributes:
        links: target of the first cell of each row, empty for none; no entries for no links.
        choices: indices of columns with a filter by value, in a table with search and sorting; None
            for a static table.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    muted: frozenset[int] = frozenset()
    title: str = ""
    marked: frozenset[int] = frozenset()
    links: tuple[str, ...] = ()
    choices: tuple[int, ...] | None = None

    def without(self, *columns: str) -> "Table":
        """The table without some columns, if it has them."""
        kept = [k for k, name in enumerate(self.columns) if name not in columns]
        rows = tuple(tuple(row[k] for k in kept) for row in self.rows)
        return replace(self, columns=tuple(self.columns[k] for k in kept), rows=rows)


@dataclass(frozen=True)
class Lines:
    """Lines of a file, to be copied verbatim."""

    text: str


@dataclass(frozen=True)
class Figure:
    """A Plotly figure without template and width, which the page sets.

    Attributes:
        paper: its largest height on paper [px], where a page has 1000.
    """

    figure: "go.Figure"
    caption: str = ""
    paper: int = 880

    @property
    def height(self) -> int | float:
        """Height on screen [px]."""
        return self.figure.layout.height or HEIGHT

    def data(self) -> dict[str, Any]:
        """Traces, layout and frames; numpy arrays as base64."""
        return self.figure.to_plotly_json()


@dataclass(frozen=True)
class Chart(Figure):
    """A figure as plain data, for thousands of pages: Plotly's classes take 0.1 s per page."""

    figure: Mapping[str, Any]

    @property
    def height(self) -> int | float:
        """Height on screen [px]."""
        return self.figure["layout"].get("height", HEIGHT)

    def data(self) -> dict[str, Any]:
        return {"data": self.figure["data"], "layout": dict(self.figure["layout"])}


Block = Text | Table | Lines | Figure


@dataclass(frozen=True)
class Section:
    """A section of the page, listed in its contents.

    Attributes:
        blocks: its content; None and tables without rows are dropped.
        about: its content, in a line that is visible while it is folded.
        unfolded: whether it is open when the page is opened, and on paper.
    """

    title: str
    blocks: tuple[Block | None, ...]
    about: str = ""
    unfolded: bool = False

    def __post_init__(self) -> None:
        kept = (b for b in self.blocks if b is not None and (not isinstance(b, Table) or b.rows))
        object.__setattr__(self, "blocks", tuple(kept))


@dataclass(frozen=True)
class Fact:
    """A key figure at the top of the page."""

    label: str
    value: str
    note: str = ""


class Trust(StrEnum):
    """Grade of a model.

    - good: predicts every drive on an unseen motion within 5 %, at most 1 % of a drive's torque is
      unexplained, and nothing about its recordings or its fit is doubtful;
    - fair: predicts within 15 %, or within 5 % while something is doubtful, and at most 15 % is
      unexplained;
    - poor: worse than that, much worse than in the identification, identified with `--force` from
      recordings that the checks call wrong, or not physically consistent;
    - untested: there is no unseen motion yet, and no reason to call it poor. A good fit of its own
      recording does not make a model good.
    """

    GOOD = "good"
    FAIR = "fair"
    POOR = "poor"
    UNTESTED = "untested"


@dataclass(frozen=True)
class Summary:
    """A verdict in plain words.

    Attributes:
        grade: how far the model may be trusted.
        sentence: the verdict, such as "Good: predicts torques of an unseen motion within 1.2 %.".
        lines: additional sentences: origin of its numbers, corrections, doubts.
    """

    grade: Trust
    sentence: str
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Drawing:
    """A picture of lines, which scales and has the colours of the page.

    Attributes:
        svg: an SVG element.
        names: short names of the bodies, and their meaning.
    """

    svg: "Markup"
    names: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Made:
    """Origin of a page.

    Attributes:
        command: as typed; empty for a page that another program made.
        on: day and time, with the offset from UTC.
    """

    command: str
    on: str
    version: str


def page_origin() -> Made:
    """The origin of a page that this process makes now."""
    typed = bool(sys.argv) and Path(sys.argv[0]).stem == _COMMAND
    command = shlex.join([_COMMAND, *sys.argv[1:]]) if typed else ""
    return Made(
        command, datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %z"), version("deltaid")
    )


@dataclass(frozen=True)
class Page:
    """Content of a page.

    Attributes:
        facts: key figures.
        sections: sections that unfold; those without blocks are dropped; without a front, the
            first one is open.
        verdict: in plain words, at the top.
        drawing: of the robot, with its bodies named.
        front: tables and figures that every reader should see, on screen and on paper.
        made: how the page was made.
    """

    title: str
    subtitle: str
    facts: tuple[Fact, ...]
    sections: tuple[Section, ...]
    warnings: tuple[str, ...] = ()
    verdict: Summary | None = None
    drawing: Drawing | None = None
    front: tuple[Block, ...] = ()
    made: Made = field(default_factory=page_origin)

    def __post_init__(self) -> None:
        sections = tuple(section for section in self.sections if section.blocks)
        object.__setattr__(self, "sections", sections)

    @property
    def has_figures(self) -> bool:
        """Whether the page needs Plotly."""
        blocks = [*self.front, *(block for section in self.sections for block in section.blocks)]
        return any(isinstance(block, Figure) for block in blocks)

    def is_open(self, section: Section) -> bool:
        """Whether a section is initially open."""
        bare = not self.front and not any(other.unfolded for other in self.sections)
        return section.unfolded or (bare and section is self.sections[0])
