"""C99 code of a model: kinematics, inverse dynamics and the terms of (1), without dependencies.

Parameters stand in one `static const` table, named and with units. Functions keep no state,
allocate nothing and return within a bounded number of operations.
"""

import re
import textwrap
from dataclasses import dataclass

import casadi as ca

from deltaid.errors import DeltaidError
from deltaid.export.fill import rendered
from deltaid.export.functions import STATUSES, ExportedFunction, Newton
from deltaid.export.further_functions import further_functions
from deltaid.export.model_functions import acceleration, model_functions
from deltaid.export.parameter_table import ParameterTable, parameter_table
from deltaid.export.precision import DOUBLE, Precision
from deltaid.export.straight_line import SIGN, Array, straight_line, wrapped
from deltaid.export.text import c_comment
from deltaid.model.model import Model


@dataclass(frozen=True)
class CCode:
    """A pair of C files.

    Attributes:
        prefix: what all names begin with.
        header, source: the text of PREFIX.h and PREFIX.c.
    """

    prefix: str
    header: str
    source: str


# Headers of C99 and of an FMU, which a compiler told to look into the folder would not find.
_OTHER_HEADERS = (
    "assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits",
    "locale", "math", "setjmp", "signal", "stdarg", "stdbool", "stddef", "stdint", "stdio",
    "stdlib", "string", "tgmath", "time", "wchar", "wctype", "fmi2",
)  # fmt: skip


def c_code(
    subject: Model,
    prefix: str,
    precision: Precision = DOUBLE,
    further: tuple[str, ...] = (),
) -> CCode:
    """The C code of a model; its functions are named PREFIX_….

    Args:
        further: names of functions beside those that every export has (`options.FURTHER`).

    Raises:
        DeltaidError: the prefix is no identifier of C, or the name of a standard header; or the
            robot has not what a further function needs.
    """
    _require_name(prefix)
    table = parameter_table(subject, f"{prefix}_p", precision)
    functions = [
        *model_functions(subject, table, precision),
        *further_functions(subject, table, further),
    ]
    robot, dof = subject.robot, subject.dynamics.dof
    values = {
        "prefix": prefix,
        "guard": prefix.upper(),
        "provenance": c_comment(subject.provenance),
        "precision": "double" if precision is DOUBLE else "single",
        "real": precision.c_type,
        "suffix": precision.suffix,
        "zero": precision.c_number(0.0),
        "dof": dof,
        "units": robot.drive_units,
        "linear": [robot.is_linear(drive) for drive in robot.drives],
        "statuses": STATUSES,
        "table": table.rows,
        "home": [precision.c_number(x) for x in subject.home],
        "functions": [_texts(f, prefix, dof, precision) for f in functions],
    }
    return CCode(prefix, rendered("model.h.jinja", **values), rendered("model.c.jinja", **values))


def _require_name(prefix: str) -> None:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,40}", prefix):
        raise DeltaidError(
            f"'{prefix[:60]}' cannot begin the names of C functions",
            where="name of the output",
            cure="use letters, digits and _, a letter first",
        )
    if prefix.lower() in _OTHER_HEADERS:
        raise DeltaidError(
            f"'{prefix}.h' would be mistaken for another header of that name",
            where="name of the output",
            cure="choose another name",
        )


def accelerations(subject: Model, table: ParameterTable, *smooth: Array, sign: str = SIGN) -> str:
    """C text of `static void accelerations(z, qd, tau, …, qdd)`: M q̈ = τ − C q̇ − g − f.

    NaN where M is not positive definite.

    Args:
        smooth: further arguments.
        sign: C expression of the sign of a speed {a}.
    """
    e, tau = subject.dynamics.equations, ca.SX.sym("tau", subject.dynamics.dof)
    qdd = ca.substitute([acceleration(subject, e, tau)], [e.p], [table.p])[0]
    arrays = [Array("z", e.z), Array("qd", e.qd), Array("tau", tau), *smooth, table.array]
    return straight_line("accelerations", arrays, ("qdd", qdd), linkage="static ", sign=sign)


def _texts(f: ExportedFunction, prefix: str, dof: int, precision: Precision) -> dict[str, object]:
    """What the templates ask of a function."""
    real, size = precision.c_type, sum(output.size for output in f.outputs)
    inputs = [(array.name, array.symbols.numel()) for array in f.arguments]
    outputs = [(output.name, output.size) for output in f.outputs]
    if f.after:  # its own arguments, the pose that it finds, and what it hands on
        outputs = [("z", dof), ("tau", dof)]
    signature = [f"const {real} {name}[{n}]" for name, n in inputs]
    signature += [f"{real} {name}[{n}]" for name, n in outputs]
    declaration = f"int {prefix}_{f.name}({', '.join(signature)})"
    offsets = [sum(n for _, n in outputs[:k]) for k in range(len(outputs))]
    handed = ["pose", *(name for name, _ in inputs if name != "q"), "tau"]
    return {
        "declaration": "\n".join(wrapped(declaration)),
        "comment": _comment(f),
        "after": f.after,
        "passed": ", ".join(handed),
        "inner": f.name,
        "given": ", ".join(name for name, _ in inputs),
        "checked": [*inputs, *([(outputs[0])] if f.newton else [])],
        "newton": _newton(f, f.newton, precision) if f.newton else None,
        "texts": [] if f.after else _straight(f, precision),
        "size": f.everything.numel(),
        "results": size,
        "demands": _demands(f, size, precision),
        "unfit": f.unfit,
        "outputs": [(n, at, k) for (n, k), at in zip(outputs, offsets, strict=True)],
    }


def _newton(f: ExportedFunction, newton: Newton, precision: Precision) -> dict[str, object]:
    return {
        "name": f.outputs[0].name,
        "size": newton.x.numel(),
        "steps": newton.steps,
        "last": precision.c_number(newton.last),
        "closed": precision.c_number(newton.closed),
    }


def _straight(f: ExportedFunction, precision: Precision) -> list[str]:
    """The static functions that compute outputs and demands, and the steps to them."""
    inputs, steps = list(f.inputs), []
    if f.newton:
        inputs = [Array("x", f.newton.x), *inputs]
        steps = [("step", ca.vertcat(f.newton.gap, f.newton.step))]
    return [
        straight_line(
            f"{f.name}_{name}", inputs, ("out", value), linkage="static ", precision=precision
        )
        for name, value in (*steps, ("at", f.everything))
    ]


def _demands(
    f: ExportedFunction, first: int, precision: Precision
) -> list[tuple[int, int, str, str]]:
    """Where in all that is computed each demand stands, how many numbers, bound and status."""
    found = []
    for demand in f.demands:
        n = demand.value.numel()
        if n:
            found.append((first, n, precision.c_number(demand.bound), demand.status))
        first += n
    return found


def _comment(f: ExportedFunction) -> str:
    """What the header says of a function."""
    lines = textwrap.wrap(f.doc, 93)
    for output in f.outputs:
        width = f" in each of {output.size // len(output.entries)} rows" if output.entries else ""
        if output.entries:
            lines.append(f"{output.name}{width if output.size > len(output.entries) else ''}:")
        lines += [f"  [{k}] {name}, {unit}" for k, (name, unit) in enumerate(output.entries)]
    text = c_comment("\n * ".join(lines).replace("²", "^2").replace("α", "a"))
    return f"/* {text} */"
