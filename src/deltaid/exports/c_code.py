"""C99 code of a model: kinematics, inverse dynamics and the terms of (1), without dependencies.

Parameters are one `static const` table, with names and units. Functions keep no state,
allocate nothing and return within a bounded number of operations.
"""

import re
import textwrap

import casadi as ca

from deltaid.errors import DeltaidError
from deltaid.exports.digits import Care
from deltaid.exports.functions import (
    STATUSES,
    ExportedCycle,
    ExportedFunction,
    ParameterTable,
    note_of,
)
from deltaid.exports.model_functions import DEFAULT, acceleration, code_parts
from deltaid.exports.straight_line import SIGN, Array, straight_line, wrapped
from deltaid.exports.text import (
    DOUBLE,
    Export,
    Precision,
    c_comment,
    pairs_of_c,
    plain_letters,
    rendered,
)
from deltaid.model.model import Model
from deltaid.online.graph import Layout
from deltaid.online.settings import OnlineSettings


def function_texts(
    f: ExportedFunction, prefix: str, dof: int, precision: Precision, care: Care | None
) -> dict[str, object]:
    """Variables of a function for the templates."""
    real, size = precision.c_type, sum(output.size for output in f.outputs)
    inputs = [(array.name, array.symbols.numel()) for array in f.arguments]
    outputs = [(output.name, output.size) for output in f.outputs]
    if f.after:  # own arguments, the computed pose, and arguments passed on
        outputs = [("z", dof), ("tau", dof)]
    signature = [f"const {real} {name}[{n}]" for name, n in inputs]
    signature += [f"{real} {name}[{n}]" for name, n in outputs]
    handed = ["pose", *(name for name, _ in inputs if name != "q" or f.closing), "tau"]
    demands, first = list[tuple[int, int, str, str]](), size
    for demand in f.demands:  # index of each value in the common result, and number of its entries
        if n := demand.value.numel():
            demands.append((first, n, precision.c_number(demand.bound), demand.status))
        first += n
    return {
        "declaration": "\n".join(wrapped(f"int {prefix}_{f.name}({', '.join(signature)})")),
        "comment": _block([*textwrap.wrap(f.doc, 93), *f.entry_notes(" in each of {} rows")]),
        "after": f.after,
        "passed": ", ".join(handed),
        "inner": f.name,
        "given": ", ".join(name for name, _ in inputs),
        "checked": [*inputs, *(outputs[:1] if f.newton else [])],
        "newton": f.newton
        and {
            "name": f.outputs[0].name,
            "size": f.newton.x.numel(),
            "steps": f.newton.steps,
            "last": precision.c_number(f.newton.last),
            "closed": precision.c_number(f.newton.closed),
        },
        "texts": [] if f.after else _straight(f, precision, care),
        "size": f.everything.numel(),
        "results": size,
        "demands": demands,
        "unfit": f.unfit,
        "outputs": f.places,
    }


def _straight(f: ExportedFunction, precision: Precision, care: Care | None) -> list[str]:
    inputs, steps = list(f.inputs), [("at", f.everything, f.parts)]
    if f.newton:
        inputs = [Array("x", f.newton.x), *inputs]
        steps.insert(0, ("step", f.newton.both, f.newton.parts))
    return [
        straight_line(
            f"{f.name}_{name}", inputs, ("out", value), precision=precision, care=care, parts=parts
        )
        for name, value, parts in steps
    ]


def _block(lines: list[str]) -> str:
    return (
        f"/* {c_comment(plain_letters(chr(10).join(lines))).replace(chr(10), f'{chr(10)} * ')} */"
    )


def cycle_texts(c: ExportedCycle, precision: Precision) -> dict[str, object]:
    """Template variables of a cycle: three structs, indices of their fields, and its function."""
    graph = c.graph
    inputs, both = [Array("x", graph.x), Array("u", graph.u)], ca.vertcat(graph.following, graph.y)
    structs = {
        "state": ("What the cycle keeps.", graph.state),
        "inputs": ("What it reads.", graph.inputs),
        "outputs": ("What it gives.", graph.outputs),
    }
    return {
        "name": c.name,
        "comment": _block(textwrap.wrap(c.doc, 93)),
        "text": straight_line(f"{c.name}_step", inputs, ("out", both), precision=precision),
        "structs": [(name, doc, _fields(layout)) for name, (doc, layout) in structs.items()],
        "start": [precision.c_number(x) for x in graph.state.initial],
        "sizes": {name: layout.size for name, (_, layout) in structs.items()},
    }


def _fields(layout: Layout) -> list[tuple[str, int, int, str]]:
    notes = {f.name: textwrap.wrap(plain_letters(note_of(f)), 88) for f in layout.fields}
    return [
        (f.name, f.size, layout.places[f.name].start, "\n     * ".join(notes[f.name]))
        for f in layout.fields
    ]


# Standard headers, and those of an FMU: a compiler with the folder on its path would confuse ours
# with them.
_OTHER_HEADERS = (
    "assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits",
    "locale", "math", "setjmp", "signal", "stdarg", "stdbool", "stddef", "stdint", "stdio",
    "stdlib", "string", "tgmath", "time", "wchar", "wctype", "stdalign", "stdatomic", "threads",
    "uchar", "features", "alloca", "endian", "windows", "fmi2", "fmi3",
)  # fmt: skip


def c_code(
    subject: Model,
    prefix: str,
    precision: Precision = DOUBLE,
    further: tuple[str, ...] = (),
    online: OnlineSettings = DEFAULT,
) -> Export:
    """The C code of a model, source and header; its functions are named PREFIX_….

    Args:
        further: names of additional functions (`options.FURTHER`).
        online: settings of the function of that name.

    Raises:
        DeltaidError: the prefix is no identifier of C, or the name of a standard header; or the
            robot lacks what an additional function needs.
    """
    _require_name(prefix)
    robot, dof = subject.robot, subject.dynamics.dof
    table, functions, cycles, care = code_parts(subject, f"{prefix}_p", precision, further, online)
    texts = [function_texts(f, prefix, dof, precision, care) for f in functions]
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
        "linear": robot.linear_drives,
        "statuses": STATUSES,
        "table": table.rows,
        "home": [precision.c_number(x) for x in subject.home],
        "functions": texts,
        "pairs": pairs_of_c(str([entry["texts"] for entry in texts])),
        "cycles": [cycle_texts(c, precision) for c in cycles],
    }
    source, header = (rendered(f"model.{kind}.jinja", **values) for kind in "ch")
    return Export({".c": source, ".h": header})


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

    Results are NaN where M is not positive definite.

    Args:
        smooth: additional arguments.
        sign: C expression of the sign of a speed {a}.
    """
    e, tau = subject.dynamics.equations, ca.SX.sym("tau", subject.dynamics.dof)
    qdd = ca.substitute([acceleration(subject, e, tau)], [e.p], [table.p])[0]
    arrays = [Array("z", e.z), Array("qd", e.qd), Array("tau", tau), *smooth, table.array]
    return straight_line("accelerations", arrays, ("qdd", qdd), sign=sign)
