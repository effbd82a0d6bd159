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
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version as released

import casadi as ca

from deltaid.control.simulation import LONGEST_STEP
from deltaid.exports.c_code import accelerations, c_code
from deltaid.exports.fmu_binaries import Compiler, binaries, found_compiler
from deltaid.exports.fmu_variables import Variables, forward_variables, inverse_variables
from deltaid.exports.functions import ParameterTable, parameter_table
from deltaid.exports.options import FmiVersion
from deltaid.exports.straight_line import Array, straight_line
from deltaid.exports.structured_text import quantities
from deltaid.exports.text import DOUBLE, Export, c_comment, rendered, rendered_xml, xml_text
from deltaid.model.model import Model
from deltaid.progress import Progress

_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'


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
            key: straight_line(name, inputs, (out, value))
            for key, (name, inputs, out, value) in texts.items()
        },
    }
