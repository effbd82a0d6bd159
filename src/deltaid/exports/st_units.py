"""Units of an IEC 61131-3 program and how structured text writes them."""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from deltaid.exports.text import plain_letters

# Letters of a line at most.
_WIDTH = 100


@dataclass(frozen=True)
class Variable:
    """A variable or an array of numbers, counted from 0.

    Attributes:
        name, type: as in the text.
        size: of an array; None of a single variable.
        values: to start with; one each for an array.
        notes: comments, one a value.
    """

    name: str
    type: str
    size: int | None = None
    values: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def full_type(self) -> str:
        """The type with the range of an array."""
        return self.type if self.size is None else f"ARRAY [0..{self.size - 1}] OF {self.type}"

    def lines(self) -> list[str]:
        """Lines of its declaration."""
        head, notes = f"    {self.name} : {self.full_type}", self.notes
        if not self.values:
            note = f" {comment(notes[0])}" if notes else ""
            return [f"{head};{note}"]
        if self.size is None:
            return [f"{head} := {self.values[0]};{f' {comment(notes[0])}' if notes else ''}"]
        if not notes:
            return filled(f"{head} := [", self.values, "];")
        last = len(self.values) - 1
        rows = [
            f"        {value}{',' if k < last else ''} {comment(note)}"
            for k, (value, note) in enumerate(zip(self.values, notes, strict=True))
        ]
        return [f"{head} := [", *rows, "    ];"]


@dataclass(frozen=True)
class Unit:
    """A function or a function block.

    Attributes:
        kind: FUNCTION or FUNCTION_BLOCK.
        name: of it.
        result: type of what a function returns.
        notes: what it does, lines of comment.
        inputs, outputs, own: its variables.
        scratch: names of further numbers, many.
        real: type of these.
        body: statements.
    """

    kind: str
    name: str
    result: str
    notes: tuple[str, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    own: tuple[Variable, ...]
    scratch: tuple[str, ...]
    real: str
    body: tuple[str, ...]

    def text(self) -> str:
        """The unit from its first to its last word."""
        head = f"{self.kind} {self.name}" + (f" : {self.result}" if self.result else "")
        sections = [
            ("VAR_INPUT", self.inputs),
            ("VAR_OUTPUT", self.outputs),
            ("VAR", self.own),
        ]
        lines = [*comments(self.notes), head]
        for keyword, variables in sections:
            declared = [line for variable in variables for line in variable.lines()]
            if keyword == "VAR" and self.scratch:
                declared += filled("    ", self.scratch, f" : {self.real};")
            if declared:
                lines += [keyword, *declared, "END_VAR"]
        return "\n".join([*lines, *self.body, f"END_{self.kind}", ""])


def constants(variables: Sequence[Variable]) -> str:
    """A list of global constants."""
    lines = [line for variable in variables for line in variable.lines()]
    return "\n".join(["VAR_GLOBAL CONSTANT", *lines, "END_VAR", ""])


def filled(before: str, items: Sequence[str], after: str) -> list[str]:
    """Items with commas between them, in lines that are not long."""
    lines, line = [], before
    for k, item in enumerate(items):
        piece = item + (after if k == len(items) - 1 else ",")
        if len(line) + len(piece) > _WIDTH and line.strip():
            lines.append(line.rstrip())
            line = "        "
        line += f"{piece} "
    return [*lines, line.rstrip()]


def comments(notes: Sequence[str]) -> list[str]:
    """Comments, one a line; a long one goes on in the next line."""
    return [comment(line) for note in notes for line in textwrap.wrap(note, _WIDTH - 10)]


def comment(text: str) -> str:
    """A comment of plain letters that ends where it should."""
    apart = re.sub(r"([(*)])(?=[(*)])", r"\1 ", plain_letters(text))
    return f"(* {apart} *)"
