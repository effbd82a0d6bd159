"""Units of structured text as one XML file of PLCopen (TC6), which development systems import.

Global constants stand where CODESYS and TwinCAT keep them, in data of the vendor's own: the
standard has a place for them in configurations only.
"""

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from deltaid.exports.st_units import Unit, Variable
from deltaid.exports.text import plain_letters

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
    project = ET.Element("project", xmlns=_NAMESPACE)
    header = {"companyName": "", "productName": "deltaid", "productVersion": "1"}
    ET.SubElement(project, "fileHeader", header, creationDateTime=_DATE)
    content = ET.SubElement(project, "contentHeader", name=name)
    ET.SubElement(content, "Comment").text = plain_letters(provenance)
    scales = ET.SubElement(content, "coordinateInfo")
    for kind in ("fbd", "ld", "sfc"):
        ET.SubElement(ET.SubElement(scales, kind), "scaling", x="1", y="1")
    types = ET.SubElement(project, "types")
    ET.SubElement(types, "dataTypes")
    pous = ET.SubElement(types, "pous")
    for unit in units:
        _unit(pous, unit)
    ET.SubElement(ET.SubElement(project, "instances"), "configurations")
    extra = ET.SubElement(project, "addData")
    data = ET.SubElement(extra, "data", name=_GLOBALS, handleUnknown="implementation")
    constants = ET.SubElement(data, "globalVars", name=f"{name}_constants", constant="true")
    for variable in listed:
        _variable(constants, variable)
    ET.indent(project)
    return ET.tostring(project, encoding="unicode", xml_declaration=True) + "\n"


def _unit(pous: ET.Element, unit: Unit) -> None:
    kind = "function" if unit.kind == "FUNCTION" else "functionBlock"
    pou = ET.SubElement(pous, "pou", name=unit.name, pouType=kind)
    interface = ET.SubElement(pou, "interface")
    if unit.result:
        ET.SubElement(ET.SubElement(interface, "returnType"), unit.result)
    scratch = [Variable(name, unit.real) for name in unit.scratch]
    for tag, variables in (
        ("inputVars", unit.inputs),
        ("outputVars", unit.outputs),
        ("localVars", (*unit.own, *scratch)),
    ):
        if variables:
            section = ET.SubElement(interface, tag)
            for variable in variables:
                _variable(section, variable)
    _written(ET.SubElement(interface, "documentation"), "\n".join(unit.notes))
    body = ET.SubElement(ET.SubElement(pou, "body"), "ST")
    _written(body, "\n".join(unit.body))


def _variable(section: ET.Element, variable: Variable) -> None:
    element = ET.SubElement(section, "variable", name=variable.name)
    kind = ET.SubElement(element, "type")
    if variable.size is None:
        ET.SubElement(kind, variable.type)
    else:
        array = ET.SubElement(kind, "array")
        ET.SubElement(array, "dimension", lower="0", upper=str(variable.size - 1))
        ET.SubElement(ET.SubElement(array, "baseType"), variable.type)
    if variable.values:
        start = ET.SubElement(element, "initialValue")
        if variable.size is not None:
            start = ET.SubElement(start, "arrayValue")
        for value in variable.values:
            entry = start if variable.size is None else ET.SubElement(start, "value")
            ET.SubElement(entry, "simpleValue", value=value)
    if variable.notes:
        numbered = variable.size is not None and len(variable.notes) > 1
        lines = [f"[{k}] {note}" if numbered else note for k, note in enumerate(variable.notes)]
        _written(ET.SubElement(element, "documentation"), "\n".join(lines))


def _written(parent: ET.Element, text: str) -> None:
    ET.SubElement(parent, "xhtml", xmlns=_XHTML).text = plain_letters(text)
