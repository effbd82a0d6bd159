"""A page as one HTML file that makes no request.

What it looks like is decided in `page.html.jinja`, `page.css` and `page.js`, and for figures in
`style.py`. Its first screen says the verdict, shows the robot and says how the page was made; what
is behind it unfolds below.
"""

import base64
import gzip
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import plotly.io
from jinja2 import ChoiceLoader, Environment, PackageLoader
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from deltaid.errors import visible
from deltaid.files import written_whole
from deltaid.view import style, typeset
from deltaid.view.page import Chart, Figure, Lines, Page, Table, Text

# Cells longer than this may break into lines.
_LONG = 40


def write_page(page: Page, path: Path) -> None:
    """Write a page under a name, whole or not at all.

    Raises:
        DeltaidError: the file cannot be written.
    """
    with written_whole(path) as file:
        file.write(render(page))


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
        loader=ChoiceLoader([PackageLoader("deltaid", name) for name in (room, "view")]),
        autoescape=True,
        # No control characters, but in markup of the page's own.
        finalize=lambda value: visible(value) if type(value) is str else value,
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
    return Markup(plotly.io.json.to_json_plotly(value).replace("<", "\\u003c"))


@cache
def _plotly() -> Markup:
    """Plotly's script, packed: unpacked by the browser, it makes a page half as large."""
    return Markup(base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode())
