"""Units of an IEC 61131-3 program: as structured text, and as one XML file of PLCopen (TC6), which
development systems import.

Global constants stand where CODESYS and TwinCAT keep them, in data of the vendor's own: the
standard has a place for them in configurations only.
"""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from deltaid.exports.text import element, plain_letters

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
    return "\n".join(
        [
            "VAR_GLOBAL CONSTANT",
            *[line for variable in variables for line in variable.lines()],
            "END_VAR",
            "",
        ]
    )


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
_GLOBALS = "http://www.3s-software.com/plcopenxml/globalvars"
# The format wants a date; a fixed one leaves the file the same for the same model.
_DATE = "2000-01-01T00:00:00"


def plcopen_xml(
    name: str, provenance: str, listed: Sequence[Variable], units: Sequence[Unit]
) -> str:
    """The file.

    Args:
        name: of the project and, with _constants, of the list of global constants.
        provenance: what the units come from.
        listed: global constants.
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
        element("types", element("dataTypes"), element("pous", *map(_pou, units))),
        element("instances", element("configurations")),
        element(
            "addData",
            element(
                "data",
                element(
                    "globalVars",
                    *map(_variable, listed),
                    name=f"{name}_constants",
                    constant="true",
                ),
                name=_GLOBALS,
                handleUnknown="implementation",
            ),
        ),
        xmlns=_NAMESPACE,
    )
    ET.indent(project)
    return ET.tostring(project, encoding="unicode", xml_declaration=True) + "\n"


def _pou(unit: Unit) -> ET.Element:
    scratch = [Variable(name, unit.real) for name in unit.scratch]
    sections = (
        ("inputVars", unit.inputs),
        ("outputVars", unit.outputs),
        ("localVars", (*unit.own, *scratch)),
    )
    interface = element(
        "interface", *(element(tag, *map(_variable, own)) for tag, own in sections if own)
    )
    if unit.result:
        interface.insert(0, element("returnType", element(unit.result)))
    interface.append(element("documentation", _written("\n".join(unit.notes))))
    return element(
        "pou",
        interface,
        element("body", element("ST", _written("\n".join(unit.body)))),
        name=unit.name,
        pouType="function" if unit.kind == "FUNCTION" else "functionBlock",
    )


def _variable(variable: Variable) -> ET.Element:
    kind = element(variable.type)
    if variable.size is not None:
        dimension = element("dimension", lower="0", upper=str(variable.size - 1))
        kind = element("array", dimension, element("baseType", kind))
    made = element("variable", element("type", kind), name=variable.name)
    values = [element("simpleValue", value=value) for value in variable.values]
    if variable.size is not None and values:
        values = [element("arrayValue", *(element("value", value) for value in values))]
    if values:
        made.append(element("initialValue", *values))
    if variable.notes:
        numbered = variable.size is not None and len(variable.notes) > 1
        lines = [f"[{k}] {note}" if numbered else note for k, note in enumerate(variable.notes)]
        made.append(element("documentation", _written("\n".join(lines))))
    return made


def _written(text: str) -> ET.Element:
    return element("xhtml", text=plain_letters(text), xmlns=_XHTML)
