"""A page of text, tables and figures, rendered as one HTML file that makes no request.

Builders of this folder describe a page with the classes here; what it looks like is decided in
`page.html.jinja`, `page.css` and `page.js`, and for figures in `style.py`. Its first screen says
the verdict, shows the robot and says how the page was made; what is behind it unfolds below.
"""

import base64
import gzip
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import plotly.graph_objects as go
import plotly.io
from jinja2 import ChoiceLoader, Environment, PackageLoader
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from deltaid.errors import visible
from deltaid.files import written_whole
from deltaid.view import style, typeset
from deltaid.view.drawing import Drawing
from deltaid.view.made import Made, made
from deltaid.view.summary import Summary
from deltaid.view.table import Table

# Cells longer than this may break into lines.
_LONG = 40
# Of figures that do not say theirs [px].
_HEIGHT = 450


@dataclass(frozen=True)
class Text:
    """Plain text; an empty line starts a new paragraph."""

    text: str


@dataclass(frozen=True)
class Lines:
    """Lines of a file, to be copied as they stand."""

    text: str
    caption: str = ""


@dataclass(frozen=True)
class Figure:
    """A Plotly figure without template or width, which are the page's; its height is its own.

    Attributes:
        paper: its largest height on paper [px], of which a page has a thousand.
    """

    figure: go.Figure
    caption: str = ""
    paper: int = 880

    @property
    def height(self) -> int | float:
        """On screen [px]."""
        return self.figure.layout.height or _HEIGHT

    def data(self) -> dict[str, Any]:
        """Traces, layout and frames; numpy arrays as base64."""
        return self.figure.to_plotly_json()


@dataclass(frozen=True)
class Chart:
    """The same as plain data, for pages by the thousand: Plotly's classes take 0.1 s a page."""

    figure: Mapping[str, Any]
    caption: str = ""
    paper: int = 880

    @property
    def height(self) -> int | float:
        """On screen [px]."""
        return self.figure["layout"].get("height", _HEIGHT)

    def data(self) -> dict[str, Any]:
        """Traces and layout."""
        return {"data": self.figure["data"], "layout": dict(self.figure["layout"])}


Block = Text | Table | Lines | Figure | Chart


@dataclass(frozen=True)
class Section:
    """A chapter of the page, listed in its contents.

    Attributes:
        about: what one finds in it, in a line that is read while it is folded.
        unfolded: whether it is open when the page is opened, and so on paper.
    """

    title: str
    blocks: tuple[Block, ...]
    about: str = ""
    unfolded: bool = False


@dataclass(frozen=True)
class Fact:
    """A key figure at the top of the page."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Page:
    """Everything a page says.

    Attributes:
        facts: key figures.
        sections: chapters that unfold; where there is no front, the first one is open.
        verdict: in plain words, before anything else.
        drawing: of the robot, with its bodies named.
        front: tables and figures that everyone should see, on screen and on paper.
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
    made: Made = field(default_factory=made)

    @property
    def has_figures(self) -> bool:
        """Whether there is anything that Plotly draws."""
        blocks = [*self.front, *(block for one in self.sections for block in one.blocks)]
        return any(isinstance(block, Figure | Chart) for block in blocks)

    def is_open(self, section: Section) -> bool:
        """Whether a chapter is open to begin with."""
        bare = not self.front and not any(one.unfolded for one in self.sections)
        return section.unfolded or (bare and section is self.sections[0])


def write_page(page: Page, path: Path) -> None:
    """Write a page under a name, whole or not at all.

    Raises:
        DeltaidError: the file cannot be written.
    """
    text = render(page)
    with written_whole(path) as file:
        file.write(text)


def render(page: Page) -> str:
    """The page as one HTML document: style, script, Plotly and data inside, nothing outside."""
    return (
        environment()
        .get_template("page.html.jinja")
        .render(
            **contents(page),
            css=part("page.css"),
            script=part("page.js"),
            plotly=_plotly() if page.has_figures else Markup(""),
        )
    )


def contents(page: Page) -> dict[str, Any]:
    """What the template `page.html.jinja`, or one that extends it, shows of a page."""
    light, dark = (_embedded(style.template(dark).to_plotly_json()) for dark in (False, True))
    return {"page": page, "light": light, "dark": dark}


@cache
def environment(room: str = "view") -> Environment:
    """Templates of a room, and those of pages, with all that they need to show a page."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader("deltaid", one) for one in (room, "view")]),
        autoescape=True,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    cast("dict[str, Any]", environment.tests).update(
        {kind.__name__.lower(): _is(kind) for kind in (Text, Table, Lines, Figure, Chart)}
    )
    cast("dict[str, Any]", environment.filters).update(
        {
            "json": _figure_json,
            "paragraphs": typeset.paragraphs,
            "numeric": typeset.numeric,
            "cell": typeset.cell,
            "heading": typeset.heading,
            "typeset": typeset.typeset,
            "explained": typeset.explained,
            "legend": typeset.legend,
            "long": lambda cell: len(cell) > _LONG,
        }
    )
    return environment


def _shown(value: object) -> object:
    """What a page prints of a value that is not markup of its own: no control characters."""
    return visible(value) if type(value) is str else value


def _is(kind: type) -> object:
    return lambda block: isinstance(block, kind)


def part(name: str) -> Markup:
    """A file of this room, such as the style of its pages."""
    return Markup(files("deltaid.view").joinpath(name).read_text(encoding="utf-8"))


def _figure_json(block: Figure | Chart) -> Markup:
    """What Plotly draws, without a template."""
    figure = block.data()
    figure["layout"].pop("template", None)
    return _embedded(figure)


def _embedded(value: dict[str, Any]) -> Markup:
    """JSON that stays inside its script element whatever its strings hold.

    Plotly's own encoder escapes the same character, but does not promise to.
    """
    text = plotly.io.json.to_json_plotly(value)
    return Markup(text.replace("<", "\\u003c"))


@cache
def _plotly() -> Markup:
    """Plotly's script, packed: unpacked by the browser, it makes a page half as large."""
    packed = gzip.compress(get_plotlyjs().encode(), mtime=0)
    return Markup(base64.b64encode(packed).decode())
