"""One cycle as a graph: state and inputs to the next state and outputs, all with named fields.

Named fields stand side by side in one vector: what a cycle reads, keeps and gives. One layout is
one struct in C and in structured text, one array in Python.

Parts, such as the estimate of a load, declare which fields they keep and give; here they become one
function. Of a cycle whose inputs are not finite, or whose loops do not close, nothing is used:
signals are zero there (`signals`), so estimates stay, and filters begin anew behind it.
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
    """Some numbers that belong together.

    Attributes:
        name: an identifier of C and of structured text.
        size: how many numbers, which are `doc`, for a comment.
        unit: of all of them; empty where they differ or have none.
        initial: what a state begins with, one number for all, or one each.
    """

    name: str
    size: int
    doc: str
    unit: str = ""
    initial: float | tuple[float, ...] = 0.0


class Layout:
    """Fields of one vector, in its order; what is of size 0 stands for nothing and is left out.

    Attributes:
        fields: their names differ.
        places: where each stands.
        size: how many numbers the vector has.
        initial: what a state begins with.

    Raises:
        ValueError: two have the same name.
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
        """New symbols for each field, named name_field."""
        return {f.name: ca.SX.sym(f"{name}_{f.name}", f.size) for f in self.fields}

    def vector(self, values: Mapping[str, ca.SX]) -> ca.SX:
        """Expressions of all fields in one column.

        Raises:
            ValueError: an expression has another size than its field.
        """
        parts = [ca.SX(0, 1), *(ca.vec(ca.densify(values[field.name])) for field in self.fields)]
        for field, part in zip(self.fields, parts[1:], strict=True):
            if part.numel() != field.size:
                raise ValueError(f"{field.name} has {field.size} numbers, not {part.numel()}")
        return ca.vertcat(*parts)

    def split(
        self, vector: Float[np.ndarray, "*samples size"]
    ) -> dict[str, Float[np.ndarray, "..."]]:
        """A vector, or many, by fields."""
        return {name: vector[..., place] for name, place in self.places.items()}


# Beyond this a number counts as infinite: its square is still finite in single precision.
_LARGEST = 1e15


@dataclass(frozen=True, eq=False)
class StepGraph:
    """One cycle of what runs while the robot runs.

    Attributes:
        state, inputs, outputs: names and places of the fields of the vectors
        x, u: the state and the inputs, symbols, and
        following, y: the next state and the outputs, expressions of these.
        period: of a cycle [s].
    """

    state: Layout
    inputs: Layout
    outputs: Layout
    x: ca.SX
    u: ca.SX
    following: ca.SX
    y: ca.SX
    period: float

    @cached_property
    def function(self) -> ca.Function:
        """(state, inputs) → (next state, outputs)."""
        names, both = (["state", "inputs"], ["following", "outputs"]), [self.following, self.y]
        return ca.Function("online_step", [self.x, self.u], ca.cse(both), *names)


class CycleFields:
    """What a cycle keeps and gives: its parts declare fields, and say what each becomes.

    Attributes:
        before: what the cycle before kept, symbols by name.
        following: what that becomes, and
        spoilt: what it becomes in a bad cycle, where that is something else.
    """

    def __init__(self) -> None:
        self.before, self.following, self.spoilt = (dict[str, ca.SX]() for _ in range(3))
        self._kept, self._given = list[Field](), list[tuple[Field, ca.SX]]()

    def keep(self, *fields: Field) -> tuple[ca.SX, ...]:
        """Declare fields of the state, behind those before; returns their symbols."""
        symbols = tuple(ca.SX.sym(field.name, field.size) for field in fields)
        self._kept += fields
        self.before |= {field.name: x for field, x in zip(fields, symbols, strict=True)}
        return symbols

    def give(self, name: str, value: ca.SX, doc: str, unit: str = "") -> None:
        """Add an output."""
        self._given.append((Field(name, value.numel(), doc, unit), value))

    def graph(self, inputs: Layout, u: dict[str, ca.SX], good: ca.SX, period: float) -> StepGraph:
        """One graph of all fields.

        Args:
            inputs: what is read.
            u: its symbols.
            good: 1 where the inputs can be used.
        """
        self.give("status", 1 - good, "0 for a good cycle, 1 for one that could not be used")
        state, outputs = Layout(*self._kept), Layout(*(field for field, _ in self._given))
        following = self.following | {
            name: chosen(good, self.following[name], spoilt) for name, spoilt in self.spoilt.items()
        }
        y = outputs.vector({field.name: value for field, value in self._given})
        x, after = state.vector(self.before), state.vector(following)
        return StepGraph(state, inputs, outputs, x, inputs.vector(u), after, y, period)


def all_finite(x: ca.SX) -> ca.SX:
    """1 where no number is NaN, infinite or beyond all bounds."""
    return ca.sum1(ca.fabs(ca.densify(x))) < _LARGEST


def every(*conditions: ca.SX) -> ca.SX:
    """1 where all conditions hold."""
    return reduce(ca.logic_and, conditions)


def only_if(condition: ca.SX, x: ca.SX) -> ca.SX:
    """x, its pattern kept, or zero."""
    return ca.SX(x.sparsity(), ca.if_else(condition, x.nz[:], 0))


def chosen(condition: ca.SX, yes: ca.SX, no: ca.SX) -> ca.SX:
    """Entry by entry; NaN of what is not chosen stays out."""
    pairs = zip(ca.vertsplit(ca.densify(yes)), ca.vertsplit(ca.densify(no)), strict=True)
    return ca.vertcat(*(ca.if_else(condition, a, b) for a, b in pairs))
