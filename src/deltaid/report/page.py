"""A page of text, tables and figures, rendered as one HTML file that makes no request.

Builders of this folder describe a page with the classes here; what it looks like is decided in
`page.html.jinja`, `page.css` and `page.js`, and for figures in `style.py`.
"""

import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import plotly.graph_objects as go
import plotly.io
from jinja2 import Environment, PackageLoader
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from deltaid.errors import visible
from deltaid.files import written_whole
from deltaid.report import style
from deltaid.report.table import Table

# Cells longer than this may break into lines.
_LONG = 40
_UNIT = re.compile(r"\[.*?\]|\d %")
_STARTS = re.compile(r"[<>≥≤±~−+-]?\s*\d")
_NUMBER = re.compile(r"(?<![\w.])(-?)(\d+(?:\.\d+)?)(?:e([+-])0*(\d+))?(?![\w.])")
# What a cell of numbers holds besides them.
_AROUND = re.compile(r"[\s…,×≥≤±%]*")
_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


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
    """A Plotly figure without template or width, which are the page's; its height is its own."""

    figure: go.Figure
    caption: str = ""


Block = Text | Table | Lines | Figure


@dataclass(frozen=True)
class Section:
    """A chapter of the page, listed in its contents."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Fact:
    """A key figure at the top of the page."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Page:
    """Everything a page says; `problems` are what makes its figures worthless, in red."""

    title: str
    subtitle: str
    facts: tuple[Fact, ...]
    sections: tuple[Section, ...]
    warnings: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


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
    environment = Environment(
        loader=PackageLoader("deltaid", "report"),
        autoescape=True,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    cast("dict[str, Any]", environment.tests).update(
        {kind.__name__.lower(): _is(kind) for kind in (Text, Table, Lines, Figure)}
    )
    cast("dict[str, Any]", environment.filters).update(
        {
            "json": _figure_json,
            "paragraphs": _paragraphs,
            "numeric": _numeric,
            "cell": _cell,
            "heading": _heading,
            "typeset": _typeset,
            "long": lambda cell: len(cell) > _LONG,
        }
    )
    templates = [_embedded(style.template(dark).to_plotly_json()) for dark in (False, True)]
    return environment.get_template("page.html.jinja").render(
        page=page,
        css=_part("page.css"),
        script=_part("page.js"),
        plotly=Markup(get_plotlyjs()),
        light=templates[0],
        dark=templates[1],
    )


def _shown(value: object) -> object:
    """What a page prints of a value that is not markup of its own: no control characters."""
    return visible(value) if type(value) is str else value


def _is(kind: type) -> object:
    return lambda block: isinstance(block, kind)


def _part(name: str) -> Markup:
    return Markup(files("deltaid.report").joinpath(name).read_text(encoding="utf-8"))


def _figure_json(block: Figure) -> Markup:
    """Data, layout and frames; numpy arrays as base64."""
    figure = block.figure.to_plotly_json()
    figure["layout"].pop("template", None)
    return _embedded(figure)


def _embedded(value: dict[str, Any]) -> Markup:
    """JSON that stays inside its script element whatever its strings hold.

    Plotly's own encoder escapes the same character, but does not promise to.
    """
    text = plotly.io.json.to_json_plotly(value)
    return Markup(text.replace("<", "\\u003c"))


def _numeric(table: Table, column: int) -> bool:
    """Whether a column holds numbers: each filled cell starts with one."""
    cells = [row[column] for row in table.rows if row[column] not in ("", "—")]
    return bool(cells) and all(_STARTS.match(cell) for cell in cells)


def _paragraphs(text: str) -> list[str]:
    """Paragraphs of a text; a per cent sign stays on the line of its number."""
    parts = text.replace(" %", "\N{NO-BREAK SPACE}%").split("\n\n")
    return [part for part in parts if part.strip()]


def _heading(text: str) -> str:
    """Head of a column, which may take several lines; a unit or a per cent sign stays whole."""
    return _UNIT.sub(lambda match: match[0].replace(" ", "\N{NO-BREAK SPACE}"), text)


def _cell(text: str) -> str:
    """A cell that holds nothing but numbers typeset, any other as it is."""
    return _typeset(text) if _AROUND.fullmatch(_NUMBER.sub("", text)) else text


def _typeset(text: str) -> str:
    """Numbers with a minus sign and powers of ten: '-1.2e-05' becomes '−1.2·10⁻⁵'."""

    def written(match: re.Match[str]) -> str:
        sign, digits, exponent_sign, exponent = match.groups()
        power = ""
        if exponent:
            power = "·10" + (exponent_sign.strip("+") + exponent).translate(_SUPERSCRIPTS)
        return ("−" if sign else "") + digits + power

    return _NUMBER.sub(written, text)
