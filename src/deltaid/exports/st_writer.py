"""Functions, tables and cycles of a model as units of structured text."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from deltaid.exports import functions
from deltaid.exports.digits import Care, OutputPart
from deltaid.exports.functions import ExportedCycle, ExportedFunction, note_of
from deltaid.exports.st_statements import StructuredText, literal, plain
from deltaid.exports.st_units import Unit, Variable, comment
from deltaid.exports.straight_line import Array, body, in_order
from deltaid.exports.text import COSINE, QUARTER, SINE, Precision, rendered
from deltaid.model.model import Model
from deltaid.online.graph import Field, Layout, StepGraph

# Largest coordinate, rate, acceleration or torque in SI units, far enough below overflow for
# squares and products in either precision; and largest result.
_LARGEST_INPUT, _LARGEST_RESULT = 1e6, 1e30


# Size below which a product's rest underflows a REAL, and above which splitting overflows.
_SMALL, _LARGE = 1e-20, 1e25


# Adding and then subtracting this number rounds to an integer.
_WHOLE = 1.5 / float(np.finfo(np.float32).eps)


STATUSES = {
    **functions.STATUSES,
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
            statuses=STATUSES,
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
        name, graph = f"{self.prefix}_{c.name}", c.graph
        n, inputs, m = graph.state.size, graph.inputs.size, graph.outputs.size
        note = f"The state that {name} begins with."
        yield self.table(f"{c.name}_start", note, graph.state.initial.tolist())
        sizes = {"state": n, "after": n, "bad": n + m, "u": inputs, "y": m}
        yield self._step(name, graph, sizes)
        yield self._keeper(name, c, sizes)

    def _step(self, name: str, graph: StepGraph, sizes: Mapping[str, int]) -> Unit:
        scratch, both = set[str](), ca.vertcat(graph.following, graph.y)
        step = self.computed([Array("x", graph.x), Array("u", graph.u)], both, scratch)
        return Unit(
            f"{name}_step",
            "INT",
            [f"One step of {name}, which calls it."],
            [self.array("x", sizes["state"]), self.array("u", sizes["u"])],
            [self.array("after", sizes["after"]), self.array("y", sizes["y"])],
            [Variable("i", "INT"), self.array("found", sizes["bad"])],
            self.body("step", f"{name}_step", sizes=sizes, lines=step),
            in_order(scratch),
        )

    def _keeper(self, name: str, c: ExportedCycle, sizes: Mapping[str, int]) -> Unit:
        """The function block that keeps the state."""
        graph, scratch = c.graph, set[str]()
        # State and outputs of a cycle with an invalid input follow from the graph itself: with NaN
        # as inputs, everything that depends on them becomes a constant.
        none = ca.SX(ca.DM(np.full(graph.inputs.size, np.nan)))
        after, y = ca.substitute([graph.following, graph.y], [graph.u], [none])
        values = ca.vertsplit(ca.densify(after))
        changed = [i for i, value in enumerate(values) if not ca.is_equal(value, graph.x[i], 1)]
        column = ca.vertcat(y, *(values[i] for i in changed))
        spoilt = self.computed([Array("state", graph.x)], column, scratch, out="bad")
        outputs = [field for field in graph.outputs.fields if field.name != "status"]
        text = self.body(
            "cycle",
            name,
            sizes=sizes,
            lines=spoilt,
            changed=changed,
            inputs=_places(graph.inputs, graph.inputs.fields),
            outputs=_places(graph.outputs, outputs),
        )
        places, arrays = graph.state.places, [self.array(*size) for size in sizes.items()]
        reset = Variable("reset", "BOOL", "forget everything first")
        return Unit(
            name,
            "",
            [
                c.doc,
                "A cycle that is not OK learns nothing; its outputs are what is known without it.",
                *(f"state[{places[f.name].start}]: {f.name}, {f.doc}" for f in graph.state.fields),
            ],
            [*map(self._declared, graph.inputs.fields), reset],
            [*map(self._declared, outputs), Variable("status", "INT")],
            [Variable("started", "BOOL"), *arrays, Variable("i", "INT")],
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
