"""Units of structured text from the entries of a function table."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.exports.digits import Care, OutputPart
from deltaid.exports.functions import STATUSES, ExportedFunction, Newton
from deltaid.exports.st_helpers import LARGEST_INPUT, LARGEST_RESULT
from deltaid.exports.st_statements import StructuredText, literal, plain
from deltaid.exports.st_units import ArrayType, Unit, Variable, comment
from deltaid.exports.straight_line import Array, body, in_order
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
        whole, n, real = f"{self.prefix}_{name}", len(values), self.precision.st_type
        lines = each(n, f"{TABLE}[i] := 0.0;") if n > np.count_nonzero(values) else []
        own = [Variable("i", "INT")] if lines else []
        for k, value in enumerate(values):
            if value or not own:
                after = f" {comment(notes[k])}" if notes else ""
                lines.append(f"{TABLE}[{k}] := {plain(self.precision, value)};{after}")
        lines.append(self.returns(whole, "OK"))
        return Unit(whole, "INT", (note,), (), [self.array(TABLE, n)], own, lines, real)

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
        name, real, newton = f"{self.prefix}_{f.name}", self.precision.st_type, f.newton
        given, scratch, own = list(f.inputs), set[str](), [Variable("i", "INT")]
        sizes = {argument.name: argument.symbols.numel() for argument in f.arguments}
        rooms = [output.size for output in f.outputs] + [d.value.numel() for d in f.demands]
        if newton:
            sizes["z_start"] = newton.x.numel()
        lines = [self.returns(name, "BAD_INPUT")]
        for argument, size in sizes.items():
            lines += self.sane(argument, size, LARGEST_INPUT)
        for table in f.inputs:
            if table.is_table and (size := table.symbols.numel()):
                own.append(self.array(table.name, size))
                lines.append(f"i := {self.prefix}_parameters({TABLE} => {table.name});")
        if newton:
            n = newton.x.numel()
            rooms.append(2 * n)
            given.insert(0, Array("x", newton.x))
            own += [Variable("k", "INT"), Variable("last", "BOOL"), Variable("gap", real)]
            own.append(self.array("x", n))
            lines += [self.returns(name, "NOT_CLOSED"), *self._newton(newton, given, scratch)]
        for demand in f.demands:
            lines.append(self.returns(name, demand.status))
            lines += self.computed(given, "found", demand.value, scratch)
            bound = literal(self.precision, demand.bound)
            lines += each(demand.value.numel(), f"IF NOT (found[i] > {bound}) THEN RETURN; END_IF;")
        lines.append(self.returns(name, f.unfit))
        values, at = ca.vertcat(*[ca.vec(ca.densify(output.value).T) for output in f.outputs]), 0
        lines += self.computed(given, "found", values, scratch, f.parts)
        lines += self.sane("found", values.numel(), LARGEST_RESULT)
        for output in f.outputs:
            shift = f" + {at}" if at else ""
            lines += each(output.size, f"{output.name}[i] := found[i{shift}];")
            at += output.size
        lines.append(self.returns(name, "OK"))
        own.append(self.array("found", max(*rooms, at)))
        inputs = [self.array(*argument) for argument in sizes.items()]
        outputs = [self.array(output.name, output.size) for output in f.outputs]
        return Unit(name, "INT", notes_of(f), inputs, outputs, own, lines, real, in_order(scratch))

    def computed(
        self,
        inputs: list[Array],
        out: str,
        values: ca.SX,
        scratch: set[str],
        parts: Sequence[OutputPart] = (),
    ) -> list[str]:
        """Statements for some values, whose parts may need more digits than a REAL has."""
        dialect = StructuredText(self.precision, self.prefix)
        found = body(inputs, out, values, dialect, self.care, parts)
        scratch.update(found.slots)
        return found.lines

    def sane(self, name: str, size: int, most: float) -> list[str]:
        """Return where an entry of an array is no number, or too large."""
        sane = f"{self.prefix}_sane({name}[i], {literal(self.precision, most)})"
        return each(size, f"IF NOT {sane} THEN RETURN; END_IF;")

    def _newton(self, newton: Newton, given: list[Array], scratch: set[str]) -> list[str]:
        """z by iteration: gaps and steps, until one more step was the last."""
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
            "last := FALSE;",
            *each(n, "x[i] := z_start[i];"),
            f"FOR k := 0 TO {newton.steps} DO",
            *(f"    {line}" for line in inner),
            "END_FOR;",
            f"IF NOT (gap <= {closed}) THEN RETURN; END_IF;",
        ]

    def _block(self, f: ExportedFunction) -> Unit:
        """A function of q: the pose first, which is kept, then a function of z."""
        n, ok = self.subject.dynamics.dof, self.status("OK")
        names = [argument.name for argument in f.arguments]
        newton = self.subject.dynamics.kinematics.mechanism.forward is None
        start = ", z_start := z" if newton else ""
        passed = ", ".join(f"{v} := {v}_now" for v in names if v != "q" or f.closing)
        lines = [
            "IF NOT started THEN",
            f"    i := {self.prefix}_home({TABLE} => z);",
            "    started := TRUE;",
            "END_IF;",
            *(line for v in names for line in each(n, f"{v}_now[i] := {v}[i];")),
            f"status := {self.prefix}_forward_kinematics(q := q_now{start}, z => pose);",
            f"IF status = {ok} THEN",
            f"    status := {self.prefix}_{f.after}(z := pose, {passed}, tau => torque);",
            "END_IF;",
            f"IF status = {ok} THEN",
            *("    " + line for line in each(n, "z[i] := pose[i]; tau[i] := torque[i];")),
            "END_IF;",
        ]
        own = [self.array(name, n) for name in (*(f"{v}_now" for v in names), "pose", "torque")]
        return Unit(
            f"{self.prefix}_{f.name}",
            "",
            (*notes_of(f), "Keeps z and tau of the last good cycle; z begins at home."),
            [self.array(name, n) for name in names],
            [self.array("tau", n), self.array("z", n), Variable("status", "INT")],
            [*own, Variable("started", "BOOL"), Variable("i", "INT")],
            lines,
            self.precision.st_type,
        )


def notes_of(f: ExportedFunction) -> tuple[str, ...]:
    return (f.doc, *f.entry_notes(", each of {} rows"))


def each(n: int, statement: str) -> list[str]:
    """A statement for every i below n."""
    return [f"FOR i := 0 TO {n - 1} DO", f"    {statement}", "END_FOR;"] if n else []
