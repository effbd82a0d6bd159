"""Exported functions, independent of the language.

C and structured text are generated from a list of these (`model_functions.code_parts`). Every
function returns a status, and leaves its outputs unchanged unless that is OK. The parameters of a
model are a table of named numbers, which the graphs read.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.exports.digits import OutputPart
from deltaid.exports.straight_line import Array
from deltaid.exports.text import DOUBLE, Precision, c_comment
from deltaid.model.model import Model
from deltaid.online.graph import Field, StepGraph

# Status codes by name: number and meaning.
STATUSES: Mapping[str, tuple[int, str]] = {
    "OK": (0, ""),
    "NOT_CLOSED": (1, "no pose closes the loops, or it is too far from the start"),
    "OTHER_MODE": (2, "a limb is in its other working mode, or beyond a singularity"),
    "OUT_OF_REACH": (3, "a limb cannot reach the pose"),
    "SINGULAR": (4, "z is singular or out of reach, so a result is no finite number"),
    "BAD_INPUT": (5, "an input is NaN or infinite"),
}


@dataclass(frozen=True)
class Output:
    """An output of a function.

    Attributes:
        name: of the argument.
        value: its expression; a matrix is written row by row.
        entries: name and unit of each entry, if they need an explanation.
    """

    name: str
    value: ca.SX
    entries: tuple[tuple[str, str], ...] = ()

    @property
    def size(self) -> int:
        """Number of the output's entries."""
        return self.value.numel()


@dataclass(frozen=True)
class Demand:
    """Numbers that must exceed a bound for the outputs to be valid.

    Attributes:
        value: the numbers.
        bound: that they must exceed.
        status: returned if one does not, or is NaN.
    """

    value: ca.SX
    bound: float
    status: str


@dataclass(frozen=True)
class Newton:
    """Newton's method for the output: x ← x − step(x, inputs), from its previous value.

    Attributes:
        x: symbols of the output.
        gap: residual that must vanish [m, rad].
        step: Φ_x⁻¹ Φ.
        steps: largest number of steps.
        last: gap from which one more step is the last.
        closed: gap below which the solution is accepted.
    """

    x: ca.SX
    gap: ca.SX
    step: ca.SX
    steps: int
    last: float
    closed: float

    @property
    def both(self) -> ca.SX:
        """Gaps, then steps, in one column."""
        return ca.vertcat(self.gap, self.step)

    @property
    def parts(self) -> list[OutputPart]:
        """Gaps and steps as output parts: the error of a step is scaled by the output."""
        return [OutputPart(self.gap.numel(), None), OutputPart(self.x.numel(), "x")]


@dataclass(frozen=True)
class ExportedFunction:
    """One function of an export.

    Attributes:
        name: without the prefix.
        doc: what it computes, for the header; lines below 90 characters.
        inputs: with their symbols; the table of parameters is global and no argument.
        outputs: functions of the inputs; with `newton`, of x and the inputs.
        demands: checked in this order.
        newton: computes the only output, if no formula does.
        unfit: status if an output is not finite.
        after: name of a function of z that is called with the pose of q; the outputs are then those
            of that function, and none are listed here.
        closing: whether that function takes q in addition to z.
    """

    name: str
    doc: str
    inputs: tuple[Array, ...]
    outputs: tuple[Output, ...]
    demands: tuple[Demand, ...] = ()
    newton: Newton | None = None
    unfit: str = "SINGULAR"
    after: str = ""
    closing: bool = False

    @property
    def arguments(self) -> tuple[Array, ...]:
        """Inputs that are arguments, without tables."""
        return tuple(array for array in self.inputs if not array.is_table)

    @property
    def places(self) -> list[tuple[str, int, int]]:
        """Name, first index and number of entries of each output."""
        ends = np.cumsum([output.size for output in self.outputs]).tolist()
        return [(x.name, end - x.size, x.size) for x, end in zip(self.outputs, ends, strict=True)]

    @property
    def parts(self) -> list[OutputPart]:
        """The outputs as parts of `everything`."""
        return [OutputPart(output.size) for output in self.outputs]

    def entry_notes(self, rows: str) -> Iterator[str]:
        """Meaning of each entry of the outputs, if it needs an explanation; `rows` is a text about
        the number {} of rows that the entries describe."""
        for output in self.outputs:
            if output.entries:
                count = output.size // len(output.entries)
                yield f"{output.name}{rows.format(count) if count > 1 else ''}:"
            yield from (f"  [{k}] {name}, {unit}" for k, (name, unit) in enumerate(output.entries))

    @property
    def everything(self) -> ca.SX:
        """All outputs, each row by row, then the demands, in one column."""
        outputs = [ca.vec(ca.densify(output.value).T) for output in self.outputs]
        return ca.vertcat(*outputs, *[demand.value for demand in self.demands])


@dataclass(frozen=True, eq=False)
class ExportedCycle:
    """A function that is called once per cycle, with a state of named fields.

    Attributes:
        name: without the prefix.
        doc: its purpose, for the header.
        graph: state, inputs and outputs, each a struct; the last output is 0 if the cycle was good.
    """

    name: str
    doc: str
    graph: StepGraph


@dataclass(frozen=True)
class ParameterTable:
    """Nonzero parameters: names, units and values, and p with symbols for them."""

    rows: list[tuple[str, str, str]]
    array: Array
    p: ca.SX


def parameter_table(subject: Model, name: str, precision: Precision = DOUBLE) -> ParameterTable:
    """The nonzero parameters of a model as a C table."""
    layout, kept = subject.dynamics.layout, np.flatnonzero(subject.p)
    symbols, p = ca.SX.sym("p", len(kept)), ca.SX.zeros(subject.p.size)
    p[kept.tolist()] = symbols
    rows = [
        (c_comment(layout.names[i]), layout.units[i], precision.c_number(subject.p[i]))
        for i in kept
    ]
    return ParameterTable(rows, Array(name, symbols, is_table=True), p)


def note_of(field: Field) -> str:
    """Meaning of a cycle's field, with its unit."""
    return f"{field.doc} [{field.unit}]" if field.unit else field.doc
