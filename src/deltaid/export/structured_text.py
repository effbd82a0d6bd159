"""IEC 61131-3 structured text of a model: the functions that C has, as one file of units.

Functions return a status and have their results as outputs, which are zero unless it is OK. What
keeps something from one cycle to the next, the pose z, is a function block. A controller that
stops on floating-point exceptions meets none here (`st_statements`): numbers too large for any
robot are refused at the door, and nothing is divided or rooted unseen.
"""

import re
from dataclasses import dataclass

import casadi as ca

from deltaid.errors import DeltaidError
from deltaid.export.functions import STATUSES, ExportedFunction
from deltaid.export.further_functions import further_functions
from deltaid.export.model_functions import model_functions
from deltaid.export.parameter_table import parameter_table
from deltaid.export.precision import DOUBLE, Precision
from deltaid.export.st_helpers import LARGEST_INPUT, LARGEST_RESULT, helpers
from deltaid.export.st_statements import StructuredText, literal, plain
from deltaid.export.st_units import Unit, Variable, comments, constants
from deltaid.export.straight_line import Array, body
from deltaid.model.model import Model

_STATUSES = {"BAD_INPUT": (5, f"an input is NaN, infinite or above {LARGEST_INPUT:g}")}


def structured_text(
    subject: Model, prefix: str, precision: Precision = DOUBLE, further: tuple[str, ...] = ()
) -> str:
    """The units of a model; their names are PREFIX_….

    Args:
        further: names of functions beside those that every export has (`options.FURTHER`).

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
    table = parameter_table(subject, f"{prefix}_p", precision)
    functions = [
        *model_functions(subject, table, precision),
        *further_functions(subject, table, further),
    ]
    writer = _Writer(subject, prefix, precision)
    units = [*helpers(prefix, precision), *map(writer.unit, functions)]
    notes = [subject.provenance, *_conventions(subject, precision)]
    head = "\n".join(comments(notes))
    values = tuple(plain(precision, x) for x in subject.p if x)
    parameters = Variable(
        f"{prefix}_p",
        precision.st_type,
        len(values),
        values,
        tuple(f"{name}, {unit}" for name, unit, _ in table.rows),
    )
    listed = constants([*writer.statuses(), writer.home(f"{prefix}_home"), parameters])
    return "\n".join([head, "", listed, *(unit.text() for unit in units)])


def _conventions(subject: Model, precision: Precision) -> list[str]:
    robot = subject.robot
    drives = [
        f"  [{k}] {drive}: "
        + ("m, m/s, m/s^2, N" if robot.is_linear(drive) else "rad, rad/s, rad/s^2, N m")
        for k, drive in enumerate(robot.drives)
    ]
    turn = ", turn psi of the tool [rad]" if subject.dynamics.dof > 3 else ""
    return [
        f"IEC 61131-3 structured text, {precision.st_type}. Functions return a status of the list "
        "below; outputs of a function are zero unless it is OK.",
        "Drive coordinates q, rates qd, qdd, torques tau, in the order of the drives:",
        *drives,
        "at the joint, behind the gear; positive as in docs/conventions.md of deltaid.",
        f"Task coordinates z: x, y, z of the platform point in the world [m]{turn}.",
        "Equation of motion: M(q) qdd + C(q, qd) qd + g(q) + f(qd) = tau.",
    ]


@dataclass(frozen=True)
class _Writer:
    """Units from entries of the table."""

    subject: Model
    prefix: str
    precision: Precision

    def statuses(self) -> list[Variable]:
        """Constants for what functions return."""
        return [
            Variable(f"{self.prefix}_{name}", "INT", None, (str(code),), (text,) if text else ())
            for name, (code, text) in {**STATUSES, **_STATUSES}.items()
        ]

    def home(self, name: str) -> Variable:
        """A pose in the middle of the workspace."""
        values = tuple(plain(self.precision, x) for x in self.subject.home)
        return Variable(name, self.precision.st_type, len(values), values)

    def unit(self, f: ExportedFunction) -> Unit:
        """One function, or a function block where a pose is kept."""
        return self._block(f) if f.after else self._function(f)

    def _array(self, name: str, size: int) -> Variable:
        return Variable(name, self.precision.st_type, size)

    def _status(self, name: str) -> str:
        return f"{self.prefix}_{name}"

    def _function(self, f: ExportedFunction) -> Unit:
        name, real = f"{self.prefix}_{f.name}", self.precision.st_type
        inputs = [self._array(a.name, a.symbols.numel()) for a in f.arguments]
        start = [self._array("z_start", f.newton.x.numel())] if f.newton else []
        own = [Variable("i", "INT")]
        lines = [f"{name} := {self._status('BAD_INPUT')};"]
        for variable in [*inputs, *start]:
            lines += self._sane(variable.name, variable.size or 1, LARGEST_INPUT)
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
                self._array("x", n),
            ]
            lines += self._newton(f, name, given, scratch)
        for demand in f.demands:
            n = demand.value.numel()
            lines.append(f"{name} := {self._status(demand.status)};")
            lines += self._computed(given, "found", demand.value, scratch)
            bound = literal(self.precision, demand.bound)
            lines += _each(n, f"IF NOT (found[i] > {bound}) THEN RETURN; END_IF;")
        lines.append(f"{name} := {self._status(f.unfit)};")
        values = ca.vertcat(*[ca.vec(ca.densify(output.value).T) for output in f.outputs])
        room = max(room, values.numel())
        lines += self._computed(given, "found", values, scratch)
        lines += self._sane("found", values.numel(), LARGEST_RESULT)
        at = 0
        for output in f.outputs:
            shift = f" + {at}" if at else ""
            lines += _each(output.size, f"{output.name}[i] := found[i{shift}];")
            at += output.size
        lines.append(f"{name} := {self._status('OK')};")
        own.append(self._array("found", room))
        return Unit(
            "FUNCTION",
            name,
            "INT",
            _notes(f),
            (*inputs, *start),
            tuple(self._array(output.name, output.size) for output in f.outputs),
            tuple(own),
            tuple(sorted(scratch, key=lambda slot: int(slot[1:]))),
            real,
            tuple(lines),
        )

    def _computed(
        self, inputs: list[Array], out: str, values: ca.SX, scratch: dict[str, None]
    ) -> list[str]:
        """Statements for some values."""
        dialect = StructuredText(self.precision, f"{self.prefix}_atan2")
        found = body(inputs, out, values, dialect)
        scratch.update(dict.fromkeys(found.slots))
        return found.lines

    def _sane(self, name: str, size: int, most: float) -> list[str]:
        bound = literal(self.precision, most)
        sane = f"{self.prefix}_sane({name}[i], {bound})"
        return _each(size, f"IF NOT {sane} THEN RETURN; END_IF;")

    def _newton(
        self, f: ExportedFunction, name: str, given: list[Array], scratch: dict[str, None]
    ) -> list[str]:
        """z by iteration: gaps and steps, until one more step was the last."""
        newton = f.newton
        assert newton is not None
        n = newton.x.numel()
        last, closed = (literal(self.precision, x) for x in (newton.last, newton.closed))
        inner = [
            *self._sane("x", n, LARGEST_INPUT),
            *self._computed(given, "found", ca.vertcat(newton.gap, newton.step), scratch),
            "gap := 0.0;",
            *_each(n, "IF ABS(found[i]) > gap THEN gap := ABS(found[i]); END_IF;"),
            f"IF last OR (k = {newton.steps}) THEN EXIT; END_IF;",
            f"last := gap <= {last};",
            *_each(n, f"x[i] := x[i] - found[i + {n}];"),
        ]
        return [
            f"{name} := {self._status('NOT_CLOSED')};",
            "last := FALSE;",
            *_each(n, "x[i] := z_start[i];"),
            f"FOR k := 0 TO {newton.steps} DO",
            *(f"    {line}" for line in inner),
            "END_FOR;",
            f"IF NOT (gap <= {closed}) THEN RETURN; END_IF;",
        ]

    def _block(self, f: ExportedFunction) -> Unit:
        """A function of q: the pose first, which is kept, then a function of z."""
        name, n = f"{self.prefix}_{f.name}", self.subject.dynamics.dof
        inputs = [self._array(a.name, a.symbols.numel()) for a in f.arguments]
        newton = self.subject.dynamics.kinematics.mechanism.forward is None
        start = ", z_start := z" if newton else ""
        passed = ", ".join(f"{v.name} := {v.name}" for v in inputs if v.name != "q")
        lines = [
            f"status := {self.prefix}_forward_kinematics(q := q{start}, z => pose);",
            f"IF status = {self._status('OK')} THEN",
            f"    status := {self.prefix}_{f.after}(z := pose, {passed}, tau => torque);",
            "END_IF;",
            f"IF status = {self._status('OK')} THEN",
            *("    " + line for line in _each(n, "z[i] := pose[i]; tau[i] := torque[i];")),
            "END_IF;",
        ]
        outputs = (self._array("tau", n), self.home("z"), Variable("status", "INT"))
        own = (self._array("pose", n), self._array("torque", n), Variable("i", "INT"))
        notes = (*_notes(f), "Keeps z and tau of the last good cycle; z begins at home.")
        real = self.precision.st_type
        return Unit(
            "FUNCTION_BLOCK", name, "", notes, tuple(inputs), outputs, own, (), real, tuple(lines)
        )


def _notes(f: ExportedFunction) -> tuple[str, ...]:
    notes = [f.doc]
    for output in f.outputs:
        rows = output.size // len(output.entries) if output.entries else 1
        if output.entries:
            notes.append(f"{output.name}{f', each of {rows} rows' if rows > 1 else ''}:")
        notes += [f"  [{k}] {name}, {unit}" for k, (name, unit) in enumerate(output.entries)]
    return tuple(notes)


def _each(n: int, statement: str) -> list[str]:
    """A statement for every i below n."""
    return [f"FOR i := 0 TO {n - 1} DO", f"    {statement}", "END_FOR;"] if n else []
