"""One cycle as a graph: state and inputs to the next state and outputs, all with named fields.

Parts, such as the estimate of a load, say which fields they keep and give; here they become one
function. Of a cycle whose inputs are not finite, or whose loops do not close, nothing is used:
signals are zero there (`signals`), so estimates stay, and filters begin anew behind it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from deltaid.online.layout import Field, Layout

# Beyond this a number counts as infinite: its square is still finite in single precision.
_LARGEST = 1e15


@dataclass(frozen=True)
class StateField:
    """A field of the state: its symbol, what it becomes, and what it becomes in a bad cycle if that
    is something else."""

    field: Field
    symbol: ca.SX
    following: ca.SX
    spoilt: ca.SX | None = None


@dataclass(frozen=True)
class OutputField:
    """A field of the outputs."""

    field: Field
    value: ca.SX


@dataclass(frozen=True)
class CyclePart:
    """What one concern adds to a cycle."""

    kept: tuple[StateField, ...]
    given: tuple[OutputField, ...]


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
        names = ["state", "inputs"], ["following", "outputs"]
        both = ca.cse([self.following, self.y])
        return ca.Function("online_step", [self.x, self.u], both, *names)

    @property
    def operations(self) -> int:
        """How many a cycle takes."""
        f = self.function
        ends = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}
        return sum(f.instruction_id(k) not in ends for k in range(f.n_instructions()))


def assembled(
    inputs: Layout, u: dict[str, ca.SX], good: ca.SX, parts: Sequence[CyclePart], period: float
) -> StepGraph:
    """One graph of all parts.

    Args:
        inputs, u: what is read, with its symbols.
        good: 1 where the inputs can be used.
    """
    kept = [k for part in parts for k in part.kept if k.field.size]
    given = [g for part in parts for g in part.given if g.field.size]
    state, outputs = (
        Layout.from_fields(*(k.field for k in kept)),
        Layout.from_fields(*(g.field for g in given)),
    )
    following = state.vector(
        {
            k.field.name: k.following if k.spoilt is None else chosen(good, k.following, k.spoilt)
            for k in kept
        }
    )
    y = outputs.vector({g.field.name: g.value for g in given})
    status = Field("status", 1, "0 for a good cycle, 1 for one that could not be used")
    return StepGraph(
        state,
        inputs,
        outputs + Layout.from_fields(status),
        ca.vertcat(ca.SX(0, 1), *(k.symbol for k in kept)),
        inputs.vector(u),
        following,
        ca.vertcat(y, 1 - good),
        period,
    )


def all_finite(x: ca.SX) -> ca.SX:
    """1 where no number is NaN, infinite or beyond all bounds."""
    return ca.sum1(ca.fabs(ca.densify(x))) < _LARGEST


def only_if(condition: ca.SX, x: ca.SX) -> ca.SX:
    """x, its pattern kept, or zero."""
    return ca.SX(x.sparsity(), ca.if_else(condition, x.nz[:], 0))


def chosen(condition: ca.SX, yes: ca.SX, no: ca.SX) -> ca.SX:
    """Entry by entry; NaN of what is not chosen stays out."""
    pairs = zip(ca.vertsplit(ca.densify(yes)), ca.vertsplit(ca.densify(no)), strict=True)
    return ca.vertcat(*(ca.if_else(condition, a, b) for a, b in pairs))
