"""One cycle as a graph from state and inputs to the next state and outputs, with named fields.

Named fields of inputs, state and outputs are stored side by side in one vector each. A layout is a
struct in C and in structured text, and an array in Python.

Parts, such as the estimate of a load, declare their state and output fields; here they become one
function. A cycle with inputs that are not finite, or with loops that do not close, is not used:
signals are zero (`signals`), so estimates stay, and filters begin anew after it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import pairwise

import casadi as ca
import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Field:
    """A named field of numbers.

    Attributes:
        name: an identifier of C and of structured text.
        size: of the field.
        doc: meaning, for a comment.
        unit: of all numbers; empty where they differ or have none.
        initial: value of a state, one for all numbers, or one each.
    """

    name: str
    size: int
    doc: str
    unit: str = ""
    initial: float | tuple[float, ...] = 0.0


class Layout:
    """Fields of one vector, in order; fields of size 0 are dropped.

    Attributes:
        fields: with unique names.
        places: slice of each in the vector.
        size: of the vector.
        initial: values of a state.

    Raises:
        ValueError: two fields have the same name.
    """

    def __init__(self, *fields: Field) -> None:
        self.fields = tuple(field for field in fields if field.size)
        ends = np.cumsum([0, *(field.size for field in self.fields)]).tolist()
        self.places = {
            f.name: slice(*pair) for f, pair in zip(self.fields, pairwise(ends), strict=True)
        }
        self.size: int = ends[-1]
        starts = [np.broadcast_to(np.array(f.initial, dtype=float), f.size) for f in self.fields]
        self.initial: Float[np.ndarray, " size"] = np.concatenate([np.zeros(0), *starts])
        if len(self.places) < len(self.fields):
            raise ValueError(f"two fields of one name in {[field.name for field in self.fields]}")

    def symbols(self, name: str) -> dict[str, ca.SX]:
        """New symbols of each field, called name_field."""
        return {f.name: ca.SX.sym(f"{name}_{f.name}", f.size) for f in self.fields}

    def vector(self, values: Mapping[str, ca.SX]) -> ca.SX:
        """Expressions of all fields as one column.

        Raises:
            ValueError: an expression differs in size from its field.
        """
        parts = [ca.SX(0, 1), *(ca.vec(ca.densify(values[field.name])) for field in self.fields)]
        for field, part in zip(self.fields, parts[1:], strict=True):
            if part.numel() != field.size:
                raise ValueError(f"{field.name} has {field.size} numbers, not {part.numel()}")
        return ca.vertcat(*parts)

    def split(
        self, vector: Float[np.ndarray, "*samples size"]
    ) -> dict[str, Float[np.ndarray, "..."]]:
        """One vector or many, split by field."""
        return {name: vector[..., place] for name, place in self.places.items()}


# Larger numbers count as infinite: their squares overflow in single precision.
_LARGEST = float(np.finfo(np.float32).max) ** 0.5


@dataclass(frozen=True, eq=False)
class StepGraph:
    """One cycle as a graph.

    Attributes:
        state, inputs, outputs: layouts of the vectors.
        x, u: state and inputs, symbols.
        following, y: next state and outputs, expressions of these.
    """

    state: Layout
    inputs: Layout
    outputs: Layout
    x: ca.SX
    u: ca.SX
    following: ca.SX
    y: ca.SX

    @cached_property
    def function(self) -> ca.Function:
        """(state, inputs) → (next state, outputs)."""
        names, both = (["state", "inputs"], ["following", "outputs"]), [self.following, self.y]
        return ca.Function("online_step", [self.x, self.u], ca.cse(both), *names)


class CycleFields:
    """State and output fields of a cycle, declared and set by its parts.

    Attributes:
        before: state of the previous cycle, symbols by name.
        following: next state.
        spoilt: next state after a bad cycle, where it differs.
    """

    def __init__(self) -> None:
        self.before, self.following, self.spoilt = (dict[str, ca.SX]() for _ in range(3))
        self._kept, self._given = list[Field](), list[tuple[Field, ca.SX]]()

    def keep(self, *fields: Field) -> tuple[ca.SX, ...]:
        """Add fields to the state; returns their symbols."""
        symbols = tuple(ca.SX.sym(field.name, field.size) for field in fields)
        self._kept += fields
        self.before |= {field.name: x for field, x in zip(fields, symbols, strict=True)}
        return symbols

    def give(self, *outputs: tuple[str, ca.SX, str] | tuple[str, ca.SX, str, str]) -> None:
        """Add outputs: name, expressions, description and unit of each."""
        self._given += [
            (Field(name, value.numel(), doc, "".join(unit)), value)
            for name, value, doc, *unit in outputs
        ]

    def graph(self, inputs: Layout, u: dict[str, ca.SX], good: ca.SX) -> StepGraph:
        """One graph of all fields.

        Args:
            inputs: layout of the inputs.
            u: symbols of the inputs.
            good: 1 where the inputs can be used.
        """
        self.give(("status", 1 - good, "0 for a good cycle, 1 for one that could not be used"))
        state, outputs = Layout(*self._kept), Layout(*(field for field, _ in self._given))
        following = self.following | {
            name: chosen(good, self.following[name], spoilt) for name, spoilt in self.spoilt.items()
        }
        y = outputs.vector({field.name: value for field, value in self._given})
        x, after = state.vector(self.before), state.vector(following)
        return StepGraph(state, inputs, outputs, x, inputs.vector(u), after, y)


def all_finite(x: ca.SX) -> ca.SX:
    """1 where no number is NaN, infinite or too large."""
    return ca.sum1(ca.fabs(ca.densify(x))) < _LARGEST


def every(*conditions: ca.SX) -> ca.SX:
    """1 where all conditions hold."""
    return reduce(ca.logic_and, conditions)


def only_if(condition: ca.SX, x: ca.SX) -> ca.SX:
    """x, or zero with its sparsity."""
    return ca.SX(x.sparsity(), ca.if_else(condition, x.nz[:], 0))


def chosen(condition: ca.SX, yes: ca.SX, no: ca.SX) -> ca.SX:
    """Select one of two columns, without NaN of the other one."""
    pairs = zip(ca.vertsplit(ca.densify(yes)), ca.vertsplit(ca.densify(no)), strict=True)
    return ca.vertcat(*(ca.if_else(condition, a, b) for a, b in pairs))
