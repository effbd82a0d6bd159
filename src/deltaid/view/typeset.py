"""Text as a page sets it: numbers, units, and short names with what they stand for."""

import re
from collections.abc import Iterable

from markupsafe import Markup, escape

from deltaid.errors import visible
from deltaid.robot.body import body_in_words
from deltaid.view.page import Table

_UNIT = re.compile(r"\[.*?\]|\d %")
_STARTS = re.compile(r"[<>≥≤±~−+-]?\s*\d(?!\d{3}-\d\d)")  # a date is no number
_NUMBER = re.compile(r"(?<![\w.])(-?)(\d+(?:\.\d+)?)(?:e([+-])0*(\d+))?(?![\w.])")
# Those of a sentence that need setting; names of files and options hold none.
_IN_PROSE = re.compile(
    r"(?<![\w.:/-])(?:(-)(?=\d)|(?=\d+(?:\.\d+)?e[+-]))(\d+(?:\.\d+)?)(?:e([+-])0*(\d+))?(?![\w./-])"
)
# What a cell of numbers holds besides them.
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
# 'U.mcx', in formulas 'mcx_U', in descriptions 'bodies.U', of what a body is put on 'scale:U'.
NAME = re.compile(
    rf"(?<![\w.])(?:(?P<body>[^\W\d_]\w*)\.(?P<entry>{_ENTRY})|(?P<first>{_ENTRY})_(?P<of>\w+)"
    r"|bodies\.(?P<key>\w+)|(?P<tool>[a-z][a-z-]*):(?P<on>[A-Z]+\d*))(?!\w)"
)


def numeric(table: Table, column: int) -> bool:
    """Whether a column holds numbers: each filled cell starts with one."""
    cells = [row[column] for row in table.rows if row[column] not in ("", "—")]
    return bool(cells) and all(_STARTS.match(cell) for cell in cells)


def paragraphs(text: str) -> list[str]:
    """Paragraphs of a text; a per cent sign stays on the line of its number."""
    parts = text.replace(" %", "\N{NO-BREAK SPACE}%").split("\n\n")
    return [part for part in parts if part.strip()]


def heading(text: str) -> str:
    """Head of a column, which may take several lines; a unit or a per cent sign stays whole."""
    return _UNIT.sub(lambda match: match[0].replace(" ", "\N{NO-BREAK SPACE}"), text)


def cell(text: str) -> str | Markup:
    """A cell that holds nothing but numbers typeset, any other with its short names explained."""
    return typeset(text) if _AROUND.fullmatch(_NUMBER.sub("", text)) else explained(text)


def typeset(text: str) -> str:
    """Numbers with a minus sign and powers of ten: '-1.2e-05' becomes '−1.2·10⁻⁵'."""

    return _NUMBER.sub(_written, text)


def _written(match: re.Match[str]) -> str:
    sign, digits, exponent_sign, exponent = match.groups()
    raised = f"{exponent_sign or ''}{exponent or ''}".strip("+").translate(_SUPERSCRIPTS)
    return ("−" if sign else "") + digits + (f"·10{raised}" if exponent else "")


def _prose(text: str) -> str:
    return visible(_IN_PROSE.sub(_written, text))


def explained(text: str) -> Markup:
    """A sentence whose short names of bodies and entries say what they stand for; numbers set."""
    parts = text.split(", ")
    if all(is_short(part) for part in parts):
        return Markup(", ").join(_short(part, body_in_words(part)) for part in parts)
    pieces, at = [], 0
    for name in NAME.finditer(text):
        pieces += [escape(_prose(text[at : name.start()])), _short(name[0], name_in_words(name))]
        at = name.end()
    return Markup("").join([*pieces, escape(_prose(text[at:]))])


def legend(table: Table) -> tuple[tuple[str, str], ...]:
    """Short names of bodies in a table, and what they stand for; links have names of their own."""
    first = 1 if table.links else 0
    cells = [*table.columns, *(cell for row in table.rows for cell in row[first:])]
    return tuple((name, body_in_words(name)) for name in bodies_in(cells))


def _short(name: str, words: str) -> Markup:
    return Markup('<abbr title="{}">{}</abbr>').format(visible(words), visible(name))


def name_in_words(name: "re.Match[str]") -> str:
    """'upper arm: mass' of a `NAME`."""
    entry = name["entry"] or name["first"]
    if name["tool"]:
        return f"{name['tool']}: {body_in_words(name['on'])}"
    return body_in_words(body_of(name)) + (f": {_ENTRIES[entry]}" if entry else "")


def body_of(name: "re.Match[str]") -> str:
    """U of a `NAME`."""
    return name["body"] or name["of"] or name["key"] or name["on"]


def is_short(name: str) -> bool:
    """Whether a word is a body's short name, which needs explaining."""
    return body_in_words(name) != name


def bodies_in(cells: Iterable[str]) -> tuple[str, ...]:
    """Short names of bodies in the cells of a table, each once: alone, in a list, in names."""
    found: list[str] = []
    for cell in cells:
        parts = cell.split(", ")
        found += parts if all(is_short(part) for part in parts) else []
        found += [body_of(name) for name in NAME.finditer(cell)]
    return tuple(name for name in dict.fromkeys(found) if is_short(name))
