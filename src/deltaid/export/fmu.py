"""A model as a functional mock-up unit (FMI 2.0) from C sources, for exchange and co-simulation.

Two units: the robot itself, torques in and motion out (`forward`), and its inverse dynamics, motion
in and torques out (`inverse`). Both hold their sources; where a C compiler is found, the binary for
this machine as well, so that nothing has to be compiled where the unit is used.

The robot's states are z and q̇: ż = J⁻¹ q̇ and M q̈ = τ − C q̇ − g − f, so no loop can drift. The sign
of a speed v in friction is tanh(v / friction_speed), for integrators that take no steps in forces.
In co-simulation the unit integrates by itself, with steps as short as that needs.
"""

import io
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from deltaid.errors import Doubt
from deltaid.export.c_code import ParameterTable, accelerations, c_code, parameter_table
from deltaid.export.fill import rendered
from deltaid.export.fmu_variables import (
    FRICTION_SPEED,
    forward_variables,
    inverse_variables,
    model_description,
)
from deltaid.export.straight_line import Array, number, straight_line
from deltaid.export.text import c_comment
from deltaid.model.model import Model

# Longest step [s] of the unit's own integrator.
_LONGEST = 1e-3
_NAMESPACE = uuid.UUID("7d0d8b4e-5f0e-4c43-9e0e-0d1b6a3a5c11")
_BINARIES = {"linux": ("linux64", ".so"), "darwin": ("darwin64", ".dylib")}


@dataclass(frozen=True)
class FmuExport:
    """A unit as the bytes of its file, and what was not possible."""

    content: bytes
    warnings: tuple[str, ...]


def fmu(subject: Model, name: str, *, forward: bool) -> FmuExport:
    """A model as a unit; its model identifier is `name`.

    Raises:
        DeltaidError: the name is no identifier of C.
    """
    code = c_code(subject, name)
    variables = forward_variables(subject) if forward else inverse_variables(subject)
    table = parameter_table(subject, "table")
    functions = _functions(subject, table) if forward else {}
    values = {
        "prefix": name,
        "provenance": c_comment(subject.provenance),
        "guard": name.upper(),
        "dof": subject.dynamics.dof,
        "n_states": variables.states,
        "n_reals": len(variables.all),
        "places": variables.places,
        "start": [number(v.start or 0.0) for v in variables.all],
        "settable": [int(v.settable) for v in variables.all],
        "table": table.rows,
        "longest_step": number(_LONGEST),
        "friction_step": number(_friction_step(subject)),
        "speed": number(FRICTION_SPEED),
        **functions,
    }
    unsigned = rendered("fmi2.c.jinja", guid="", **values)
    guid = str(uuid.uuid5(_NAMESPACE, "\n".join((code.source, unsigned))))
    sources = {
        f"{name}.h": code.header,
        f"{name}.c": code.source,
        "fmi2.c": rendered("fmi2.c.jinja", guid=guid, **values),
    }
    files = {"modelDescription.xml": model_description(subject, name, guid, variables).encode()}
    files |= {f"sources/{path}": text.encode() for path, text in sources.items()}
    binary, warning = _compiled(name, sources)
    return FmuExport(_zipped(files | binary), (warning,) if warning else ())


def _functions(subject: Model, table: ParameterTable) -> dict[str, str]:
    """ż and the accelerations of the robot, as C text."""
    e, speed = subject.dynamics.equations, Array("speed", ca.SX.sym("speed"))
    z, qd = Array("z", e.z), Array("qd", e.qd)
    rates = straight_line("rates", [z, qd], ("zd", e.T @ e.qd), linkage="static ")
    smooth = accelerations(subject, table, speed, sign="tanh({a} / speed[0])")
    return {"rates": rates, "accelerations": smooth}


def _friction_step(subject: Model) -> float:
    """Step [s] that smoothed friction allows: one over its fastest decay, at home.

    At a speed v far below friction_speed s, friction is F v with F about f(s)/s for each drive.
    """
    e, z = subject.dynamics.equations, subject.home
    function = ca.Function("f", [e.z, e.qd, e.p], [e.f, e.M])
    drives = FRICTION_SPEED * np.eye(e.qd.numel())
    found = [function(z, qd, subject.p) for qd in drives]
    F = np.column_stack([np.asarray(f).ravel() for f, _ in found]) / FRICTION_SPEED
    decay = np.abs(np.linalg.eigvals(np.linalg.solve(np.asarray(found[0][1]), F))).max()
    return float(min(1.0 / decay, 1.0)) if decay > 0 else 1.0


def _compiled(name: str, sources: dict[str, str]) -> tuple[dict[str, bytes], str]:
    """The binary for this machine by its path in the unit, or a sentence why there is none."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    known = platform.machine() in ("x86_64", "AMD64") or sys.platform == "darwin"
    where = _BINARIES.get(sys.platform) if known else None
    if compiler is None:
        return {}, _sources_only("no C compiler was found (cc, gcc or clang)")
    if where is None:
        return {}, _sources_only("binaries for this machine are not known to FMI 2")
    folder, suffix = where
    with tempfile.TemporaryDirectory() as work:
        for path, text in sources.items():
            (Path(work) / path).write_text(text, encoding="utf-8")
        library = f"{name}{suffix}"
        options = ["-std=c99", "-O1", "-fPIC", "-shared", "-fvisibility=hidden"]
        files = [path for path in sources if path.endswith(".c")]
        command = [compiler, *options, "-o", library, *files, "-lm"]
        done = subprocess.run(command, cwd=work, capture_output=True, check=False)
        if done.returncode:
            reason = done.stderr.decode(errors="replace").strip().split("\n", 1)[0]
            return {}, _sources_only(f"{compiler} failed ({reason[:200]})")
        return {f"binaries/{folder}/{library}": (Path(work) / library).read_bytes()}, ""


def _sources_only(why: str) -> Doubt:
    cure = "let the importing tool compile them, as FMPy does, or export again with a C compiler"
    return Doubt("the unit holds sources only", cause=why, cure=cure)


def _zipped(files: dict[str, bytes]) -> bytes:
    """A zip file whose bytes depend on its content only."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as unit:
        for path, content in files.items():
            unit.writestr(zipfile.ZipInfo(path), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()
