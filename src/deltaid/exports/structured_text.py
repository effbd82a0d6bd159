"""IEC 61131-3 structured text of a model: the functions of the C export, as one file.

Functions return a status and have their results as outputs, which are valid only if it is OK.
Functions that keep the pose z or a state between cycles are function blocks. No floating-point
exception occurs, because some controllers would stop (`st_units`): inputs that are too large for
any robot are refused, and divisors and radicands are checked.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.exports.digits import Care, OutputPart
from deltaid.exports.functions import STATUSES, ExportedCycle, ExportedFunction, note_of
from deltaid.exports.model_functions import DEFAULT, code_parts
from deltaid.exports.st_units import (
    PlcProgram,
    StructuredText,
    Unit,
    Variable,
    comment,
    literal,
    plain,
)
from deltaid.exports.straight_line import Array, body, in_order
from deltaid.exports.text import COSINE, DOUBLE, QUARTER, SINE, SINGLE, Precision, rendered
from deltaid.model.model import Model
from deltaid.online.graph import Field, Layout
from deltaid.online.settings import OnlineSettings

# Largest coordinate, rate, acceleration or torque in SI units, far enough below overflow for
# squares and products in either precision; and largest result.
_LARGEST_INPUT, _LARGEST_RESULT = 1e6, 1e30
# Size below which a product's rest underflows a REAL, and above which splitting overflows.
_SMALL, _LARGE = 1e-20, 1e25
# Adding and then subtracting this number rounds to an integer.
_WHOLE = 1.5 / float(np.finfo(np.float32).eps)
_STATUSES = {
    **STATUSES,
    "BAD_INPUT": (5, f"an input is NaN, infinite or above {_LARGEST_INPUT:g}"),
}
# Functions for numbers that are the sum of two, as in templates/pairs.c.jinja, with one operation
# per statement, so that each is rounded to a REAL: their purpose, and their variables.
_PAIRS = {
    "missing": ("a b - p without rounding, p being near a b.", "a b p", "", "ah al bh bl e t"),
    "sum": ("a + b.", "a da b db", "dc", "s v e t c"),
    "product": ("a b.", "a da b db", "dc", "s v e t c"),
    "quotient": ("a / b; b is not zero.", "a da b db", "dc", "s e t c"),
    "root": ("The root of a, which is not negative.", "a da", "dc", "s e t c"),
    "sine": ("Sine of the angle a, with b = 1 its cosine.", "a da b", "dc", "n t x dx y dy z dz"),
}


@dataclass(frozen=True)
class Writer:
    """Maker of a model's units, whose statements are those of templates/bodies.st.jinja."""

    subject: Model
    prefix: str
    precision: Precision
    care: Care | None = None

    def body(self, part: str, name: str, **values: Any) -> str:
        """The statements of one part of the template, for a unit."""
        return rendered(
            "bodies.st.jinja",
            part=part,
            name=name,
            prefix=self.prefix,
            dof=self.subject.dynamics.dof,
            statuses=_STATUSES,
            number=partial(literal, self.precision),
            largest_input=_LARGEST_INPUT,
            largest_result=_LARGEST_RESULT,
            **values,
        ).rstrip("\n")

    def array(self, name: str, size: int) -> Variable:
        """An array of numbers."""
        return Variable(name, f"{self.prefix}_array{size}", size=size)

    def reals(self, names: str) -> list[Variable]:
        """Variables for numbers of these names."""
        return [Variable(name, self.precision.st_type) for name in names.split()]

    def helpers(self) -> Iterator[Unit]:
        """PREFIX_sane(x, most) and PREFIX_atan2(y, x)."""
        sane, atan2 = f"{self.prefix}_sane", f"{self.prefix}_atan2"
        note = "Whether x is a number of at most that size: not NaN, not infinite."
        yield Unit(sane, "BOOL", [note], self.reals("x most"), (), (), self.body("sane", sane))
        note, real = "Angle of the point x, y; the first edition of the standard has none.", "a"
        text = self.body("atan2", atan2, pi=np.pi)
        yield Unit(
            atan2, self.precision.st_type, [note], self.reals("y x"), (), self.reals(real), text
        )

    def pairs(self) -> Iterator[Unit]:
        """PREFIX_pair_sum and similar functions; the result is c + dc, dc a second output."""
        numbers = {"pi": np.pi, "small": _SMALL, "large": _LARGE, "whole": _WHOLE}
        for part, (note, *names) in _PAIRS.items():
            name, (a, b, c) = f"{self.prefix}_pair_{part}", map(self.reals, names)
            text = self.body(part, name, **numbers, quarter=QUARTER, sine=SINE, cosine=COSINE)
            yield Unit(name, self.precision.st_type, [note], a, b, c, text)

    def table(self, name: str, note: str, values: list[float], notes: Sequence[str] = ()) -> Unit:
        """A function that returns constants, with an optional note for each; others are 0."""
        name, zeros = f"{self.prefix}_{name}", len(values) > np.count_nonzero(values)
        writes = {"plain": partial(plain, self.precision), "comment": comment}
        text = self.body("table", name, values=values, notes=notes, zeros=zeros, **writes)
        own = [Variable("i", "INT")] if zeros else []
        return Unit(name, "INT", [note], (), [self.array("entries", len(values))], own, text)

    def function(self, f: ExportedFunction) -> Unit:
        """A function without memory."""
        given, scratch, own = list(f.inputs), set[str](), [Variable("i", "INT")]
        sizes = {argument.name: argument.symbols.numel() for argument in f.arguments}
        tables = {x.name: x.symbols.numel() for x in f.inputs if x.is_table and x.symbols.numel()}
        own += [self.array(*table) for table in tables.items()]
        values = ca.vertcat(*[ca.vec(ca.densify(output.value).T) for output in f.outputs])
        rooms, step = [values.numel(), *(demand.value.numel() for demand in f.demands)], list[str]()
        if newton := f.newton:
            n = sizes["z_start"] = newton.x.numel()
            rooms.append(2 * n)
            given.insert(0, Array("x", newton.x))
            own += [Variable("k", "INT"), Variable("last", "BOOL"), *self.reals("gap")]
            own.append(self.array("x", n))
            step = self.computed(given, newton.both, scratch, newton.parts)
        demands = [
            (x.status, x.bound, x.value.numel(), self.computed(given, x.value, scratch))
            for x in f.demands
        ]
        name = f"{self.prefix}_{f.name}"
        text = self.body(
            "function",
            name,
            sizes=sizes,
            tables=tables,
            newton=newton,
            step=step,
            demands=demands,
            unfit=f.unfit,
            lines=self.computed(given, values, scratch, f.parts),
            size=values.numel(),
            outputs=f.places,
        )
        return Unit(
            name,
            "INT",
            notes_of(f),
            [self.array(*argument) for argument in sizes.items()],
            [self.array(output.name, output.size) for output in f.outputs],
            [*own, self.array("found", max(rooms))],
            text,
            in_order(scratch),
        )

    def computed(
        self,
        inputs: list[Array],
        values: ca.SX,
        scratch: set[str],
        parts: Sequence[OutputPart] = (),
        out: str = "found",
    ) -> list[str]:
        """Statements that compute values, parts of which may need more digits than a REAL has."""
        dialect = StructuredText(self.precision, self.prefix)
        lines, slots, _ = body(inputs, out, values, dialect, self.care, parts)
        scratch.update(slots)
        return lines

    def block(self, f: ExportedFunction) -> Unit:
        """A function block of q: it computes the pose and keeps it, then calls a function of z."""
        name, n = f"{self.prefix}_{f.name}", self.subject.dynamics.dof
        names = [argument.name for argument in f.arguments]
        text = self.body(
            "pose",
            name,
            names=names,
            newton=self.subject.dynamics.kinematics.mechanism.forward is None,
            after=f.after,
            passed=[f"{v} := {v}_now" for v in names if v != "q" or f.closing],
        )
        own = [self.array(name, n) for name in (*(f"{v}_now" for v in names), "pose", "torque")]
        return Unit(
            name,
            "",
            (*notes_of(f), "Keeps z and tau of the last good cycle; z begins at home."),
            [self.array(name, n) for name in names],
            [self.array("tau", n), self.array("z", n), Variable("status", "INT")],
            [*own, Variable("started", "BOOL"), Variable("i", "INT")],
            text,
        )

    def cycle(self, c: ExportedCycle) -> Iterator[Unit]:
        """PREFIX_NAME_start, the initial state; PREFIX_NAME_step, a function of state and inputs;
        and PREFIX_NAME, which keeps the state."""
        name, graph, scratch = f"{self.prefix}_{c.name}", c.graph, set[str]()
        n, inputs, m = graph.state.size, graph.inputs.size, graph.outputs.size
        note = f"The state that {name} begins with."
        yield self.table(f"{c.name}_start", note, graph.state.initial.tolist())
        sizes = {"state": n, "after": n, "bad": n + m, "u": inputs, "y": m}
        arrays = {key: self.array(key, size) for key, size in sizes.items()}
        given, both = (
            [Array("x", graph.x), Array("u", graph.u)],
            ca.vertcat(graph.following, graph.y),
        )
        step = self.computed(given, both, scratch)
        yield Unit(
            f"{name}_step",
            "INT",
            [f"One step of {name}, which calls it."],
            [self.array("x", n), arrays["u"]],
            [arrays["after"], arrays["y"]],
            [Variable("i", "INT"), self.array("found", n + m)],
            self.body("step", f"{name}_step", sizes=sizes, lines=step),
            in_order(scratch),
        )
        # State and outputs of a cycle with an invalid input.
        values, scratch = ca.vertsplit(ca.densify(c.spoilt)), set[str]()
        changed = [i for i, value in enumerate(values) if not ca.is_equal(value, graph.x[i], 1)]
        column = ca.vertcat(c.spoilt_y, *(values[i] for i in changed))
        spoilt = self.computed([Array("state", graph.x)], column, scratch, out="bad")
        shown = [field for field in graph.outputs.fields if field.name != "status"]
        text = self.body(
            "cycle",
            name,
            sizes=sizes,
            lines=spoilt,
            changed=changed,
            inputs=_places(graph.inputs, graph.inputs.fields),
            outputs=_places(graph.outputs, shown),
        )
        places = graph.state.places
        yield Unit(
            name,
            "",
            [
                c.doc,
                "A cycle that is not OK learns nothing; its outputs are what is known without it.",
                *(f"state[{places[f.name].start}]: {f.name}, {f.doc}" for f in graph.state.fields),
            ],
            [
                *map(self._declared, graph.inputs.fields),
                Variable("reset", "BOOL", "forget everything first"),
            ],
            [*map(self._declared, shown), Variable("status", "INT")],
            [Variable("started", "BOOL"), *arrays.values(), Variable("i", "INT")],
            text,
            in_order(scratch),
        )

    def _declared(self, field: Field) -> Variable:
        (number,) = self.reals(field.name)
        declared = number if field.size == 1 else self.array(field.name, field.size)
        return replace(declared, note=note_of(field))


def _places(layout: Layout, fields: Iterable[Field]) -> list[tuple[str, int, int]]:
    return [(field.name, layout.places[field.name].start, field.size) for field in fields]


def notes_of(f: ExportedFunction) -> tuple[str, ...]:
    return (f.doc, *f.entry_notes(", each of {} rows"))


def plc_program(
    subject: Model,
    prefix: str,
    precision: Precision = DOUBLE,
    further: tuple[str, ...] = (),
    online: OnlineSettings = DEFAULT,
) -> PlcProgram:
    """The units of a model; their names begin with PREFIX_.

    Args:
        further: names of additional functions (`options.FURTHER`).
        online: settings of the function of that name.

    Raises:
        DeltaidError: the prefix is no identifier, or the robot lacks what an additional function
            needs.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", prefix) or len(prefix) > 20:
        raise DeltaidError(
            f"'{prefix[:60]}' cannot begin the names of functions of structured text",
            where="name of the output",
            cure="use at most 20 letters, digits and single _ between them, a letter first",
        )
    table, functions, cycles, care = code_parts(subject, "p", precision, further, online)
    writer, real = Writer(subject, prefix, precision, care), precision.st_type
    what = "The parameters of the model that are not 0: change a mass here."
    notes = [f"{name}, {unit}" for name, unit, _ in table.rows]
    units = [
        *writer.helpers(),
        writer.table("parameters", what, subject.p[subject.p != 0].tolist(), notes),
        writer.table("home", "A pose z in the middle of the workspace.", subject.home.tolist()),
        *(writer.pairs() if precision is SINGLE else ()),
        *(writer.block(f) if f.after else writer.function(f) for f in functions),
        *(unit for cycle in cycles for unit in writer.cycle(cycle)),
    ]
    conventions = (
        f"IEC 61131-3 structured text, {real}. Functions return a status; their outputs mean "
        "something only where that is 0:"
    )
    codes = (
        f"  {code} {name}{f': {text}' if text else ''}" for name, (code, text) in _STATUSES.items()
    )
    head = (subject.provenance, conventions, *codes, *quantities(subject))
    return PlcProgram(prefix, head, units, real)


def quantities(subject: Model) -> list[str]:
    """Coordinates of drives and task in words, with their units."""
    units = subject.robot.drive_units
    turn = ", turn psi of the tool [rad]" if subject.dynamics.dof > 3 else ""
    return [
        "Drive coordinates q, rates qd, qdd, torques tau, in the order of the drives:",
        *(
            f"  [{k}] {drive}: {u.coordinate}, {u.coordinate}/s, {u.coordinate}/s^2, {u.force}"
            for k, (drive, u) in enumerate(units.items())
        ),
        "at the joint, behind the gear; positive as in docs/conventions.md of deltaid.",
        f"Task coordinates z: x, y, z of the platform point in the world [m]{turn}.",
        "Equation of motion: M(q) qdd + C(q, qd) qd + g(q) + f(qd) = tau.",
    ]


def st_test(
    subject: Model,
    prefix: str,
    precision: Precision,
    states: Mapping[str, Float[np.ndarray, "states dof"]],
) -> str:
    """PREFIX_test, which calls PREFIX_inverse_dynamics_at once for each vector.

    It compares its torques with those of Python.

    Args:
        states: z, qd, qdd and tau, one state per row.
    """
    writer, names = Writer(subject, prefix, precision), ("z", "qd", "qdd", "tau")
    numbers, note = np.hstack([states[x] for x in names]), f"{', '.join(names)} of each state."
    (count, dof), share = states["z"].shape, 1e-5 if precision is SINGLE else 1e-12
    name = f"{prefix}_test"
    block = Unit(
        name,
        "",
        [f"Compares torques at {count} states with those of Python."],
        (),
        [Variable("passed", "INT"), Variable("failed", "INT"), *writer.reals("largest")],
        [
            writer.array("numbers", numbers.size),
            *(writer.array(array, dof) for array in ("z", "qd", "qdd", "wanted", "tau")),
            *writer.reals("scale gap off"),
            *(Variable(number, "INT") for number in ("i", "k", "first", "status")),
        ],
        writer.body("test", name, count=count, share=share),
    )
    head = [f"Checks {prefix}.st, which it needs; call {prefix}_test once."]
    units = [writer.table("test_vectors", note, numbers.ravel().tolist()), block]
    # Array types that PREFIX.st declares.
    return PlcProgram(prefix, head, units, precision.st_type, declared=(dof,)).text
