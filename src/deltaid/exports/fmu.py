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
from deltaid.exports.c_code import ParameterTable, accelerations, c_code, parameter_table
from deltaid.exports.fmu_binaries import Compiler, binaries, found_compiler
from deltaid.exports.fmu_description import (
    Described,
    Variables,
    build_description,
    carrier,
    forward_variables,
    inverse_variables,
    model_description,
)
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
    compiler = compiler or found_compiler()
    made, warning = binaries(name, sources, version, compiler, progress)
    files = tuple(path for path in sources if path.endswith(".c"))
    unit = Described(name, subject.provenance, token, files)
    texts = {"modelDescription.xml": model_description(unit, variables, version)}
    texts |= {f"sources/{path}": text for path, text in sources.items()}
    texts["documentation/index.html"] = rendered(
        "unit.html.jinja", unit=unit, variables=variables.all, quantities=quantities(subject)
    )
    if version == "3":
        texts["sources/buildDescription.xml"] = build_description(unit)
    content = _zipped({path: text.encode() for path, text in texts.items()} | made)
    return Export({".fmu": content}, (warning,) if warning else ())


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
    """ż, accelerations, and the parts of a time step, as C text."""
    e, speed = subject.dynamics.equations, Array("speed", ca.SX.sym("speed"))
    table, payload = _carrying(subject, table)
    z, qd = Array("z", e.z), Array("qd", e.qd)
    rates = straight_line("rates", [z, qd], ("zd", e.T @ e.qd), linkage="static ")
    smooth = accelerations(subject, table, speed, *payload, sign="tanh({a} / speed[0])")
    return {"rates": rates, "accelerations": smooth, **_of_a_step(subject, table, payload)}


def _carrying(subject: Model, table: ParameterTable) -> tuple[ParameterTable, tuple[Array, ...]]:
    """The table with a mass that EE or P holds at its origin, and the mass; none without them."""
    name = carrier(subject)
    if not name:
        return table, ()
    p, payload = ca.SX(table.p), ca.SX.sym("payload")
    p[subject.layout.body(name).start] += payload
    return replace(table, p=p), (Array("payload", payload),)


def _of_a_step(subject: Model, table: ParameterTable, payload: tuple[Array, ...]) -> dict[str, str]:
    """The functions that `ForwardDynamics.step` is made of."""
    forward = subject.forward
    (*state, p, h), changes = forward.velocity_change()
    arrays = [Array(n, s) for n, s in zip(("z", "qd", "qd0", "tau"), state, strict=True)]
    change = ca.substitute(changes, [p], [table.p])[0]
    zd = forward.equations.zd
    room = [Array("z", forward.equations.z), Array("zd", zd), Array("h", h)]
    return {
        "change": straight_line(
            "velocity_change",
            [*arrays, *payload, Array("h", h), table.array],
            ("change", change),
            linkage="static ",
        ),
        "ahead": straight_line(
            "ahead",
            room,
            ("room", forward.ahead(forward.equations.z, zd, h)),
            linkage="static ",
        ),
    }


def _zipped(files: dict[str, bytes]) -> bytes:
    """A zip file whose bytes depend on its content only."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as unit:
        for path, content in files.items():
            unit.writestr(zipfile.ZipInfo(path), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()
