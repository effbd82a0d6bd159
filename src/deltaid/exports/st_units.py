"""Units of a program of IEC 61131-3 structured text, as text and as one XML file of PLCopen (TC6),
which development systems import.

The standard allows global constants in configurations only, and array inputs and outputs of named
types only. So arrays have named types, and tables are functions. Arrays that a function reads are
VAR_IN_OUT: nothing is copied, and MATIEC has no other way to pass them.
"""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

from deltaid.exports.text import plain_letters, rendered


@dataclass(frozen=True)
class Variable:
    """A variable or an array of numbers; all start with 0.

    Attributes:
        name, type: as in the text.
        note: a comment.
        size: of an array, whose type has a name and whose index begins at 0.
    """

    name: str
    type: str
    note: str = ""
    size: int = 0


@dataclass(frozen=True)
class Unit:
    """A function or a function block.

    Attributes:
        name: of the unit.
        result: type of a function's result; empty for a function block.
        notes: what it does, lines of comment.
        inputs, outputs, local_variables: its variables; a function does not change its inputs.
        body: statements.
        scratch: names of many more local numbers.
    """

    name: str
    result: str
    notes: Sequence[str]
    inputs: Sequence[Variable]
    outputs: Sequence[Variable]
    local_variables: Sequence[Variable]
    body: str
    scratch: Sequence[str] = ()

    @property
    def kind(self) -> str:
        """Keyword of the unit: FUNCTION or FUNCTION_BLOCK."""
        return "FUNCTION" if self.result else "FUNCTION_BLOCK"

    @property
    def sections(self) -> list[tuple[str, str, Sequence[Variable]]]:
        """Its variables by section, with the section's names in the text and in the XML."""
        return [
            ("VAR_INPUT", "inputVars", [v for v in self.inputs if not (self.result and v.size)]),
            ("VAR_IN_OUT", "inOutVars", [v for v in self.inputs if self.result and v.size]),
            ("VAR_OUTPUT", "outputVars", self.outputs),
            ("VAR", "localVars", self.local_variables),
        ]


@dataclass(frozen=True)
class PlcProgram:
    """Functions and function blocks of a model.

    Attributes:
        prefix: beginning of all names.
        notes: comments at the head.
        units: functions and blocks, called ones before their callers.
        real: type of numbers.
        declared: sizes of arrays whose types are declared elsewhere.
    """

    prefix: str
    notes: Sequence[str]
    units: Sequence[Unit]
    real: str
    declared: Sequence[int] = ()

    @property
    def types(self) -> dict[str, int]:
        """Names and sizes of array types, the smallest first."""
        variables = (
            v for unit in self.units for v in (*unit.inputs, *unit.outputs, *unit.local_variables)
        )
        sizes = {v.type: v.size for v in variables if v.size not in (0, *self.declared)}
        return dict(sorted(sizes.items(), key=lambda item: item[1]))

    @property
    def text(self) -> str:
        """One file of structured text."""
        return self._rendered("program.st.jinja")

    @property
    def xml(self) -> str:
        """An XML file of PLCopen for development systems."""
        return self._rendered("program.xml.jinja")

    def _rendered(self, template: str) -> str:
        return rendered(
            template,
            prefix=self.prefix,
            notes=self.notes,
            types=self.types,
            units=self.units,
            real=self.real,
            comment=comment,
            comments=comments,
            in_lines=in_lines,
            escape=escape,
            plain_letters=plain_letters,
        )


def in_lines(names: Sequence[str], real: str) -> str:
    """A declaration of many numbers, wrapped into lines."""
    text = f"{', '.join(names)}\0:\0{real};"
    lines = textwrap.fill(text, initial_indent="    ", subsequent_indent="        ")
    return lines.replace("\0", " ")


def comments(notes: Sequence[str]) -> list[str]:
    """Comments, one per line, with long ones wrapped."""
    return [comment(line) for note in notes for line in textwrap.wrap(note)]


def comment(text: str) -> str:
    """A comment in ASCII, in which the text cannot end it."""
    apart = re.sub(r"([(*)])(?=[(*)])", r"\1 ", plain_letters(text))
    return f"(* {apart} *)"
