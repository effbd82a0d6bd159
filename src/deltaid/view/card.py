"""A card: what a value says of itself, as a few lines of text or as a small piece of HTML."""

import textwrap
from dataclasses import dataclass, fields, is_dataclass
from html import escape
from typing import Any

import numpy as np

from deltaid.errors import visible
from deltaid.view.page import Table

# Most of a representation in text: lines, and characters of one of them.
_LINES, _LINE = 10, 140
# Rows of a table that is shown, and of one that is folded away.
_ROWS, _FOLDED_ROWS = 8, 200
# Cells shorter than this are not broken.
_WHOLE = 24

_BOX = (
    "border:1px solid rgba(128,128,128,.35);border-radius:6px;padding:.6em .9em;"
    "max-width:60em;margin:.2em 0;line-height:1.45"
)
_COLOURS = {
    "good": "#1a7f37", "fair": "#8a6100", "doubtful": "#8a6100", "poor": "#b42318",
    "wrong": "#b42318",
}  # fmt: skip
_OTHER = "#57606a"
_CELL = "padding:.15em .7em .15em 0;vertical-align:top;border:0;background:none;color:inherit"
_NEXT = "margin-top:.4em;font-family:monospace;font-size:.85em;opacity:.7"
_NUMBERS = set("0123456789.-−+±%…e≥≤<>×– ")
# Arrays of up to so many numbers are written out; longer text is cut.
_WRITTEN, _CHARACTERS = 16, 60


@dataclass(frozen=True)
class Card:
    """What a value says of itself.

    Attributes:
        title: what it is.
        lines: sentences; the first is the verdict where there is a grade.
        apart: whether facts have a line each at a prompt.
        told: further sentences for a prompt; a notebook has a table of the same.
        grade: a word of `Grade`, of models or of checks; empty for what is not judged.
        facts: its main numbers, by name.
        table: the same as a table, for notebooks; None where facts are enough.
        more: what unfolds below in a notebook: title, and text or table.
        methods: what to do next, such as '.plot()'.
    """

    title: str
    lines: tuple[str, ...] = ()
    grade: str = ""
    facts: tuple[tuple[str, str], ...] = ()
    table: Table | None = None
    more: tuple[tuple[str, "str | Table"], ...] = ()
    methods: tuple[str, ...] = ()
    told: tuple[str, ...] = ()
    apart: bool = False


def text(card: Card) -> str:
    """The card as a few lines for a prompt."""
    facts = [f"{name} {value}" for name, value in card.facts]
    short = [
        card.title,
        *(
            textwrap.shorten(line, 2 * _LINE, placeholder=" …")
            for line in (*card.lines, *card.told)
        ),
        *([f"  {fact}" for fact in facts] if card.apart else [", ".join(facts)] if facts else []),
    ]
    folded = list[str]()
    for line in short:
        folded += textwrap.wrap(visible(line), 100, subsequent_indent="  ") or [""]
    if len(folded) > _LINES - 1:
        folded = [*folded[: _LINES - 2], "  …"]
    methods = f"→ {'  '.join(card.methods)}" if card.methods else ""
    return "\n".join([*folded, *([methods] if methods else [])])


def html(card: Card) -> str:
    """The card as HTML for a notebook."""
    parts = [f'<div style="{_BOX}"><strong>{_safe(card.title)}</strong>']
    lines = list(card.lines)
    if card.grade:
        colour = _COLOURS.get(card.grade, _OTHER)
        verdict = lines.pop(0) if lines else ""
        parts.append(
            f'<div><span style="background:{colour};color:#fff;border-radius:4px;padding:0 .45em">'
            f"{_safe(card.grade)}</span> {_safe(_without(verdict, card.grade))}</div>"
        )
    parts += [f"<div>{_safe(line)}</div>" for line in lines]
    if card.table is not None:
        parts.append(_table(card.table, _ROWS))
    elif card.facts:
        parts.append(_table(Table(("", ""), card.facts), _ROWS))
    for title, inside in card.more:
        body = _table(inside, _FOLDED_ROWS) if isinstance(inside, Table) else _lines(inside)
        parts.append(
            f'<details style="margin-top:.3em"><summary style="cursor:pointer">{_safe(title)}'
            f"</summary>{body}</details>"
        )
    if card.methods:
        methods = "&nbsp; ".join(_safe(method) for method in card.methods)
        parts.append(f'<div style="{_NEXT}">→ {methods}</div>')
    return "".join([*parts, "</div>"])


def _without(sentence: str, grade: str) -> str:
    """A verdict without its first word, which the label says."""
    head, colon, rest = sentence.partition(": ")
    return rest if colon and head.lower() == grade else sentence


def _lines(inside: str) -> str:
    """Text, line by line, with the spaces at their beginnings."""
    inner = "".join(f"<div>{_safe(line)}</div>" for line in inside.splitlines())
    return f'<div style="white-space:pre-wrap;margin:.3em 0">{inner}</div>'


def _table(table: Table, most: int) -> str:
    """Rows and head; of more rows than `most` the first ones, and how many there are besides."""
    columns = [[row[k] for row in table.rows] for k in range(len(table.columns))]
    side = [
        "right" if any(cells) and all(set(cell) <= _NUMBERS for cell in cells) else "left"
        for cells in columns
    ]
    head = "".join(
        f'<th style="{_CELL};text-align:{side[k]};font-weight:600;opacity:.75">{_safe(name)}</th>'
        for k, name in enumerate(table.columns)
    )
    rows = [
        f'<tr style="background:none{";opacity:.6" if i in table.muted else ""}">'
        + "".join(
            f'<td style="{_CELL};text-align:{side[k]}'
            f'{";white-space:nowrap" if len(cell) < _WHOLE else ""}">{_safe(cell)}</td>'
            for k, cell in enumerate(row)
        )
        + "</tr>"
        for i, row in enumerate(table.rows[:most])
    ]
    left = len(table.rows) - most
    further = f'<div style="opacity:.7">… and {left} more</div>' if left > 0 else ""
    top = f'<tr style="background:none">{head}</tr>' if any(table.columns) else ""
    return (
        '<div style="overflow-x:auto"><table class="deltaid" style="border-collapse:collapse;'
        "margin:.35em 0;color:inherit;font-size:.95em;"
        f'font-variant-numeric:tabular-nums">{top}{"".join(rows)}</table>{further}</div>'
    )


def _safe(value: object) -> str:
    return escape(visible(str(value)))


def fields_card(value: Any) -> Card:
    """Every field of a data class, or of a part of a description."""
    names = [f.name for f in fields(value)] if is_dataclass(value) else type(value).model_fields
    facts = [(name, _said(getattr(value, name))) for name in names if not name.startswith("_")]
    return Card(type(value).__name__, facts=tuple(facts), apart=True)


def _said(value: object) -> str:
    """Numbers, or how many of them there are."""
    if isinstance(value, np.ndarray):
        if value.size > _WRITTEN:
            return f"array of shape {value.shape}"
        return " ".join(np.array2string(value, precision=4, separator=", ").split())
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict | tuple | list) and len(repr(value)) > _CHARACTERS:
        few = ", ".join(str(entry) for entry in list(value)[:4] if isinstance(entry, str))
        return f"{len(value)} entries" + (f": {few}, …" if few else "")
    text = str(value)
    return text if len(text) <= _CHARACTERS else f"{text[: _CHARACTERS - 1]}…"
