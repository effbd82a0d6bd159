"""Units of structured text from the entries of a function table, and a function block that compares
torques with those of test vectors."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.exports.digits import Care, OutputPart
from deltaid.exports.functions import STATUSES, ExportedFunction
from deltaid.exports.st_helpers import LARGEST_INPUT, LARGEST_RESULT
from deltaid.exports.st_statements import StructuredText, literal, plain
from deltaid.exports.st_units import ArrayType, Unit, Variable, comment
from deltaid.exports.straight_line import Array, body
from deltaid.exports.text import Precision
from deltaid.model.model import Model

_STATUSES = {
    **STATUSES,
    "BAD_INPUT": (5, f"an input is NaN, infinite or above {LARGEST_INPUT:g}"),
}

# The output of functions that give a table.
TABLE = "entries"


@dataclass(frozen=True)
class Writer:
    """Units from entries of the table."""

    subject: Model
    prefix: str
    precision: Precision
    care: Care | None = None

    @property
    def statuses(self) -> list[str]:
        """What functions return."""
        return [
            f"  {code} {name}{f': {text}' if text else ''}"
            for name, (code, text) in _STATUSES.items()
        ]

    def table(self, name: str, note: str, values: Sequence[float], notes: Sequence[str]) -> Unit:
        """A function whose output are numbers, with a note each or none; those not named are 0."""
        whole, n = f"{self.prefix}_{name}", len(values)
        lines = each(n, f"{TABLE}[i] := 0.0;") if n > np.count_nonzero(values) else []
        for k, value in enumerate(values):
            if value or not lines:
                after = f" {comment(notes[k])}" if notes else ""
                lines.append(f"{TABLE}[{k}] := {plain(self.precision, value)};{after}")
        return Unit(
            "FUNCTION",
            whole,
            "INT",
            (note,),
            (),
            (self.array(TABLE, n),),
            (Variable("i", "INT"),) if lines[0].startswith("FOR") else (),
            (),
            self.precision.st_type,
            (*lines, self.returns(whole, "OK")),
        )

    def unit(self, f: ExportedFunction) -> Unit:
        """One function, or a function block where a pose is kept."""
        return self._block(f) if f.after else self._function(f)

    def array(self, name: str, size: int) -> Variable:
        """An array of numbers."""
        array = ArrayType(f"{self.prefix}_array{size}", self.precision.st_type, size)
        return Variable(name, array.name, array=array)

    def status(self, name: str) -> str:
        """The number of a status."""
        return str(_STATUSES[name][0])

    def returns(self, function: str, status: str) -> str:
        """The statement by which a function's result is a status."""
        return f"{function} := {self.status(status)}; {comment(status)}"

    def _function(self, f: ExportedFunction) -> Unit:
        name, real = f"{self.prefix}_{f.name}", self.precision.st_type
        inputs = [self.array(argument.name, argument.symbols.numel()) for argument in f.arguments]
        newton = f.newton
        start = [self.array("z_start", newton.x.numel())] if newton else []
        own = [Variable("i", "INT")]
        lines = [self.returns(name, "BAD_INPUT")]
        for argument in f.arguments:
            lines += self.sane(argument.name, argument.symbols.numel(), LARGEST_INPUT)
        if newton:
            lines += self.sane("z_start", newton.x.numel(), LARGEST_INPUT)
        tables = [table for table in f.inputs if table.is_table and table.symbols.numel()]
        for table in tables:
            own.append(self.array(table.name, table.symbols.numel()))
            lines.append(f"i := {self.prefix}_parameters({TABLE} => {table.name});")
        scratch: dict[str, None] = {}
        given = list(f.inputs)
        room = max([output.size for output in f.outputs] + [d.value.numel() for d in f.demands])
        if f.newton:
            n = f.newton.x.numel()
            room = max(room, 2 * n)
            given = [Array("x", f.newton.x), *given]
            own += [
                Variable("k", "INT"),
                Variable("last", "BOOL"),
                Variable("gap", real),
                self.array("x", n),
            ]
            lines += self._newton(f, name, given, scratch)
        for demand in f.demands:
            n = demand.value.numel()
            lines.append(self.returns(name, demand.status))
            lines += self.computed(given, "found", demand.value, scratch)
            bound = literal(self.precision, demand.bound)
            lines += each(n, f"IF NOT (found[i] > {bound}) THEN RETURN; END_IF;")
        lines.append(self.returns(name, f.unfit))
        values = ca.vertcat(*[ca.vec(ca.densify(output.value).T) for output in f.outputs])
        room = max(room, values.numel())
        lines += self.computed(given, "found", values, scratch, f.parts)
        lines += self.sane("found", values.numel(), LARGEST_RESULT)
        at = 0
        for output in f.outputs:
            shift = f" + {at}" if at else ""
            lines += each(output.size, f"{output.name}[i] := found[i{shift}];")
            at += output.size
        lines.append(self.returns(name, "OK"))
        own.append(self.array("found", room))
        return Unit(
            "FUNCTION",
            name,
            "INT",
            notes_of(f),
            (*inputs, *start),
            tuple(self.array(output.name, output.size) for output in f.outputs),
            tuple(own),
            self.sorted(scratch),
            real,
            tuple(lines),
        )

    def sorted(self, scratch: dict[str, None]) -> tuple[str, ...]:
        """Names of further numbers in the order of their numbers."""
        return tuple(sorted(scratch, key=lambda slot: (slot[0] == "r", int(slot[1:]))))

    def computed(
        self,
        inputs: list[Array],
        out: str,
        values: ca.SX,
        scratch: dict[str, None],
        parts: Sequence[OutputPart] = (),
    ) -> list[str]:
        """Statements for some values, whose parts may need more digits than a REAL has."""
        dialect = StructuredText(self.precision, self.prefix)
        found = body(inputs, out, values, dialect, self.care, parts)
        scratch.update(dict.fromkeys(found.slots))
        return found.lines

    def sane(self, name: str, size: int, most: float) -> list[str]:
        """Return where an entry of an array is no number, or too large."""
        bound = literal(self.precision, most)
        sane = f"{self.prefix}_sane({name}[i], {bound})"
        return each(size, f"IF NOT {sane} THEN RETURN; END_IF;")

    def _newton(
        self, f: ExportedFunction, name: str, given: list[Array], scratch: dict[str, None]
    ) -> list[str]:
        """z by iteration: gaps and steps, until one more step was the last."""
        newton = f.newton
        assert newton is not None
        n = newton.x.numel()
        last, closed = (literal(self.precision, x) for x in (newton.last, newton.closed))
        inner = [
            *self.sane("x", n, LARGEST_INPUT),
            *self.computed(given, "found", newton.both, scratch, newton.parts),
            "gap := 0.0;",
            *each(n, "IF ABS(found[i]) > gap THEN gap := ABS(found[i]); END_IF;"),
            f"IF last OR (k = {newton.steps}) THEN EXIT; END_IF;",
            f"last := gap <= {last};",
            *each(n, f"x[i] := x[i] - found[i + {n}];"),
        ]
        return [
            self.returns(name, "NOT_CLOSED"),
            "last := FALSE;",
            *each(n, "x[i] := z_start[i];"),
            f"FOR k := 0 TO {newton.steps} DO",
            *(f"    {line}" for line in inner),
            "END_FOR;",
            f"IF NOT (gap <= {closed}) THEN RETURN; END_IF;",
        ]

    def _block(self, f: ExportedFunction) -> Unit:
        """A function of q: the pose first, which is kept, then a function of z."""
        name, n = f"{self.prefix}_{f.name}", self.subject.dynamics.dof
        inputs = [self.array(argument.name, argument.symbols.numel()) for argument in f.arguments]
        newton = self.subject.dynamics.kinematics.mechanism.forward is None
        start = ", z_start := z" if newton else ""
        passed = ", ".join(
            f"{v.name} := {v.name}_now" for v in inputs if v.name != "q" or f.closing
        )
        lines = [
            "IF NOT started THEN",
            f"    i := {self.prefix}_home({TABLE} => z);",
            "    started := TRUE;",
            "END_IF;",
            *(line for v in inputs for line in each(n, f"{v.name}_now[i] := {v.name}[i];")),
            f"status := {self.prefix}_forward_kinematics(q := q_now{start}, z => pose);",
            f"IF status = {self.status('OK')} THEN",
            f"    status := {self.prefix}_{f.after}(z := pose, {passed}, tau => torque);",
            "END_IF;",
            f"IF status = {self.status('OK')} THEN",
            *("    " + line for line in each(n, "z[i] := pose[i]; tau[i] := torque[i];")),
            "END_IF;",
        ]
        outputs = (self.array("tau", n), self.array("z", n), Variable("status", "INT"))
        own = (
            *(self.array(f"{v.name}_now", n) for v in inputs),
            *(self.array(name, n) for name in ("pose", "torque")),
            Variable("started", "BOOL"),
            Variable("i", "INT"),
        )
        notes = (*notes_of(f), "Keeps z and tau of the last good cycle; z begins at home.")
        real = self.precision.st_type
        return Unit(
            "FUNCTION_BLOCK", name, "", notes, tuple(inputs), outputs, own, (), real, tuple(lines)
        )


def notes_of(f: ExportedFunction) -> tuple[str, ...]:
    return (f.doc, *f.entry_notes(", each of {} rows"))


def each(n: int, statement: str) -> list[str]:
    """A statement for every i below n."""
    return [f"FOR i := 0 TO {n - 1} DO", f"    {statement}", "END_FOR;"] if n else []
