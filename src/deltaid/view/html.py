"""A page as one HTML file that loads nothing else.

`page.html.jinja`, `page.css` and `page.js` define its look, `style.py` that of figures. The first
screen shows the verdict, the robot and the origin of the page; sections unfold below.
"""

import base64
import gzip
import re
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import plotly.io
from jinja2 import ChoiceLoader, Environment, PackageLoader
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from deltaid.errors import visible
from deltaid.files import write_bytes
from deltaid.robot.body import body_in_words
from deltaid.view import style
from deltaid.view.page import Figure, Lines, Page, Table, Text

# Length above which cells may break into lines [characters].
_LONG = 40


def write_page(page: Page, path: Path) -> None:
    """Write a page to a file, whole or not at all.

    Raises:
        DeltaidError: the file cannot be written.
    """
    write_bytes(path, render(page).encode())


def render(page: Page) -> str:
    """The page as one HTML document that contains style, script, Plotly and data."""
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
    """Variables of `page.html.jinja`, or of a template that extends it, for a page."""
    light, dark = (_embedded(style.template(dark).to_plotly_json()) for dark in (False, True))
    return {"page": page, "light": light, "dark": dark}


@cache
def environment(room: str = "view") -> Environment:
    """Jinja environment with the templates of a room and those of pages."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader("deltaid", name) for name in (room, "view")]),
        autoescape=True,
        # Control characters are allowed in the page's own markup only.
        finalize=lambda value: visible(value) if type(value) is str else value,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    kinds: tuple[type, ...] = (Text, Table, Lines, Figure)
    cast("dict[str, Any]", environment.tests).update(
        {k.__name__.lower(): lambda block, kind=k: isinstance(block, kind) for k in kinds}
    )
    setters = (paragraphs, numeric, cell, heading, typeset, explained, legend, reading)
    cast("dict[str, Any]", environment.filters).update(
        {f.__name__: f for f in setters},
        json=_figure_json,
        words=body_in_words,
        long=lambda cell: len(cell) > _LONG,
    )
    return environment


# Number of decimals of readings, by unit.
_DECIMALS = {"deg": 1, "m": 4, "N": 1}


def reading(value: float, unit: str = "") -> str:
    """A number with a fixed number of decimals, without negative zero."""
    digits = _DECIMALS.get(unit, 2)
    return f"{round(value, digits) + 0.0:.{digits}f} {unit}".rstrip()


def part(name: str, room: str = "view") -> Markup:
    """Content of a file of a room, such as the style of pages."""
    return Markup(files("deltaid").joinpath(room, name).read_text(encoding="utf-8"))


def _figure_json(block: Figure) -> Markup:
    figure = block.data()
    figure["layout"].pop("template", None)
    return _embedded(figure)


def _embedded(value: dict[str, Any]) -> Markup:
    """JSON that cannot end its script element, whatever its strings hold.

    Plotly's own encoder escapes the same character, but does not guarantee it.
    """
    return Markup(plotly.io.json.to_json_plotly(value).replace("<", "\\u003c"))


@cache
def _plotly() -> Markup:
    """Plotly's script, compressed; the browser unpacks it, which halves the size of a page."""
    return Markup(base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode())


_UNIT = re.compile(r"\[.*?\]|\d %")
_STARTS = re.compile(r"[<>≥≤±~−+-]?\s*\d(?!\d{3}-\d\d)")  # dates are no numbers
_WORDS = re.compile(r"[a-z]{2,} [a-z]{2,}")
_NUMBER = re.compile(r"(?<![\w.])(-?)(\d+(?:\.\d+)?)(?:e([+-])0*(\d+))?(?![\w.])")
# Numbers in a sentence that need typesetting; those in names of files and options are skipped.
_IN_PROSE = re.compile(
    r"(?<![\w.:/-])(?:(-)(?=\d)|(?=\d+(?:\.\d+)?e[+-]))(\d+(?:\.\d+)?)(?:e([+-])0*(\d+))?(?![\w./-])"
)
# Characters besides digits in a cell of numbers.
_AROUND = re.compile(r"[\s…,×≥≤±%]*")
_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_MIXED = ("xy", "xz", "yz")
# Entries of the parameter vector, in words.
_ENTRIES = {
    "m": "mass",
    **{f"mc{axis}": f"mass times centre of mass along {axis}" for axis in "xyz"},
    **{f"I{axis}{axis}": f"moment of inertia about {axis}" for axis in "xyz"},
    **{f"I{a}{b}": f"product of inertia of {a} and {b}" for a, b in _MIXED},
    **{f"S{axis}{axis}": f"second moment of mass along {axis}" for axis in "xyz"},
    **{f"S{a}{b}": f"second moment of mass along {a} and {b}" for a, b in _MIXED},
}
_ENTRY = rf"(?:{'|'.join(_ENTRIES)})"
# Forms of names: 'U.mcx', in formulas 'mcx_U', in descriptions 'bodies.U', of a scale 'scale:U'.
_NAME = re.compile(
    rf"(?<![\w.])(?:(?P<body>[^\W\d_]\w*)\.(?P<entry>{_ENTRY})|(?P<first>{_ENTRY})_(?P<of>\w+)"
    r"|bodies\.(?P<key>\w+)|(?P<tool>[a-z][a-z-]*):(?P<on>[A-Z]+\d*))(?!\w)"
)


def numeric(table: Table, column: int) -> bool:
    """Whether a column holds numbers: each non-empty cell begins with one, and none goes on as a
    sentence does, with two words."""
    cells = [row[column] for row in table.rows if row[column] not in ("", "—")]
    return bool(cells) and all(_STARTS.match(cell) and not _WORDS.search(cell) for cell in cells)


def paragraphs(text: str) -> list[str]:
    """Paragraphs of a text; a per cent sign stays on the line of its number."""
    text = text.replace(" %", "\N{NO-BREAK SPACE}%")
    return [paragraph for paragraph in text.split("\n\n") if paragraph.strip()]


def heading(text: str) -> str:
    """Head of a column, which may break into lines but not within a unit or before a per cent
    sign."""
    return _UNIT.sub(lambda match: match[0].replace(" ", "\N{NO-BREAK SPACE}"), text)


def cell(text: str) -> str | Markup:
    """A cell of numbers typeset, or of text with its short names explained."""
    return typeset(text) if _AROUND.fullmatch(_NUMBER.sub("", text)) else explained(text)


def typeset(text: str) -> str:
    """Numbers with a minus sign and powers of ten: '-1.2e-05' becomes '−1.2·10⁻⁵'."""
    return _NUMBER.sub(_typeset_number, text)


def _typeset_number(match: re.Match[str]) -> str:
    sign, digits, exponent_sign, exponent = match.groups()
    raised = f"{exponent_sign or ''}{exponent or ''}".strip("+").translate(_SUPERSCRIPTS)
    return ("−" if sign else "") + digits + (f"·10{raised}" if exponent else "")


def _prose(text: str) -> str:
    return visible(_IN_PROSE.sub(_typeset_number, text))


def explained(text: str) -> Markup:
    """A sentence with typeset numbers and with explanations of short names of bodies and
    entries."""
    parts = text.split(", ")
    if all(_is_short(part) for part in parts):
        return Markup(", ").join(_short(part, body_in_words(part)) for part in parts)
    pieces, at = [], 0
    for name in _NAME.finditer(text):
        body, entry = body_in_words(_body_of(name)), name["entry"] or name["first"]
        words = f"{name['tool']}: {body}" if name["tool"] else body
        words += f": {_ENTRIES[entry]}" if entry else ""
        pieces += [_prose(text[at : name.start()]), _short(name[0], words)]
        at = name.end()
    return Markup("").join([*pieces, _prose(text[at:])])


def _short(name: str, words: str) -> Markup:
    return Markup('<abbr title="{}">{}</abbr>').format(visible(words), visible(name))


def legend(table: Table) -> tuple[tuple[str, str], ...]:
    """Short names of bodies in a table with their meaning, each once: alone, in lists, and in names
    of entries. Cells with links are skipped."""
    first, names = 1 if table.links else 0, list[str]()
    for cell in (*table.columns, *(cell for row in table.rows for cell in row[first:])):
        parts = cell.split(", ")
        names += parts if all(_is_short(part) for part in parts) else []
        names += [_body_of(name) for name in _NAME.finditer(cell)]
    return tuple((name, body_in_words(name)) for name in dict.fromkeys(names) if _is_short(name))


def _body_of(name: re.Match[str]) -> str:
    return name["body"] or name["of"] or name["key"] or name["on"]


def _is_short(name: str) -> bool:
    return body_in_words(name) != name
