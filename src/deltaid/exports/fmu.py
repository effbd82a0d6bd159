"""A model as a functional mock-up unit (FMI 2 or 3) from C sources, for co-simulation and model
exchange.

The two units are the robot itself, with torques as inputs and motion as outputs (`forward`), and
its inverse dynamics, with motion as inputs and torques as outputs (`inverse`). Both contain their
sources; if a compiler is found, also libraries, so that users need not compile (`fmu_binaries`).

The robot's states are z and q̇: ż = J⁻¹ q̇, so loops cannot drift. In co-simulation the unit takes
the time steps of `ForwardDynamics.step`, with exact friction at rest. Model exchange needs q̈ as a
function of the state, which friction at rest is not: there M q̈ = τ − C q̇ − g − f, and the sign of
a speed v in friction is tanh(v / friction_speed), for integrators without steps of forces.
"""

import io
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version as released

import casadi as ca
import numpy as np

from deltaid.control.simulation import LONGEST_STEP
from deltaid.exports.c_code import accelerations, c_code
from deltaid.exports.fmu_binaries import Compiler, binaries, found_compiler
from deltaid.exports.functions import ParameterTable, parameter_table
from deltaid.exports.options import FmiVersion
from deltaid.exports.straight_line import Array, straight_line
from deltaid.exports.structured_text import quantities
from deltaid.exports.text import DOUBLE, Export, c_comment, rendered, rendered_xml, xml_text
from deltaid.model.model import Model
from deltaid.progress import Progress
from deltaid.robot.limits import UNITS

# Default speed [rad/s or m/s] below which Coulomb friction fades to zero.
FRICTION_SPEED = 0.01

_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
# Task coordinates in words.
_TASK = {
    "x": "x of the platform point in the world",
    "y": "y of the platform point in the world",
    "z": "z of the platform point in the world",
    "psi": "turn of the tool about world z",
}


@dataclass(frozen=True)
class FmuVariable:
    """One real variable; its value reference is its index in the list.

    Attributes:
        causality: 'input', 'output', 'parameter', 'local', or 'independent' for the time.
        start: value before the first step; None for calculated variables.
        derivative_of: name of the variable that it is the derivative of.
        needs: names of the inputs and states that it directly depends on; None for all.
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
        """Whether its value is set from outside or by the integrator."""
        return self.start is not None


@dataclass(frozen=True)
class Variables:
    """All variables of a unit.

    Attributes:
        groups: in order, by their names in the C code.
        states: number of continuous states.
    """

    groups: Mapping[str, tuple[FmuVariable, ...]]
    states: int = 0

    @property
    def all(self) -> tuple[FmuVariable, ...]:
        """The variables of all groups, concatenated."""
        return tuple(variable for group in self.groups.values() for variable in group)

    @property
    def places(self) -> dict[str, int]:
        """First index of each group."""
        ends = np.cumsum([len(group) for group in self.groups.values()]).tolist()
        return {n: end - len(g) for (n, g), end in zip(self.groups.items(), ends, strict=True)}

    def with_time(self) -> "Variables":
        """The variables with time, which FMI 3 lists."""
        time = FmuVariable("time", "independent", "s", "simulation time")
        return replace(self, groups={**self.groups, "TIME": (time,)})


def _per_drive(
    subject: Model,
    name: str,
    causality: str,
    words: str,
    unit: str = "{0.coordinate}",
    starts: Sequence[float] = (),
    needs: tuple[str, ...] | None = None,
) -> tuple[FmuVariable, ...]:
    """One variable per drive, with the drive's number in its description and the drive's units."""
    units = [unit.format(x).replace(" ", ".") for x in subject.robot.drive_units.values()]
    return tuple(
        FmuVariable(f"{name}{i}", causality, x, words.format(i), start, needs=needs)
        for i, (x, start) in enumerate(zip(units, starts or [None] * len(units), strict=True), 1)
    )


_EFFORT = ("torque or force of drive {} at the joint", "{0.force}")


def forward_variables(subject: Model) -> Variables:
    """The robot: inputs are torques and payload, outputs the motion; z and then q̇ are the
    states."""
    speed = FmuVariable(
        "friction_speed", "parameter", "",
        "rad/s or m/s below which dry friction fades in model exchange; co-simulation is exact",
        FRICTION_SPEED,
    )  # fmt: skip
    payload = FmuVariable("payload", "input", "kg",
        "mass that the tool holds; it comes and goes with the platform's velocity", 0.0,
    )  # fmt: skip
    z = tuple(
        FmuVariable(name, "output", UNITS[name], _TASK[name], float(start))
        for name, start in zip(subject.robot.task.names, subject.home, strict=True)
    )
    still = [0.0] * subject.dynamics.dof
    qd = _per_drive(subject, "qd", "output", "speed of drive {}", "{0.coordinate}/s", still)
    needs = tuple(variable.name for variable in (*z, *qd))
    dz, dqd = (
        tuple(
            FmuVariable(f"der({v.name})", "local", f"{v.unit}{per}", "", None, v.name, from_)
            for v in group
        )
        for group, per, from_ in ((z, "/s", needs), (qd, "2", None))
    )
    q = _per_drive(subject, "q", "output", "coordinate of drive {}", needs=needs[: len(z)])
    held = {"PAYLOAD": (payload,)} if subject.robot.load_carrier else {}
    of_motion = {"Z": z, "QD": qd, "DZ": dz, "DQD": dqd, "Q": q}
    tau = _per_drive(subject, "tau", "input", *_EFFORT, still)
    return Variables({"SPEED": (speed,), "TAU": tau, **held, **of_motion}, 2 * len(z))


def inverse_variables(subject: Model) -> Variables:
    """Inverse dynamics: inputs are the drives' motion, outputs torques and pose; no states."""
    home = subject.dynamics.kinematics.inverse(subject.home[None])[0].tolist()
    still = [0.0] * len(home)
    kinds = {"q": ("", "coordinate", home), "qd": ("/s", "speed", still),
             "qdd": ("/s2", "acceleration", still)}  # fmt: skip
    groups = {
        name.upper(): _per_drive(
            subject, name, "input", f"{words} of drive {{}}", f"{{0.coordinate}}{per}", starts
        )
        for name, (per, words, starts) in kinds.items()
    }
    q = tuple(variable.name for variable in groups["Q"])
    z = tuple(
        FmuVariable(name, "output", UNITS[name], _TASK[name], needs=q)
        for name in subject.robot.task.names
    )
    return Variables({**groups, "TAU": _per_drive(subject, "tau", "output", *_EFFORT), "Z": z})


# Units as powers of SI base units.
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


def model_description(
    name: str,
    provenance: str,
    token: str,
    sources: Sequence[str],
    variables: Variables,
    version: FmiVersion,
) -> str:
    """The text of modelDescription.xml; indices count from 1 in FMI 2, from 0 in FMI 3.

    Args:
        name: the model identifier.
        provenance: origin of the numbers.
        token: identifies the unit in the description and in its binaries.
        sources: names of the C files.
    """
    outputs = [v for v in variables.all if v.causality == "output"]
    slopes = [v for v in variables.all if v.derivative_of]
    initial = [v for v in variables.all if v in outputs + slopes and v.start is None]
    root = rendered_xml(
        "description.xml.jinja",
        name=name,
        provenance=provenance,
        token=token,
        files=sources,
        variables=variables.all,
        version=version,
        released=released("deltaid"),
        places={variable.name: k for k, variable in enumerate(variables.all)},
        units=sorted({variable.unit for variable in variables.all} - {""}),
        bases=_UNITS,
        groups=(
            ("Outputs", "Output", outputs),
            ("Derivatives", "ContinuousStateDerivative", slopes),
            ("InitialUnknowns", "InitialUnknown", initial),
        ),
    )
    return xml_text(root, _HEAD)


_NAMESPACE = uuid.UUID("7d0d8b4e-5f0e-4c43-9e0e-0d1b6a3a5c11")


def fmu(
    subject: Model,
    name: str,
    *,
    forward: bool,
    version: FmiVersion = "2",
    compiler: Compiler | None = None,
    progress: Progress = lambda _: None,
) -> Export:
    """A model as a unit whose model identifier is `name`; warns if libraries are missing.

    Args:
        compiler: makes the libraries; default: that of `found_compiler`.
        progress: called before each library.

    Raises:
        DeltaidError: the name is no identifier of C.
    """
    variables = forward_variables(subject) if forward else inverse_variables(subject)
    variables = variables if version == "2" else variables.with_time()
    sources, token = _sources(subject, name, variables, forward=forward, version=version)
    made, warning = binaries(name, sources, version, compiler or found_compiler(), progress)
    files, whence = [path for path in sources if path.endswith(".c")], subject.provenance
    description = model_description(name, whence, token, files, variables, version)
    texts = {"modelDescription.xml": description}
    texts |= {f"sources/{path}": text for path, text in sources.items()}
    texts["documentation/index.html"] = rendered(
        "unit.html.jinja",
        title=name,
        provenance=whence,
        variables=variables.all,
        quantities=quantities(subject),
    )
    if version == "3":  # replaces the list of files of FMI 2
        build = rendered_xml("build.xml.jinja", name=name, files=files)
        texts["sources/buildDescription.xml"] = xml_text(build, _HEAD)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as unit:
        for path, content in ({path: text.encode() for path, text in texts.items()} | made).items():
            # reproducible bytes
            unit.writestr(zipfile.ZipInfo(path), content, zipfile.ZIP_DEFLATED)
    return Export({".fmu": archive.getvalue()}, (warning,) if warning else ())


def _sources(
    subject: Model, name: str, variables: Variables, *, forward: bool, version: FmiVersion
) -> tuple[dict[str, str], str]:
    """C files by name, and the token that identifies the unit."""
    code = c_code(subject, name)
    table = parameter_table(subject, "table")
    values = {
        "major": int(version),
        "prefix": name,
        "provenance": c_comment(subject.provenance),
        "guard": name.upper(),
        "dof": subject.dynamics.dof,
        "n_states": variables.states,
        "n_reals": len(variables.all),
        "places": variables.places,
        "held": "r + PAYLOAD, " if "PAYLOAD" in variables.places else "",
        "start": [DOUBLE.c_number(v.start or 0.0) for v in variables.all],
        "settable": [int(v.settable) for v in variables.all],
        "table": table.rows,
        "longest_step": DOUBLE.c_number(LONGEST_STEP),
        **(_functions(subject, table) if forward else {}),
    }
    unsigned = rendered("unit.c.jinja", guid="", **values)
    token = str(uuid.uuid5(_NAMESPACE, "\n".join((code.text(".c"), unsigned))))
    return {
        f"{name}.h": code.text(".h"),
        f"{name}.c": code.text(".c"),
        f"fmi{version}.c": rendered("unit.c.jinja", guid=token, **values),
    }, token


def _functions(subject: Model, table: ParameterTable) -> dict[str, str]:
    """ż, accelerations, and the functions of `ForwardDynamics.step`, as C text."""
    e, forward, payload = subject.dynamics.equations, subject.forward, list[Array]()
    if name := subject.robot.load_carrier:  # the payload is a point mass at the carrier's origin
        p, mass = ca.SX(table.p), ca.SX.sym("payload")
        p[subject.layout.body(name).start] += mass
        table, payload = replace(table, p=p), [Array("payload", mass)]
    speed, z, qd = Array("speed", ca.SX.sym("speed")), Array("z", e.z), Array("qd", e.qd)
    (*state, p, h), changes = forward.velocity_change()
    arrays = [Array(n, s) for n, s in zip(("z", "qd", "qd0", "tau"), state, strict=True)]
    change, step = ca.substitute(changes, [p], [table.p])[0], Array("h", h)
    f = forward.equations
    texts = {
        "rates": ("rates", [z, qd], "zd", e.T @ e.qd),
        "change": ("velocity_change", [*arrays, *payload, step, table.array], "change", change),
        "ahead": ("ahead", [Array("z", f.z), Array("zd", f.zd), step], "room",
                  forward.ahead(f.z, f.zd, h)),
    }  # fmt: skip
    sign = "tanh({a} / speed[0])"
    return {
        "accelerations": accelerations(subject, table, speed, *payload, sign=sign),
        **{
            key: straight_line(name, inputs, (out, value), linkage="static ")
            for key, (name, inputs, out, value) in texts.items()
        },
    }
