"""modelDescription.xml of a functional mock-up unit, and how its sources are built: FMI 2 and 3."""

from dataclasses import dataclass
from xml.etree import ElementTree as ET

from deltaid.exports.fmu_variables import FmuVariable, Variables
from deltaid.exports.options import FmiVersion

# Units by name, as powers of SI base units.
_UNITS: dict[str, dict[str, str]] = {
    "s": {"s": "1"},
    "rad": {"rad": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "m": {"m": "1"},
    "m/s": {"m": "1", "s": "-1"},
    "m/s2": {"m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "kg": {"kg": "1"},
}


@dataclass(frozen=True)
class Described:
    """What a description says of a unit as a whole.

    Attributes:
        name: its model identifier.
        provenance: where its numbers come from.
        token: what ties the description to its binaries.
        sources: names of its C files.
    """

    name: str
    provenance: str
    token: str
    sources: tuple[str, ...]


def model_description(unit: Described, variables: Variables, version: FmiVersion) -> str:
    """The text of modelDescription.xml."""
    return _text(_of_fmi2(unit, variables) if version == "2" else _of_fmi3(unit, variables))


def build_description(unit: Described) -> str:
    """The text of sources/buildDescription.xml, which FMI 3 has in place of a list of files."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=unit.name)
    files = ET.SubElement(build, "SourceFileSet", language="C99")
    for file in unit.sources:
        ET.SubElement(files, "SourceFile", name=file)
    return _text(root)


def _of_fmi2(unit: Described, variables: Variables) -> ET.Element:
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=unit.name,
        guid=unit.token,
        description=unit.provenance,
        generationTool="deltaid",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    for kind in ("ModelExchange", "CoSimulation"):
        use = ET.SubElement(root, kind, modelIdentifier=unit.name, canGetAndSetFMUstate="true",
                            canSerializeFMUstate="true")  # fmt: skip
        if kind == "CoSimulation":
            use.set("canHandleVariableCommunicationStepSize", "true")
        files = ET.SubElement(use, "SourceFiles")
        for file in unit.sources:
            ET.SubElement(files, "File", name=file)
    root.append(_units(variables))
    listed = ET.SubElement(root, "ModelVariables")
    for k, variable in enumerate(variables.all):
        element = ET.SubElement(listed, "ScalarVariable", _common(k, variable))
        if variable.causality != "input":
            element.set("initial", "calculated" if variable.start is None else "exact")
        real = ET.SubElement(element, "Real", _values(variable))
        if variable.derivative_of is not None:
            real.set("derivative", str(variable.derivative_of + 1))
    root.append(_structure(variables))
    return root


def _of_fmi3(unit: Described, variables: Variables) -> ET.Element:
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=unit.name,
        instantiationToken=unit.token,
        description=unit.provenance,
        generationTool="deltaid",
        variableNamingConvention="structured",
    )
    for kind in ("ModelExchange", "CoSimulation"):
        use = ET.SubElement(root, kind, modelIdentifier=unit.name, canGetAndSetFMUState="true",
                            canSerializeFMUState="true")  # fmt: skip
        if kind == "CoSimulation":
            use.set("canHandleVariableCommunicationStepSize", "true")
    root.append(_units(variables))
    listed = ET.SubElement(root, "ModelVariables")
    for k, variable in enumerate(variables.all):
        element = ET.SubElement(listed, "Float64", _common(k, variable) | _values(variable))
        if variable.causality not in ("input", "independent"):
            element.set("initial", "calculated" if variable.start is None else "exact")
        if variable.derivative_of is not None:
            element.set("derivative", str(variable.derivative_of))
    structure = ET.SubElement(root, "ModelStructure")
    for group, members in _groups(variables).items():
        name = {"Outputs": "Output", "Derivatives": "ContinuousStateDerivative"}
        for k, needs in members:
            tag = name.get(group, "InitialUnknown")
            _unknown(structure, tag, "valueReference", k, needs, first=0)
    return root


def _units(variables: Variables) -> ET.Element:
    units = ET.Element("UnitDefinitions")
    for unit in sorted({variable.unit for variable in variables.all} - {""}):
        base = ET.SubElement(units, "Unit", name=unit)
        ET.SubElement(base, "BaseUnit", _UNITS[unit])
    return units


def _common(k: int, variable: FmuVariable) -> dict[str, str]:
    """Attributes that a variable has in both versions, but for its values."""
    found = {
        "name": variable.name,
        "valueReference": str(k),
        "causality": variable.causality,
        "variability": "tunable" if variable.causality == "parameter" else "continuous",
    }
    return found | ({"description": variable.description} if variable.description else {})


def _values(variable: FmuVariable) -> dict[str, str]:
    found = {"unit": variable.unit} if variable.unit else {}
    return found | ({"start": repr(variable.start)} if variable.start is not None else {})


_Members = list[tuple[int, tuple[int, ...] | None]]


def _groups(variables: Variables) -> dict[str, _Members]:
    """What follows from what, by place; a state as output follows from itself."""
    listed = list(enumerate(variables.all))
    outputs = [(k, v) for k, v in listed if v.causality == "output"]
    slopes = [(k, v) for k, v in listed if v.derivative_of is not None]
    initial = [(k, v) for k, v in listed if (k, v) in outputs + slopes and v.start is None]
    members = {"Outputs": outputs, "Derivatives": slopes, "InitialUnknowns": initial}
    return {
        group: [(k, (k,) if v.settable else v.needs) for k, v in found]
        for group, found in members.items()
    }


def _structure(variables: Variables) -> ET.Element:
    """ModelStructure of FMI 2, where places count from 1."""
    structure = ET.Element("ModelStructure")
    for group, members in _groups(variables).items():
        element = ET.SubElement(structure, group) if members else structure
        for k, needs in members:
            _unknown(element, "Unknown", "index", k, needs, first=1)
    return structure


def _unknown(
    parent: ET.Element, tag: str, key: str, k: int, needs: tuple[int, ...] | None, *, first: int
) -> None:
    unknown = ET.SubElement(parent, tag, {key: str(k + first)})
    if needs is not None:
        unknown.set("dependencies", " ".join(str(i + first) for i in needs))


def _text(root: ET.Element) -> str:
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
