"""A model as a functional mock-up unit (FMI 2 or 3) from C sources, for both kinds of simulation.

Two units: the robot itself, torques in and motion out (`forward`), and its inverse dynamics, motion
in and torques out (`inverse`). Both hold their sources; where a compiler is found, libraries as
well, so that nothing has to be compiled where the unit is used (`fmu_binaries`).

The robot's states are z and q̇: ż = J⁻¹ q̇, so no loop can drift. In co-simulation the unit goes by
the time steps of `ForwardDynamics.step`, with friction at rest exact. Model exchange asks for q̈ as
a function of the state, which friction at rest is not: there M q̈ = τ − C q̇ − g − f, and the sign
of a speed v in friction is tanh(v / friction_speed), for integrators that take no steps in forces.
"""

import io
import uuid
import zipfile
from dataclasses import replace

import casadi as ca

from deltaid.control.simulation import LONGEST_STEP
from deltaid.exports.c_code import accelerations, c_code
from deltaid.exports.fmu_binaries import Compiler, binaries, found_compiler
from deltaid.exports.fmu_description import (
    Variables,
    build_description,
    carrier,
    forward_variables,
    inverse_variables,
    model_description,
)
from deltaid.exports.functions import ParameterTable, parameter_table
from deltaid.exports.options import FmiVersion
from deltaid.exports.straight_line import Array, straight_line
from deltaid.exports.structured_text import quantities
from deltaid.exports.text import DOUBLE, Export, c_comment, rendered
from deltaid.model.model import Model
from deltaid.progress import Progress

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
    """A model as a unit, with a warning of what was not possible; its model identifier is `name`.

    Args:
        compiler: what makes its libraries; default: what `found_compiler` finds.
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
    if version == "3":
        texts["sources/buildDescription.xml"] = build_description(name, files)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as unit:
        for path, content in ({path: text.encode() for path, text in texts.items()} | made).items():
            # bytes that depend on the content only
            unit.writestr(zipfile.ZipInfo(path), content, zipfile.ZIP_DEFLATED)
    return Export({".fmu": archive.getvalue()}, (warning,) if warning else ())


def _sources(
    subject: Model, name: str, variables: Variables, *, forward: bool, version: FmiVersion
) -> tuple[dict[str, str], str]:
    """C files by name, and the token that the unit tells them by."""
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
    """ż, accelerations, and the functions that `ForwardDynamics.step` is made of, as C text."""
    e, forward, payload = subject.dynamics.equations, subject.forward, list[Array]()
    if name := carrier(subject):  # a mass that EE or P holds at its origin
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
