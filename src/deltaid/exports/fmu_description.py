"""The variables of a functional mock-up unit, its modelDescription.xml, and how its sources are
built: FMI 2 and 3."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
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
        derivative_of: name of the variable that it is the derivative of.
        needs: names of the inputs and states that it follows from without delay; None for all.
    """

    name: str
    causality: str
    unit: str
    description: str
    start: float | None = None
    derivative_of: str = ""
    needs: tuple[str, ...] | None = None

    @property
    def settable(self) -> bool:
        """Whether its value comes from outside or from the integrator."""
        return self.start is not None


@dataclass(frozen=True)
class Variables:
    """All variables of a unit.

    Attributes:
        groups: in their order, by the names that the C code gives them.
        states: number of continuous states.
    """

    groups: Mapping[str, tuple[FmuVariable, ...]]
    states: int = 0

    @property
    def all(self) -> tuple[FmuVariable, ...]:
        """One behind the other."""
        return tuple(variable for group in self.groups.values() for variable in group)

    @property
    def places(self) -> dict[str, int]:
        """Where groups begin."""
        ends = np.cumsum([len(group) for group in self.groups.values()]).tolist()
        return {n: end - len(g) for (n, g), end in zip(self.groups.items(), ends, strict=True)}

    def with_time(self) -> "Variables":
        """These and the time, which is a variable in FMI 3."""
        time = FmuVariable("time", "independent", "s", "simulation time")
        return replace(self, groups={**self.groups, "TIME": (time,)})


def carrier(subject: Model) -> str:
    """The body that holds a payload; empty where a mechanism of one's own has neither EE nor P."""
    return next((name for name in ("EE", "P") if name in subject.layout.bodies), "")


def _units_of(subject: Model) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Units of each drive's coordinate and torque; name and unit of each task coordinate."""
    linear = [subject.robot.is_linear(drive) for drive in subject.robot.drives]
    drives = [("m", "N") if slides else ("rad", "N.m") for slides in linear]
    return drives, [(name, UNITS[name]) for name in subject.robot.task.names]


def forward_variables(subject: Model) -> Variables:
    """The robot: torques and payload in, motion out; z and then q̇ are the states."""
    drives, task = _units_of(subject)
    speed = FmuVariable(
        "friction_speed", "parameter", "",
        "rad/s or m/s below which dry friction fades in model exchange; co-simulation is exact",
        FRICTION_SPEED,
    )  # fmt: skip
    payload = FmuVariable("payload", "input", "kg",
        "mass that the tool holds; it comes and goes with the platform's velocity", 0.0,
    )  # fmt: skip
    tau = tuple(
        FmuVariable(f"tau{i}", "input", force, f"torque or force of drive {i} at the joint", 0.0)
        for i, (_, force) in enumerate(drives, 1)
    )
    z = tuple(
        FmuVariable(name, "output", unit, _TASK[name], float(start))
        for (name, unit), start in zip(task, subject.home, strict=True)
    )
    qd = tuple(
        FmuVariable(f"qd{i}", "output", f"{unit}/s", f"speed of drive {i}", 0.0)
        for i, (unit, _) in enumerate(drives, 1)
    )
    needs = tuple(variable.name for variable in (*z, *qd))
    dz = tuple(
        FmuVariable(f"der({v.name})", "local", f"{v.unit}/s", "", derivative_of=v.name, needs=needs)
        for v in z
    )
    dqd = tuple(
        FmuVariable(f"der({v.name})", "local", f"{v.unit}2", "", derivative_of=v.name) for v in qd
    )
    q = tuple(
        FmuVariable(f"q{i}", "output", unit, f"coordinate of drive {i}", needs=needs[: len(z)])
        for i, (unit, _) in enumerate(drives, 1)
    )
    held = {"PAYLOAD": (payload,)} if carrier(subject) else {}
    of_motion = {"Z": z, "QD": qd, "DZ": dz, "DQD": dqd, "Q": q}
    return Variables({"SPEED": (speed,), "TAU": tau, **held, **of_motion}, 2 * len(z))


def inverse_variables(subject: Model) -> Variables:
    """Inverse dynamics: the drives' motion in, torques and pose out; no states."""
    drives, task = _units_of(subject)
    home = np.asarray(subject.dynamics.kinematics.inverse(subject.home[None])[0])
    kinds = (("q", "", "coordinate", home), ("qd", "/s", "speed", 0 * home),
             ("qdd", "/s2", "acceleration", 0 * home))  # fmt: skip
    groups = {
        name.upper(): tuple(
            FmuVariable(
                f"{name}{i}", "input", f"{unit}{per}", f"{words} of drive {i}", float(start)
            )
            for i, ((unit, _), start) in enumerate(zip(drives, starts, strict=True), 1)
        )
        for name, per, words, starts in kinds
    }
    groups["TAU"] = tuple(
        FmuVariable(f"tau{i}", "output", force, f"torque or force of drive {i} at the joint")
        for i, (_, force) in enumerate(drives, 1)
    )
    q = tuple(variable.name for variable in groups["Q"])
    groups["Z"] = tuple(
        FmuVariable(name, "output", unit, _TASK[name], needs=q) for name, unit in task
    )
    return Variables(groups)


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
    places = {variable.name: k for k, variable in enumerate(variables.all)}
    for group, (name, members) in _groups(variables).items():
        inside = ET.SubElement(structure, group) if second and members else structure
        for v in members:
            needs = (v.name,) if v.settable else v.needs  # a state as output is its own
            place = {"index" if second else "valueReference": str(places[v.name] + first)}
            known = None if needs is None else " ".join(str(places[n] + first) for n in needs)
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
                *(_variable(v, places, version) for v in variables.all),
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


def _variable(variable: FmuVariable, places: Mapping[str, int], version: FmiVersion) -> ET.Element:
    """A variable; FMI 2 has its values in an element within."""
    initial = "calculated" if variable.start is None else "exact"
    common = {
        "name": variable.name,
        "valueReference": str(places[variable.name]),
        "causality": variable.causality,
        "variability": "tunable" if variable.causality == "parameter" else "continuous",
        "description": variable.description or None,
    }
    values = {
        "unit": variable.unit or None,
        "start": None if variable.start is None else repr(variable.start),
    }
    last = {"initial": None if variable.causality in ("input", "independent") else initial}
    slope = None
    if variable.derivative_of:
        slope = str(places[variable.derivative_of] + (version == "2"))
    if version == "3":
        return element("Float64", **common, **values, **last, derivative=slope)
    return element("ScalarVariable", element("Real", **values, derivative=slope), **common, **last)


def _units(variables: Variables) -> ET.Element:
    names = sorted({variable.unit for variable in variables.all} - {""})
    units = (element("Unit", element("BaseUnit", **_UNITS[name]), name=name) for name in names)
    return element("UnitDefinitions", *units)


def _groups(variables: Variables) -> dict[str, tuple[str, list[FmuVariable]]]:
    """What follows from what: the group in FMI 2 with the element in FMI 3."""
    outputs = [v for v in variables.all if v.causality == "output"]
    slopes = [v for v in variables.all if v.derivative_of]
    initial = [v for v in variables.all if v in outputs + slopes and v.start is None]
    return {
        "Outputs": ("Output", outputs),
        "Derivatives": ("ContinuousStateDerivative", slopes),
        "InitialUnknowns": ("InitialUnknown", initial),
    }


def _text(root: ET.Element) -> str:
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
