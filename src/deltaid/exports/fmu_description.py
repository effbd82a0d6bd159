"""The variables of a functional mock-up unit, its modelDescription.xml, and how its sources are
built: FMI 2 and 3."""

from dataclasses import dataclass
from importlib.metadata import version as released
from xml.etree import ElementTree as ET

import numpy as np

from deltaid.exports.options import FmiVersion
from deltaid.exports.text import element
from deltaid.model.model import Model
from deltaid.robot.limits import UNITS

# Speed [rad/s or m/s] below which Coulomb friction fades, where the user sets no other.
FRICTION_SPEED = 0.01

# What task coordinates are, by name.
_TASK = {
    "x": "x of the platform point in the world",
    "y": "y of the platform point in the world",
    "z": "z of the platform point in the world",
    "psi": "turn of the tool about world z",
}


@dataclass(frozen=True)
class FmuVariable:
    """One real variable; its value reference is its place in the list.

    Attributes:
        causality: 'input', 'output', 'parameter', 'local', or 'independent' for the time.
        start: value before the first step; None for what is calculated.
        derivative_of: place of the variable that it is the derivative of.
        needs: places of the inputs and states that it follows from without delay; None for all.
    """

    name: str
    causality: str
    unit: str
    description: str
    start: float | None = None
    derivative_of: int | None = None
    needs: tuple[int, ...] | None = None

    @property
    def settable(self) -> bool:
        """Whether its value comes from outside or from the integrator."""
        return self.start is not None


@dataclass(frozen=True)
class Variables:
    """All variables of a unit.

    Attributes:
        places: where groups begin, by the name that the C code gives them.
        states: number of continuous states.
    """

    all: tuple[FmuVariable, ...]
    places: dict[str, int]
    states: int

    def with_time(self) -> "Variables":
        """These and the time, which is a variable in FMI 3."""
        time = FmuVariable("time", "independent", "s", "simulation time")
        return Variables((*self.all, time), self.places | {"TIME": len(self.all)}, self.states)


class _List:
    """Variables in the order in which they are added."""

    def __init__(self, subject: Model) -> None:
        linear = [subject.robot.is_linear(drive) for drive in subject.robot.drives]
        self.drives = [("m", "N") if slides else ("rad", "N.m") for slides in linear]
        self.task = [(name, UNITS[name]) for name in subject.robot.task.names]
        self.all: list[FmuVariable] = []
        self.places: dict[str, int] = {}

    def add(self, place: str, variables: list[FmuVariable]) -> range:
        """Append a group; returns its places."""
        self.places[place] = len(self.all)
        self.all += variables
        return range(self.places[place], len(self.all))


def carrier(subject: Model) -> str:
    """The body that holds a payload; empty where a mechanism of one's own has neither EE nor P."""
    return next((name for name in ("EE", "P") if name in subject.layout.bodies), "")


def forward_variables(subject: Model) -> Variables:
    """The robot: torques and payload in, motion out; z and then q̇ are the states."""
    found, home = _List(subject), subject.home
    found.add("SPEED", [FmuVariable(
        "friction_speed", "parameter", "",
        "rad/s or m/s below which dry friction fades in model exchange; co-simulation is exact",
        FRICTION_SPEED,
    )])  # fmt: skip
    found.add("TAU", [
        FmuVariable(f"tau{i}", "input", force, f"torque or force of drive {i} at the joint", 0.0)
        for i, (_, force) in enumerate(found.drives, 1)
    ])  # fmt: skip
    if carrier(subject):
        held = "mass that the tool holds; it comes and goes with the platform's velocity"
        found.add("PAYLOAD", [FmuVariable("payload", "input", "kg", held, 0.0)])
    z = found.add("Z", [
        FmuVariable(name, "output", unit, _TASK[name], float(start))
        for (name, unit), start in zip(found.task, home, strict=True)
    ])  # fmt: skip
    qd = found.add("QD", [
        FmuVariable(f"qd{i}", "output", f"{unit}/s", f"speed of drive {i}", 0.0)
        for i, (unit, _) in enumerate(found.drives, 1)
    ])  # fmt: skip
    found.add("DZ", [
        FmuVariable(f"der({found.all[k].name})", "local", f"{found.all[k].unit}/s", "",
                 derivative_of=k, needs=(*z, *qd))
        for k in z
    ])  # fmt: skip
    found.add("DQD", [
        FmuVariable(f"der({found.all[k].name})", "local", f"{found.all[k].unit}2", "",
                 derivative_of=k)
        for k in qd
    ])  # fmt: skip
    found.add("Q", [
        FmuVariable(f"q{i}", "output", unit, f"coordinate of drive {i}", needs=tuple(z))
        for i, (unit, _) in enumerate(found.drives, 1)
    ])  # fmt: skip
    return Variables(tuple(found.all), found.places, 2 * len(home))


def inverse_variables(subject: Model) -> Variables:
    """Inverse dynamics: the drives' motion in, torques and pose out; no states."""
    found = _List(subject)
    home = np.asarray(subject.dynamics.kinematics.inverse(subject.home[None])[0])
    groups = (("Q", "q", "", "coordinate", home), ("QD", "qd", "/s", "speed", 0 * home),
              ("QDD", "qdd", "/s2", "acceleration", 0 * home))  # fmt: skip
    for place, name, per, words, starts in groups:
        found.add(place, [
            FmuVariable(
                f"{name}{i}", "input", f"{unit}{per}", f"{words} of drive {i}", float(start)
            )
            for i, ((unit, _), start) in enumerate(zip(found.drives, starts, strict=True), 1)
        ])  # fmt: skip
    q = tuple(range(len(home)))
    found.add("TAU", [
        FmuVariable(f"tau{i}", "output", force, f"torque or force of drive {i} at the joint")
        for i, (_, force) in enumerate(found.drives, 1)
    ])  # fmt: skip
    found.add("Z", [
        FmuVariable(name, "output", unit, _TASK[name], needs=q) for name, unit in found.task
    ])  # fmt: skip
    return Variables(tuple(found.all), found.places, 0)


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
    """The text of modelDescription.xml; places count from 1 in FMI 2, from 0 in FMI 3."""
    second = version == "2"
    first, token, state = (
        (1, "guid", "FMUstate") if second else (0, "instantiationToken", "FMUState")
    )
    able = {f"canGetAndSet{state}": "true", f"canSerialize{state}": "true"}
    step = {"canHandleVariableCommunicationStepSize": "true"}
    files = [element("SourceFiles", *(element("File", name=file) for file in unit.sources))]
    structure = element("ModelStructure")
    for group, (name, members) in _groups(variables).items():
        inside = ET.SubElement(structure, group) if second and members else structure
        for k, needs in members:
            place = {"index" if second else "valueReference": str(k + first)}
            known = None if needs is None else " ".join(str(i + first) for i in needs)
            inside.append(element("Unknown" if second else name, **place, dependencies=known))
    return _text(
        element(
            "fmiModelDescription",
            *(
                element(kind, *(files if second else []), modelIdentifier=unit.name, **able, **more)
                for kind, more in (("ModelExchange", {}), ("CoSimulation", step))
            ),
            _units(variables),
            element("DefaultExperiment", startTime="0", stopTime="1", stepSize="0.001"),
            element(
                "ModelVariables",
                *(_variable(k, v, version) for k, v in enumerate(variables.all)),
            ),
            structure,
            fmiVersion=f"{version}.0",
            modelName=unit.name,
            **{token: unit.token},
            description=unit.provenance,
            author="deltaid developers",
            version=released("deltaid"),
            copyright="the deltaid developers",
            license="MIT",
            generationTool="deltaid",
            variableNamingConvention="structured",
            numberOfEventIndicators="0" if second else None,
        )
    )


def build_description(unit: Described) -> str:
    """The text of sources/buildDescription.xml, which FMI 3 has in place of a list of files."""
    files = (element("SourceFile", name=file) for file in unit.sources)
    build = element(
        "BuildConfiguration",
        element("SourceFileSet", *files, language="C99"),
        modelIdentifier=unit.name,
    )
    return _text(element("fmiBuildDescription", build, fmiVersion="3.0"))


def _variable(k: int, variable: FmuVariable, version: FmiVersion) -> ET.Element:
    """A variable; FMI 2 has its values in an element within."""
    initial = "calculated" if variable.start is None else "exact"
    common = {
        "name": variable.name,
        "valueReference": str(k),
        "causality": variable.causality,
        "variability": "tunable" if variable.causality == "parameter" else "continuous",
        "description": variable.description or None,
    }
    values = {
        "unit": variable.unit or None,
        "start": None if variable.start is None else repr(variable.start),
    }
    last = {"initial": None if variable.causality in ("input", "independent") else initial}
    place = variable.derivative_of
    if version == "3":
        slope = None if place is None else str(place)
        return element("Float64", **common, **values, **last, derivative=slope)
    slope = None if place is None else str(place + 1)
    return element("ScalarVariable", element("Real", **values, derivative=slope), **common, **last)


def _units(variables: Variables) -> ET.Element:
    names = sorted({variable.unit for variable in variables.all} - {""})
    units = (element("Unit", element("BaseUnit", **_UNITS[name]), name=name) for name in names)
    return element("UnitDefinitions", *units)


_Members = list[tuple[int, tuple[int, ...] | None]]


def _groups(variables: Variables) -> dict[str, tuple[str, _Members]]:
    """What follows from what, by place: the group in FMI 2 with the element in FMI 3. A state as
    output follows from itself."""
    listed = list(enumerate(variables.all))
    outputs = [(k, v) for k, v in listed if v.causality == "output"]
    slopes = [(k, v) for k, v in listed if v.derivative_of is not None]
    initial = [(k, v) for k, v in listed if (k, v) in outputs + slopes and v.start is None]
    members = {
        "Outputs": ("Output", outputs),
        "Derivatives": ("ContinuousStateDerivative", slopes),
        "InitialUnknowns": ("InitialUnknown", initial),
    }
    return {
        group: (name, [(k, (k,) if v.settable else v.needs) for k, v in found])
        for group, (name, found) in members.items()
    }


def _text(root: ET.Element) -> str:
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
