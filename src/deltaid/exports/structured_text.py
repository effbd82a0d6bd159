"""IEC 61131-3 structured text of a model: the functions that C has, as one file of units.

Functions return a status and have their results as outputs, which count only where it is OK. What
keeps something from one cycle to the next, the pose z or the state of a cycle, is a function block.
A controller that stops on floating-point exceptions meets none here (`st_statements`): numbers too
large for any robot are refused at the door, and nothing is divided or rooted unseen.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.exports.functions import ExportedCycle, note_of
from deltaid.exports.model_functions import code_parts
from deltaid.exports.st_helpers import LARGEST_INPUT, LARGEST_RESULT, helpers, pair_functions
from deltaid.exports.st_statements import literal
from deltaid.exports.st_units import ArrayType, Unit, Variable, array_types, comments, plcopen_xml
from deltaid.exports.st_writer import TABLE, Writer, each
from deltaid.exports.straight_line import Array, in_order
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.model.model import Model
from deltaid.online.graph import Field, Layout
from deltaid.online.settings import OnlineSettings


def cycle_units(writer: Writer, c: ExportedCycle) -> Iterator[Unit]:
    """PREFIX_NAME_start, the first state; PREFIX_NAME_step, a function of state and inputs; and
    PREFIX_NAME, which keeps the state."""
    name, graph, real = f"{writer.prefix}_{c.name}", c.graph, writer.precision.st_type
    n, m, inputs = graph.state.size, graph.outputs.size, graph.inputs.size
    note, scratch = f"The state that {name} begins with.", set[str]()
    yield writer.table(f"{c.name}_start", note, graph.state.initial.tolist(), ())
    both = ca.vertcat(graph.following, graph.y)
    yield Unit(
        f"{name}_step",
        "INT",
        [f"One step of {name}, which calls it."],
        [writer.array("x", n), writer.array("u", inputs)],
        [writer.array("after", n), writer.array("y", m)],
        [Variable("i", "INT"), writer.array("found", n + m)],
        [
            writer.returns(f"{name}_step", "BAD_INPUT"),
            *writer.sane("u", inputs, LARGEST_INPUT),
            writer.returns(f"{name}_step", "SINGULAR"),
            *writer.computed([Array("x", graph.x), Array("u", graph.u)], "found", both, scratch),
            *writer.sane("found", n + m, LARGEST_RESULT),
            *each(n, "after[i] := found[i];"),
            *each(m, f"y[i] := found[i + {n}];"),
            f"IF found[{n + m - 1}] > 0.0 THEN RETURN; END_IF;",
            writer.returns(f"{name}_step", "OK"),
        ],
        real,
        in_order(scratch),
    )
    given = [field for field in graph.outputs.fields if field.name != "status"]
    scratch = set[str]()
    places = graph.state.places
    sizes = {"state": n, "after": n, "bad": n + m, "u": inputs, "y": m}
    yield Unit(
        name,
        "",
        [
            c.doc,
            "A cycle that is not OK learns nothing; its outputs are what is known without it.",
            *(f"state[{places[f.name].start}]: {f.name}, {f.doc}" for f in graph.state.fields),
        ],
        [
            *(_declared(writer, field) for field in graph.inputs.fields),
            Variable("reset", "BOOL", note="forget everything first"),
        ],
        [*(_declared(writer, field) for field in given), Variable("status", "INT")],
        [
            Variable("started", "BOOL"),
            *(writer.array(*array) for array in sizes.items()),
            Variable("i", "INT"),
        ],
        [
            "IF reset OR NOT started THEN",
            f"    i := {name}_start({TABLE} => state);",
            "    started := TRUE;",
            "END_IF;",
            *_copied("u", graph.inputs, graph.inputs.fields, into=True),
            f"status := {name}_step(x := state, u := u, after => after, y => y);",
            f"IF status = {writer.status('OK')} THEN",
            *(f"    {line}" for line in each(n, "state[i] := after[i];")),
            "ELSE",
            *(f"    {line}" for line in _spoilt(writer, c, scratch)),
            "END_IF;",
            *_copied("y", graph.outputs, given, into=False),
        ],
        real,
        in_order(scratch),
    )


def _declared(writer: Writer, field: Field) -> Variable:
    if field.size == 1:
        return Variable(field.name, writer.precision.st_type, note=note_of(field))
    return replace(writer.array(field.name, field.size), note=note_of(field))


def _copied(vector: str, layout: Layout, fields: Iterable[Field], *, into: bool) -> list[str]:
    """Fields to their places in a vector, or from there."""
    lines = []
    for field in fields:
        at, many = layout.places[field.name].start, field.size > 1
        shift = f"i + {at}" if at else "i"
        pair = f"{vector}[{shift if many else at}]", field.name + "[i]" * many
        target, source = pair if into else pair[::-1]
        copied = f"{target} := {source};"
        lines += each(field.size, copied) if many else [copied]
    return lines


def _spoilt(writer: Writer, c: ExportedCycle, scratch: set[str]) -> list[str]:
    """What a bad cycle makes of the state, and gives."""
    values, m = ca.vertsplit(ca.densify(c.spoilt)), c.graph.outputs.size
    changed = [i for i, value in enumerate(values) if not ca.is_equal(value, c.graph.x[i], 1)]
    column = ca.vertcat(c.spoilt_y, *(values[i] for i in changed))
    return [
        *writer.computed([Array("state", c.graph.x)], "bad", column, scratch),
        *each(m, "y[i] := bad[i];"),
        *(f"state[{i}] := bad[{m + k}];" for k, i in enumerate(changed)),
    ]


DEFAULT = OnlineSettings()


@dataclass(frozen=True)
class PlcProgram:
    """Functions and function blocks of a model.

    Attributes:
        prefix: what all names begin with.
        notes: comments at the head.
        units: functions and blocks, those that are called first.
    """

    prefix: str
    notes: tuple[str, ...]
    units: tuple[Unit, ...]

    @property
    def arrays(self) -> tuple[ArrayType, ...]:
        """Types of arrays."""
        return array_types(self.units)

    @property
    def text(self) -> str:
        """As one file of structured text."""
        parts = [part.text() for part in (*self.arrays, *self.units)]
        return "\n".join([*comments(self.notes), "", *parts])

    @property
    def xml(self) -> str:
        """As a file that development systems import."""
        return plcopen_xml(self.prefix, "\n".join(self.notes), self.arrays, self.units)


def plc_program(
    subject: Model,
    prefix: str,
    precision: Precision = DOUBLE,
    further: tuple[str, ...] = (),
    online: OnlineSettings = DEFAULT,
) -> PlcProgram:
    """The units of a model; their names are PREFIX_….

    Args:
        further: names of functions beside those that every export has (`options.FURTHER`).
        online: of the function of that name.

    Raises:
        DeltaidError: the prefix is no identifier, or the robot has not what a further function
            needs.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", prefix) or len(prefix) > 20:
        raise DeltaidError(
            f"'{prefix[:60]}' cannot begin the names of functions of structured text",
            where="name of the output",
            cure="use at most 20 letters, digits and single _ between them, a letter first",
        )
    table, functions, cycles, care = code_parts(subject, "p", precision, further, online)
    writer = Writer(subject, prefix, precision, care)
    what = "The parameters of the model that are not 0: change a mass here."
    notes = [f"{name}, {unit}" for name, unit, _ in table.rows]
    units = [
        *helpers(prefix, precision),
        writer.table("parameters", what, subject.p[subject.p != 0].tolist(), notes),
        writer.table("home", "A pose z in the middle of the workspace.", subject.home.tolist(), ()),
        *(pair_functions(prefix) if precision is SINGLE else []),
        *map(writer.unit, functions),
        *(unit for cycle in cycles for unit in cycle_units(writer, cycle)),
    ]
    conventions = (
        f"IEC 61131-3 structured text, {precision.st_type}. Functions return a status; their "
        "outputs mean something only where that is 0:"
    )
    head = (subject.provenance, conventions, *writer.statuses, *quantities(subject))
    return PlcProgram(prefix, head, tuple(units))


def quantities(subject: Model) -> list[str]:
    """What coordinates of drives and of the task are, with their units."""
    robot = subject.robot
    turn = ", turn psi of the tool [rad]" if subject.dynamics.dof > 3 else ""
    return [
        "Drive coordinates q, rates qd, qdd, torques tau, in the order of the drives:",
        *[
            f"  [{k}] {drive}: "
            + ("m, m/s, m/s^2, N" if robot.is_linear(drive) else "rad, rad/s, rad/s^2, N m")
            for k, drive in enumerate(robot.drives)
        ],
        "at the joint, behind the gear; positive as in docs/conventions.md of deltaid.",
        f"Task coordinates z: x, y, z of the platform point in the world [m]{turn}.",
        "Equation of motion: M(q) qdd + C(q, qd) qd + g(q) + f(qd) = tau.",
    ]


def st_test(
    subject: Model,
    prefix: str,
    precision: Precision,
    vectors: tuple[Float[np.ndarray, "states dof"], ...],
) -> str:
    """PREFIX_test, which calls PREFIX_inverse_dynamics_at once for each vector.

    Torques at some states beside those of Python.

    Args:
        vectors: z, q̇, q̈ and τ, one state a row.
    """
    writer, numbers, real = (
        Writer(subject, prefix, precision),
        np.hstack(vectors),
        precision.st_type,
    )
    (count, dof), width = vectors[0].shape, numbers.shape[1]
    note = "z, qd, qdd, tau of each state."
    table = writer.table("test_vectors", note, numbers.ravel().tolist(), ())
    share = literal(precision, 1e-5 if precision is SINGLE else 1e-12)
    names = ("z", "qd", "qdd", "wanted")
    shifts = ["", *(f" + {k * dof}" for k in (1, 2, 3))]
    read = [f"{v}[i] := numbers[first + i{s}];" for v, s in zip(names, shifts, strict=True)]
    inner = [
        f"first := {width} * k;",
        *each(dof, " ".join(read)),
        f"status := {prefix}_inverse_dynamics_at(z := z, qd := qd, qdd := qdd, tau => tau);",
        "scale := 0.0;",
        *each(dof, "IF ABS(wanted[i]) > scale THEN scale := ABS(wanted[i]); END_IF;"),
        "gap := 0.0;",
        *each(dof, "off := ABS(tau[i] - wanted[i]); IF off > gap THEN gap := off; END_IF;"),
        f"IF (status = {writer.status('OK')}) AND (gap <= {share} * scale) THEN",
        "    passed := passed + 1;",
        "ELSE",
        "    failed := failed + 1;",
        "END_IF;",
        "IF gap > largest * scale THEN largest := gap / scale; END_IF;",
    ]
    block = Unit(
        f"{prefix}_test",
        "",
        [f"Compares torques at {count} states with those of Python."],
        (),
        [Variable("passed", "INT"), Variable("failed", "INT"), Variable("largest", real)],
        [
            writer.array("numbers", width * count),
            *(writer.array(name, dof) for name in (*names, "tau")),
            *(Variable(name, real) for name in ("scale", "gap", "off")),
            *(Variable(name, "INT") for name in ("i", "k", "first", "status")),
        ],
        [
            f"i := {prefix}_test_vectors({TABLE} => numbers);",
            "passed := 0;",
            "failed := 0;",
            "largest := 0.0;",
            f"FOR k := 0 TO {count - 1} DO",
            *(f"    {line}" for line in inner),
            "END_FOR;",
        ],
        real,
    )
    types = [array for array in array_types((table, block)) if array.size != dof]  # not PREFIX.st's
    head = comments([f"Checks {prefix}.st, which it needs; call {prefix}_test once."])
    return "\n".join([*head, "", *(part.text() for part in (*types, table, block))])
