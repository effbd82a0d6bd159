"""C99 code of a model: kinematics, inverse dynamics and the terms of (1), without dependencies.

Everything is computed from task coordinates z, which `…_forward_kinematics` finds once a cycle; so
a controller that needs torque, mass matrix and gravity pays for the loops only once. Parameters
stand in one `static const` table, named and with units. Functions keep no state, allocate nothing
and return within a bounded number of operations.
"""

import re
from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.dynamics.equations import Equations
from deltaid.dynamics.load_friction import carried, losses
from deltaid.dynamics.task_dynamics import cholesky_solve
from deltaid.errors import DeltaidError
from deltaid.export.fill import rendered
from deltaid.export.straight_line import SIGN, Array, number, straight_line
from deltaid.export.text import c_comment
from deltaid.model.model import Model

# Newton's method halves the error's logarithm; from a start that is some millimetres away four
# steps do, and what has not arrived after this many is far away or has no solution.
_NEWTON_STEPS = 20
# Distances [m] at which loops count as closed, and by which rounding may put a limb in its other
# working mode: those of mechanism.newton and mechanism.forward.
_CLOSED, _MODE = 1e-12, 1e-9


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


@dataclass(frozen=True)
class ParameterTable:
    """Parameters that are not zero: their names, units and values, and p with symbols for them."""

    rows: list[tuple[str, str, str]]
    array: Array
    p: ca.SX


# Headers of C99 and of an FMU, which a compiler told to look into the folder would not find.
_OTHER_HEADERS = (
    "assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits",
    "locale", "math", "setjmp", "signal", "stdarg", "stdbool", "stddef", "stdint", "stdio",
    "stdlib", "string", "tgmath", "time", "wchar", "wctype", "fmi2",
)  # fmt: skip


def c_code(subject: Model, prefix: str) -> CCode:
    """The C code of a model; its functions are named PREFIX_….

    Raises:
        DeltaidError: the prefix is no identifier of C, or the name of a standard header.
    """
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
    dynamics, table = subject.dynamics, parameter_table(subject, f"{prefix}_p")
    closed_form = dynamics.kinematics.mechanism.forward is not None
    units = dynamics.robot.drive_units
    return CCode(
        prefix,
        *(
            rendered(
                name,
                prefix=prefix,
                guard=prefix.upper(),
                provenance=c_comment(subject.provenance),
                robot=dynamics.robot,
                dof=dynamics.dof,
                units=units,
                linear=[dynamics.robot.is_linear(drive) for drive in dynamics.robot.drives],
                closed_form=closed_form,
                limbs=len(dynamics.robot.limb_geometry),
                table=table.rows,
                home=[number(x) for x in subject.home],
                functions=_functions(subject, prefix, table),
                accelerations=accelerations(subject, table),
                forward=_forward(subject),
                newton_steps=_NEWTON_STEPS,
                closed=number(_CLOSED),
                mode=number(_MODE),
            )
            for name in ("model.h.jinja", "model.c.jinja")
        ),
    )


def parameter_table(subject: Model, name: str) -> ParameterTable:
    """The parameters of a model as a C table, without those that are zero."""
    layout, kept = subject.dynamics.layout, np.flatnonzero(subject.p)
    symbols, p = ca.SX.sym("p", len(kept)), ca.SX.zeros(subject.p.size)
    rows = []
    for k, i in enumerate(kept):
        p[int(i)] = symbols[k]
        rows.append((c_comment(layout.names[i]), layout.units[i], number(subject.p[i])))
    return ParameterTable(rows, Array(name, symbols, is_table=True), p)


def _functions(subject: Model, prefix: str, table: ParameterTable) -> list[str]:
    """The public functions of z that need no loop and cannot fail."""
    e: Equations = subject.dynamics.equations
    z, qd, qdd = Array("z", e.z), Array("qd", e.qd), Array("qdd", e.qdd)
    wanted: list[tuple[str, list[Array], tuple[str, ca.SX]]] = [
        ("jacobian", [z], ("J", e.J)),
        ("inverse_dynamics_at", [z, qd, qdd], ("tau", e.torque)),
        ("mass_matrix", [z], ("M", e.M)),
        ("bias", [z, qd], ("h", bias(subject, e))),
        ("gravity", [z], ("g", e.g)),
    ]
    names = [name for name, _, _ in wanted]
    expressions = ca.substitute([out for *_, (_, out) in wanted], [e.p], [table.p])
    texts = []
    for name, (_, inputs, (out, _)), expression in zip(names, wanted, expressions, strict=True):
        arrays = [*inputs, table.array]
        texts.append(straight_line(f"{prefix}_{name}", arrays, (out, expression)))
    return texts


def bias(subject: Model, e: Equations) -> ca.SX:
    """C q̇ + g + f as the torque without acceleration and without losses that depend on load."""
    names, p = subject.dynamics.layout.names, ca.SX(e.p)
    for drive in subject.robot.load_drives:
        p[names.index(f"load.{drive}")] = 0
    return ca.substitute([e.torque], [e.qdd, e.p], [ca.SX.zeros(e.qdd.numel()), p])[0]


def accelerations(subject: Model, table: ParameterTable, *smooth: Array, sign: str = SIGN) -> str:
    """C text of `static void accelerations(z, qd, tau, …, qdd)`: M q̈ = τ − C q̇ − g − f.

    By Cholesky's method in one piece with all that M and the forces share; NaN where M is not
    positive definite. Friction that depends on load takes its share of what gears carry.

    Args:
        smooth: further arguments.
        sign: C expression of the sign of a speed {a}.
    """
    e, tau = subject.dynamics.equations, ca.SX.sym("tau", subject.dynamics.dof)
    qdd = ca.substitute([acceleration(subject, e, tau)], [e.p], [table.p])[0]
    arrays = [Array("z", e.z), Array("qd", e.qd), Array("tau", tau), *smooth, table.array]
    return straight_line("accelerations", arrays, ("qdd", qdd), linkage="static ", sign=sign)


def acceleration(subject: Model, e: Equations, tau: ca.SX) -> ca.SX:
    """q̈(z, q̇, τ, p)."""
    robot = subject.robot
    losing = [robot.drives.index(drive) for drive in robot.load_drives]
    right = ca.horzcat(tau - bias(subject, e), ca.SX.eye(tau.numel())[:, losing])
    responses = cholesky_solve(e.M, right)
    if not losing:
        return responses
    qdd, G = responses[:, 0], responses[:, 1:]
    x = carried(robot, tau, e.qd, qdd, e.p)
    return qdd - G @ losses(robot, x, G, e.qd, e.p)


def _forward(subject: Model) -> dict[str, str]:
    """Helpers of forward and inverse kinematics, and the sign that det Φ_z has at home."""
    m = subject.dynamics.kinematics.mechanism
    q, z = Array("q", m.q_symbols), Array("z", m.z)
    q_and_reach = ca.vertcat(m.q, m.reach)
    parts = {"inverse": straight_line("drives", [z], ("out", q_and_reach), linkage="static ")}
    parts["reaches"] = str(m.reach.numel())
    if m.forward is not None:
        form = m.forward
        out = ca.vertcat(form.z, form.margin, form.modes)
        parts["closed_form"] = straight_line("pose", [q], ("out", out), linkage="static ")
        parts["modes"] = str(form.modes.numel())
        return parts
    slope = ca.jacobian(m.closure, m.z)
    step = ca.vertcat(m.closure, ca.inv_minor(slope) @ m.closure)
    parts["step"] = straight_line("newton", [z, q], ("out", step), linkage="static ")
    branch = ca.vertcat(ca.det(slope), m.modes)
    parts["branch"] = straight_line("branch", [z, q], ("out", branch), linkage="static ")
    parts["modes"] = str(m.modes.numel())
    q_home = ca.Function("q", [m.z], [m.q])(subject.home)
    det = ca.Function("d", [m.z, m.q_symbols], [branch[0]])(subject.home, q_home)
    parts["sign"] = number(float(np.sign(float(det))))
    return parts
