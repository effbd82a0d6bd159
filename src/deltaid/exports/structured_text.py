"""IEC 61131-3 structured text of a model: the functions that C has, as one file of units.

Functions return a status and have their results as outputs, which count only where it is OK. What
keeps something from one cycle to the next, the pose z or the state of a cycle, is a function block.
A controller that stops on floating-point exceptions meets none here (`st_statements`): numbers too
large for any robot are refused at the door, and nothing is divided or rooted unseen.
"""

import re
from dataclasses import dataclass, replace

import casadi as ca

from deltaid.errors import DeltaidError
from deltaid.exports.digits import care_for
from deltaid.exports.functions import ExportedCycle, parameter_table
from deltaid.exports.model_functions import further_cycles, further_functions, model_functions
from deltaid.exports.st_helpers import LARGEST_INPUT, LARGEST_RESULT, helpers, pair_functions
from deltaid.exports.st_units import ArrayType, Unit, Variable, array_types, comments, plcopen_xml
from deltaid.exports.st_writer import TABLE, Writer, each
from deltaid.exports.straight_line import Array
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.model.model import Model
from deltaid.online.graph import Field, Layout
from deltaid.online.settings import OnlineSettings


def cycle_units(writer: Writer, c: ExportedCycle) -> tuple[Unit, Unit, Unit]:
    """PREFIX_NAME_start, the first state; PREFIX_NAME_step, a function of state and inputs; and
    PREFIX_NAME, which keeps the state."""
    note = f"The state that {writer.prefix}_{c.name} begins with."
    start = writer.table(f"{c.name}_start", note, c.graph.state.initial.tolist(), ())
    return start, _step(writer, c), _block(writer, c)


def _step(writer: Writer, c: ExportedCycle) -> Unit:
    name, graph = f"{writer.prefix}_{c.name}_step", c.graph
    n, m = graph.state.size, graph.outputs.size
    scratch: dict[str, None] = {}
    given = [Array("x", graph.x), Array("u", graph.u)]
    both = ca.vertcat(graph.following, graph.y)
    body = [
        writer.returns(name, "BAD_INPUT"),
        *writer.sane("u", graph.inputs.size, LARGEST_INPUT),
        writer.returns(name, "SINGULAR"),
        *writer.computed(given, "found", both, scratch),
        *writer.sane("found", n + m, LARGEST_RESULT),
        *each(n, "after[i] := found[i];"),
        *each(m, f"y[i] := found[i + {n}];"),
        f"IF found[{n + m - 1}] > 0.0 THEN RETURN; END_IF;",
        writer.returns(name, "OK"),
    ]
    return Unit(
        "FUNCTION",
        name,
        "INT",
        (f"One step of {writer.prefix}_{c.name}, which calls it.",),
        (writer.array("x", n), writer.array("u", graph.inputs.size)),
        (writer.array("after", n), writer.array("y", m)),
        (Variable("i", "INT"), writer.array("found", n + m)),
        writer.sorted(scratch),
        writer.precision.st_type,
        tuple(body),
    )


def _block(writer: Writer, c: ExportedCycle) -> Unit:
    name, graph, n = f"{writer.prefix}_{c.name}", c.graph, c.graph.state.size
    given = [field for field in graph.outputs.fields if field.name != "status"]
    scratch: dict[str, None] = {}
    body = [
        "IF reset OR NOT started THEN",
        f"    i := {name}_start({TABLE} => state);",
        "    started := TRUE;",
        "END_IF;",
        *(
            line
            for field in graph.inputs.fields
            for line in _copied("u", graph.inputs, field, True)
        ),
        f"status := {name}_step(x := state, u := u, after => after, y => y);",
        f"IF status = {writer.status('OK')} THEN",
        *(f"    {line}" for line in each(n, "state[i] := after[i];")),
        "ELSE",
        *(f"    {line}" for line in _spoilt(writer, c, scratch)),
        "END_IF;",
        *(line for field in given for line in _copied("y", graph.outputs, field, False)),
    ]
    notes = [
        c.doc,
        "A cycle that is not OK learns nothing; its outputs are what is known without it.",
        *(
            f"state[{graph.state.places[f.name].start}]: {f.name}, {f.doc}"
            for f in graph.state.fields
        ),
    ]
    reset = Variable("reset", "BOOL", note="forget everything first")
    return Unit(
        "FUNCTION_BLOCK",
        name,
        "",
        tuple(notes),
        (*(_declared(writer, field) for field in graph.inputs.fields), reset),
        (*(_declared(writer, field) for field in given), Variable("status", "INT")),
        (
            Variable("started", "BOOL"),
            writer.array("state", n),
            writer.array("after", n),
            writer.array("bad", n + graph.outputs.size),
            writer.array("u", graph.inputs.size),
            writer.array("y", graph.outputs.size),
            Variable("i", "INT"),
        ),
        writer.sorted(scratch),
        writer.precision.st_type,
        tuple(body),
    )


def _declared(writer: Writer, field: Field) -> Variable:
    note = f"{field.doc} [{field.unit}]" if field.unit else field.doc
    if field.size == 1:
        return Variable(field.name, writer.precision.st_type, note=note)
    return replace(writer.array(field.name, field.size), note=note)


def _copied(vector: str, layout: Layout, field: Field, into: bool) -> list[str]:
    """A field to its place in a vector, or from there."""
    at = layout.places[field.name].start
    if field.size == 1:
        pair = (f"{vector}[{at}]", field.name)
    else:
        pair = (f"{vector}[i + {at}]" if at else f"{vector}[i]", f"{field.name}[i]")
    target, source = pair if into else pair[::-1]
    return (
        each(field.size, f"{target} := {source};") if field.size > 1 else [f"{target} := {source};"]
    )


def _spoilt(writer: Writer, c: ExportedCycle, scratch: dict[str, None]) -> list[str]:
    """What a bad cycle makes of the state, and gives."""
    values = ca.vertsplit(ca.densify(c.spoilt))
    changed = [i for i, value in enumerate(values) if not ca.is_equal(value, c.graph.x[i], 1)]
    column = ca.vertcat(c.spoilt_y, *(values[i] for i in changed))
    m = c.graph.outputs.size
    lines = writer.computed([Array("state", c.graph.x)], "bad", column, scratch)
    lines += each(m, "y[i] := bad[i];")
    return [*lines, *(f"state[{i}] := bad[{m + k}];" for k, i in enumerate(changed))]


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
        return "\n".join(
            [
                *comments(self.notes),
                "",
                *[array.text() for array in self.arrays],
                *[unit.text() for unit in self.units],
            ]
        )

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
    table = parameter_table(subject, "p", precision)
    functions = [
        *model_functions(subject, table, precision),
        *further_functions(subject, table, further),
    ]
    single = precision is SINGLE
    care = care_for(subject, table.array.name) if single else None
    writer = Writer(subject, prefix, precision, care)
    cycles = further_cycles(subject, further, online)
    notes = [f"{name}, {unit}" for name, unit, _ in table.rows]
    what = "The parameters of the model that are not 0: change a mass here."
    units = [
        *helpers(prefix, precision),
        writer.table("parameters", what, subject.p[subject.p != 0].tolist(), notes),
        writer.table("home", "A pose z in the middle of the workspace.", subject.home.tolist(), ()),
        *(pair_functions(prefix) if single else []),
        *map(writer.unit, functions),
    ]
    units += [unit for cycle in cycles for unit in cycle_units(writer, cycle)]
    conventions = (
        f"IEC 61131-3 structured text, {precision.st_type}. Functions return a status; their "
        "outputs mean something only where that is 0:"
    )
    head = (subject.provenance, conventions, *writer.statuses, *quantities(subject))
    return PlcProgram(prefix, head, tuple(units))


def quantities(subject: Model) -> list[str]:
    """What coordinates of drives and of the task are, with their units."""
    robot = subject.robot
    drives = [
        f"  [{k}] {drive}: "
        + ("m, m/s, m/s^2, N" if robot.is_linear(drive) else "rad, rad/s, rad/s^2, N m")
        for k, drive in enumerate(robot.drives)
    ]
    turn = ", turn psi of the tool [rad]" if subject.dynamics.dof > 3 else ""
    return [
        "Drive coordinates q, rates qd, qdd, torques tau, in the order of the drives:",
        *drives,
        "at the joint, behind the gear; positive as in docs/conventions.md of deltaid.",
        f"Task coordinates z: x, y, z of the platform point in the world [m]{turn}.",
        "Equation of motion: M(q) qdd + C(q, qd) qd + g(q) + f(qd) = tau.",
    ]
