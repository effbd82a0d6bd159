"""A cycle with a state as a function block of structured text, and the function that it calls."""

import casadi as ca

from deltaid.exports.functions import ExportedCycle
from deltaid.exports.st_helpers import LARGEST_INPUT, LARGEST_RESULT
from deltaid.exports.st_statements import plain
from deltaid.exports.st_units import Unit, Variable
from deltaid.exports.st_writer import Writer, each
from deltaid.exports.straight_line import Array
from deltaid.online.layout import Field, Layout


def start_of(writer: Writer, c: ExportedCycle) -> Variable:
    """The constant that a state begins with."""
    values = tuple(plain(writer.precision, x) for x in c.state.initial)
    name = f"{writer.prefix}_{c.name}_start"
    return Variable(name, writer.precision.st_type, len(values), values)


def cycle_units(writer: Writer, c: ExportedCycle) -> tuple[Unit, Unit]:
    """PREFIX_NAME_step, a function of state and inputs, and PREFIX_NAME, which keeps the state."""
    return _step(writer, c), _block(writer, c)


def _step(writer: Writer, c: ExportedCycle) -> Unit:
    name, n, m = f"{writer.prefix}_{c.name}_step", c.state.size, c.outputs.size
    scratch: dict[str, None] = {}
    given = [Array("x", c.x), Array("u", c.u)]
    both = ca.vertcat(c.following, c.y)
    body = [
        f"{name} := {writer.status('BAD_INPUT')};",
        *writer.sane("u", c.inputs.size, LARGEST_INPUT),
        f"{name} := {writer.status('SINGULAR')};",
        *writer.computed(given, "found", both, scratch),
        *writer.sane("found", n + m, LARGEST_RESULT),
        *each(n, "after[i] := found[i];"),
        *each(m, f"y[i] := found[i + {n}];"),
        f"IF found[{n + m - 1}] > 0.0 THEN RETURN; END_IF;",
        f"{name} := {writer.status('OK')};",
    ]
    return Unit(
        "FUNCTION",
        name,
        "INT",
        (f"One step of {writer.prefix}_{c.name}, which calls it.",),
        (writer.array("x", n), writer.array("u", c.inputs.size)),
        (writer.array("after", n), writer.array("y", m)),
        (Variable("i", "INT"), writer.array("found", n + m)),
        writer.sorted(scratch),
        writer.precision.st_type,
        tuple(body),
    )


def _block(writer: Writer, c: ExportedCycle) -> Unit:
    name, n = f"{writer.prefix}_{c.name}", c.state.size
    given = [field for field in c.outputs.fields if field.name != "status"]
    scratch: dict[str, None] = {}
    start = start_of(writer, c)
    body = [
        f"IF reset THEN {_all(n, f'state[i] := {start.name}[i];')}; END_IF;",
        *(line for field in c.inputs.fields for line in _copied("u", c.inputs, field, True)),
        f"status := {name}_step(x := state, u := u, after => after, y => y);",
        f"IF status = {writer.status('OK')} THEN",
        *(f"    {line}" for line in each(n, "state[i] := after[i];")),
        "ELSE",
        *(f"    {line}" for line in _spoilt(writer, c, scratch)),
        "END_IF;",
        *(line for field in given for line in _copied("y", c.outputs, field, False)),
    ]
    notes = [
        c.doc,
        "A cycle that is not OK learns nothing; its outputs are what is known without it.",
        *(f"state[{c.state.places[f.name].start}]: {f.name}, {f.doc}" for f in c.state.fields),
    ]
    reset = Variable("reset", "BOOL", None, (), ("forget everything first",))
    state = Variable("state", writer.precision.st_type, n, start.values)
    return Unit(
        "FUNCTION_BLOCK",
        name,
        "",
        tuple(notes),
        (*(_declared(writer, field) for field in c.inputs.fields), reset),
        (*(_declared(writer, field) for field in given), Variable("status", "INT")),
        (
            state,
            writer.array("after", n),
            writer.array("bad", n + c.outputs.size),
            writer.array("u", c.inputs.size),
            writer.array("y", c.outputs.size),
            Variable("i", "INT"),
        ),
        writer.sorted(scratch),
        writer.precision.st_type,
        tuple(body),
    )


def _declared(writer: Writer, field: Field) -> Variable:
    note = f"{field.doc} [{field.unit}]" if field.unit else field.doc
    size = field.size if field.size > 1 else None
    return Variable(field.name, writer.precision.st_type, size, (), (note,))


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
    changed = [i for i, value in enumerate(values) if not ca.is_equal(value, c.x[i], 1)]
    column = ca.vertcat(c.spoilt_y, *(values[i] for i in changed))
    m = c.outputs.size
    lines = writer.computed([Array("state", c.x)], "bad", column, scratch)
    lines += each(m, "y[i] := bad[i];")
    return [*lines, *(f"state[{i}] := bad[{m + k}];" for k, i in enumerate(changed))]


def _all(n: int, statement: str) -> str:
    return " ".join(line.strip() for line in each(n, statement)).removesuffix(";")
