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
from xml.etree import ElementTree as ET

from deltaid.exports.text import element, plain_letters, xml_text

# Letters of a line at most.
_WIDTH = 100


@dataclass(frozen=True)
class ArrayType:
    """A type of arrays of numbers, counted from 0.

    Attributes:
        name: of the type.
        real: type of an entry.
        size: how many entries there are.
    """

    name: str
    real: str
    size: int

    def text(self) -> str:
        """Its declaration."""
        array = f"ARRAY [0..{self.size - 1}] OF {self.real}"
        return f"TYPE\n    {self.name} : {array};\nEND_TYPE\n"


@dataclass(frozen=True)
class Variable:
    """A variable or an array of numbers.

    Attributes:
        name, type: as in the text; all start with 0.
        note: a comment.
        array: of an array its type.
    """

    name: str
    type: str
    note: str = ""
    array: ArrayType | None = None

    @property
    def line(self) -> str:
        """The line of its declaration."""
        return f"    {self.name} : {self.type};{f' {comment(self.note)}' if self.note else ''}"


@dataclass(frozen=True)
class Unit:
    """A function or a function block.

    Attributes:
        name: of it.
        result: type of what a function returns; empty for a function block.
        notes: what it does, lines of comment.
        inputs, outputs, own: its variables; a function leaves its inputs as they are.
        body: statements.
        real: type of the numbers
        scratch: of these names, many.
    """

    name: str
    result: str
    notes: Sequence[str]
    inputs: Sequence[Variable]
    outputs: Sequence[Variable]
    own: Sequence[Variable]
    body: Sequence[str]
    real: str
    scratch: Sequence[str] = ()

    @property
    def kind(self) -> str:
        """FUNCTION or FUNCTION_BLOCK."""
        return "FUNCTION" if self.result else "FUNCTION_BLOCK"

    def passed(self, *, by_reference: bool) -> list[Variable]:
        """Inputs that are passed as they are, arrays of functions; or the others."""
        refers = bool(self.result)
        return [v for v in self.inputs if (refers and v.array is not None) is by_reference]

    def text(self) -> str:
        """The unit from its first to its last word."""
        lines = [*comments(self.notes), f"{self.kind} {self.name}"]
        lines[-1] += f" : {self.result}" if self.result else ""
        for keyword, variables in {
            "VAR_INPUT": self.passed(by_reference=False),
            "VAR_IN_OUT": self.passed(by_reference=True),
            "VAR_OUTPUT": self.outputs,
            "VAR": self.own,
        }.items():
            declared = [variable.line for variable in variables]
            if keyword == "VAR" and self.scratch:
                declared += filled("    ", self.scratch, f" : {self.real};")
            if declared:
                lines += [keyword, *declared, "END_VAR"]
        return "\n".join([*lines, *self.body, f"END_{self.kind}", ""])


def array_types(units: Sequence[Unit]) -> tuple[ArrayType, ...]:
    """The types of arrays that some units use, the smallest first."""
    variables = [v for unit in units for v in (*unit.inputs, *unit.outputs, *unit.own)]
    return tuple(sorted({v.array for v in variables if v.array}, key=lambda array: array.size))


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


_NAMESPACE = "http://www.plcopen.org/xml/tc6_0200"
_XHTML = "http://www.w3.org/1999/xhtml"
# The format wants a date; a fixed one leaves the file the same for the same model.
_DATE = "2000-01-01T00:00:00"


def plcopen_xml(
    name: str, provenance: str, arrays: Sequence[ArrayType], units: Sequence[Unit]
) -> str:
    """The file.

    Args:
        name: of the project.
        provenance: what the units come from.
        arrays: types of arrays.
        units: functions and function blocks, those that are called before those that call.
    """
    scaled = (element(kind, element("scaling", x="1", y="1")) for kind in ("fbd", "ld", "sfc"))
    project = element(
        "project",
        element(
            "fileHeader",
            companyName="",
            productName="deltaid",
            productVersion="1",
            creationDateTime=_DATE,
        ),
        element(
            "contentHeader",
            element("Comment", text=plain_letters(provenance)),
            element("coordinateInfo", *scaled),
            name=name,
        ),
        element(
            "types",
            element("dataTypes", *map(_array_type, arrays)),
            element("pous", *map(_pou, units)),
        ),
        element("instances", element("configurations")),
        xmlns=_NAMESPACE,
    )
    return xml_text(project, "<?xml version='1.0' encoding='utf-8'?>\n")


def _pou(unit: Unit) -> ET.Element:
    sections = {
        "inputVars": unit.passed(by_reference=False),
        "inOutVars": unit.passed(by_reference=True),
        "outputVars": unit.outputs,
        "localVars": [*unit.own, *(Variable(name, unit.real) for name in unit.scratch)],
    }
    interface = element(
        "interface",
        *([element("returnType", element(unit.result))] if unit.result else []),
        *(element(k, *map(_variable, variables)) for k, variables in sections.items() if variables),
        element("documentation", _written("\n".join(unit.notes))),
    )
    return element(
        "pou",
        interface,
        element("body", element("ST", _written("\n".join(unit.body)))),
        name=unit.name,
        pouType="function" if unit.result else "functionBlock",
    )


def _array_type(array: ArrayType) -> ET.Element:
    dimension = element("dimension", lower="0", upper=str(array.size - 1))
    kind = element("array", dimension, element("baseType", element(array.real)))
    return element("dataType", element("baseType", kind), name=array.name)


def _variable(variable: Variable) -> ET.Element:
    array = variable.array
    kind = element(variable.type) if array is None else element("derived", name=array.name)
    notes = [element("documentation", _written(variable.note))] if variable.note else []
    return element("variable", element("type", kind), *notes, name=variable.name)


def _written(text: str) -> ET.Element:
    return element("xhtml", text=plain_letters(text), xmlns=_XHTML)
