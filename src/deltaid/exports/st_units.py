"""Units of an IEC 61131-3 program: as structured text, and as one XML file of PLCopen (TC6), which
development systems import.

The standard has a place for global constants in configurations only, and none for arrays without a
name as inputs or outputs. So arrays have types with names, and tables are functions. Arrays that a
function reads are its VAR_IN_OUT: nothing is copied, and MATIEC has no other way to pass them.
"""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

from deltaid.exports.text import plain_letters, rendered

# Letters of a line at most.
_WIDTH = 100


@dataclass(frozen=True)
class Variable:
    """A variable or an array of numbers; all start with 0.

    Attributes:
        name, type: as in the text.
        note: a comment.
        size: of an array, whose type has a name and counts from 0.
    """

    name: str
    type: str
    note: str = ""
    size: int = 0


@dataclass(frozen=True)
class Unit:
    """A function or a function block.

    Attributes:
        name: of it.
        result: type of what a function returns; empty for a function block.
        notes: what it does, lines of comment.
        inputs, outputs, own: its variables; a function leaves its inputs as they are.
        body: statements.
        scratch: names of further numbers, many.
    """

    name: str
    result: str
    notes: Sequence[str]
    inputs: Sequence[Variable]
    outputs: Sequence[Variable]
    own: Sequence[Variable]
    body: str
    scratch: Sequence[str] = ()

    @property
    def kind(self) -> str:
        """FUNCTION or FUNCTION_BLOCK."""
        return "FUNCTION" if self.result else "FUNCTION_BLOCK"

    @property
    def sections(self) -> list[tuple[str, str, Sequence[Variable]]]:
        """Its variables by what they are, in words of the text and of the XML."""
        return [
            ("VAR_INPUT", "inputVars", [v for v in self.inputs if not (self.result and v.size)]),
            ("VAR_IN_OUT", "inOutVars", [v for v in self.inputs if self.result and v.size]),
            ("VAR_OUTPUT", "outputVars", self.outputs),
            ("VAR", "localVars", self.own),
        ]


@dataclass(frozen=True)
class PlcProgram:
    """Functions and function blocks of a model.

    Attributes:
        prefix: what all names begin with.
        notes: comments at the head.
        units: functions and blocks, those that are called first.
        real: type of numbers.
    """

    prefix: str
    notes: Sequence[str]
    units: Sequence[Unit]
    real: str

    @property
    def types(self) -> dict[str, int]:
        """Types of arrays and how many entries they have, the smallest first."""
        variables = (v for unit in self.units for v in (*unit.inputs, *unit.outputs, *unit.own))
        sizes = {v.type: v.size for v in variables if v.size}
        return dict(sorted(sizes.items(), key=lambda item: item[1]))

    @property
    def text(self) -> str:
        """As one file of structured text."""
        return self.without(())

    def without(self, sizes: Sequence[int]) -> str:
        """The same without types of arrays of some sizes, which another file has."""
        types = {name: size for name, size in self.types.items() if size not in sizes}
        return rendered(
            "program.st.jinja",
            notes=self.notes,
            types=types,
            units=self.units,
            real=self.real,
            comment=comment,
            comments=comments,
            in_lines=in_lines,
        )

    @property
    def xml(self) -> str:
        """As a file that development systems import."""
        return rendered(
            "program.xml.jinja",
            prefix=self.prefix,
            notes=self.notes,
            types=self.types,
            units=self.units,
            real=self.real,
            escape=escape,
            plain_letters=plain_letters,
        )


def in_lines(names: Sequence[str], real: str) -> str:
    """A declaration of many numbers, in lines that are not long."""
    text = f"{', '.join(names)}\0:\0{real};"
    return textwrap.fill(text, _WIDTH, initial_indent="    ", subsequent_indent="        ").replace(
        "\0", " "
    )


def comments(notes: Sequence[str]) -> list[str]:
    """Comments, one a line; a long one goes on in the next line."""
    return [comment(line) for note in notes for line in textwrap.wrap(note, _WIDTH - 10)]


def comment(text: str) -> str:
    """A comment of plain letters that ends where it should."""
    apart = re.sub(r"([(*)])(?=[(*)])", r"\1 ", plain_letters(text))
    return f"(* {apart} *)"
