"""C99 code of a model: kinematics, inverse dynamics and the terms of (1), without dependencies.

Parameters stand in one `static const` table, named and with units. Functions keep no state,
allocate nothing and return within a bounded number of operations.
"""

import re
from dataclasses import dataclass

import casadi as ca

from deltaid.errors import DeltaidError
from deltaid.exports.c_functions import cycle_texts, function_texts
from deltaid.exports.digits import care_for
from deltaid.exports.functions import STATUSES, ParameterTable, parameter_table
from deltaid.exports.further_functions import further_cycles, further_functions
from deltaid.exports.model_functions import acceleration, model_functions
from deltaid.exports.pairs import pairs_of_c
from deltaid.exports.straight_line import SIGN, Array, straight_line
from deltaid.exports.text import DOUBLE, SINGLE, Precision, c_comment, rendered
from deltaid.model.model import Model
from deltaid.online.settings import OnlineSettings


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


DEFAULT = OnlineSettings()

# Headers of C, of what these take in, and of an FMU, which a compiler told to look into the folder
# would not find.
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
) -> CCode:
    """The C code of a model; its functions are named PREFIX_….

    Args:
        further: names of functions beside those that every export has (`options.FURTHER`).
        online: of the function of that name.

    Raises:
        DeltaidError: the prefix is no identifier of C, or the name of a standard header; or the
            robot has not what a further function needs.
    """
    _require_name(prefix)
    robot, dof = subject.robot, subject.dynamics.dof
    table = parameter_table(subject, f"{prefix}_p", precision)
    functions = [
        *model_functions(subject, table, precision),
        *further_functions(subject, table, further),
    ]
    cycles = further_cycles(subject, further, online)
    care = care_for(subject, table.array.name) if precision is SINGLE else None
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
        "linear": [robot.is_linear(drive) for drive in robot.drives],
        "statuses": STATUSES,
        "table": table.rows,
        "home": [precision.c_number(x) for x in subject.home],
        "functions": texts,
        "pairs": pairs_of_c(str([entry["texts"] for entry in texts])),
        "cycles": [cycle_texts(c, precision) for c in cycles],
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
