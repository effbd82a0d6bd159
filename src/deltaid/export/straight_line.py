"""A CasADi SX graph as straight-line statements: no loop, no call but those of math.h.

The graph's instruction list works on numbered slots, and so does the code: `w17 = w3*w4;`. Slots
are few hundred local numbers, so a function needs a small, fixed stack and has no state. How a
statement looks is a dialect's; C's is here, that of structured text beside it.
"""

import textwrap
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from deltaid.export.precision import DOUBLE, Precision
from deltaid.kernel.llvm_ir import LIBM_BINARY, LIBM_UNARY, operation_name

_INFIX = {
    ca.OP_ADD: "+",
    ca.OP_SUB: "-",
    ca.OP_MUL: "*",
    ca.OP_DIV: "/",
}
_COMPARED = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_CALLED = {
    ca.OP_SQRT: "sqrt",
    ca.OP_FABS: "fabs",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_COPYSIGN: "copysign",
    **LIBM_UNARY,
    **LIBM_BINARY,
}


@dataclass(frozen=True)
class Array:
    """An input of a function: its name and its symbols. A table is no argument, but in scope."""

    name: str
    symbols: ca.SX
    is_table: bool = False


SIGN = "(double)(({a} > 0.0) - ({a} < 0.0))"


class Dialect(ABC):
    """How a language writes the steps of a graph; values are texts."""

    @abstractmethod
    def number(self, x: float) -> str:
        """A constant."""

    @abstractmethod
    def set(self, target: str, text: str) -> list[str]:
        """The statements by which a variable gets a value."""

    @abstractmethod
    def operation(self, target: str, op: int, args: list[str], needed: bool) -> list[str]:
        """The statements by which a variable gets the result of an operation.

        Args:
            needed: whether the result matters whatever the graph's choices are.
        """


@dataclass(frozen=True)
class Body:
    """A graph as statements.

    Attributes:
        lines: the statements.
        used: names of the inputs that they read.
        slots: variables that they write.
    """

    lines: list[str]
    used: set[str]
    slots: list[str]


def body(inputs: Sequence[Array], out: str, expression: ca.SX, dialect: Dialect) -> Body:
    """Statements that compute a column of expressions, in the order of CasADi's instructions."""
    f = ca.Function("f", [array.symbols for array in inputs], ca.cse([ca.densify(expression)]))
    names = [array.name for array in inputs]
    value: dict[int, str] = {}  # what a slot holds: its own name, an input's entry or a number
    lines: list[str] = []
    used: set[str] = set()
    slots: set[int] = set()
    needed = _needed(f)
    for k in range(f.n_instructions()):
        op, read, written = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if op == ca.OP_CONST:
            value[written[0]] = dialect.number(f.instruction_constant(k))
        elif op == ca.OP_INPUT:
            used.add(names[read[0]])
            value[written[0]] = f"{names[read[0]]}[{read[1]}]"
        elif op == ca.OP_OUTPUT:
            lines += dialect.set(f"{out}[{written[1]}]", value[read[0]])
        else:
            target = f"w{written[0]}"
            lines += dialect.operation(target, op, [value[i] for i in read], needed[k])
            slots.add(written[0])
            value[written[0]] = target
    return Body(lines, used, [f"w{k}" for k in sorted(slots)])


def _needed(f: ca.Function) -> list[bool]:
    """Of each instruction whether its result matters whatever is chosen, from the last one on."""
    found, slots = [False] * f.n_instructions(), dict[int, bool]()
    for k in reversed(range(f.n_instructions())):
        op, read, written = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if op in (ca.OP_CONST, ca.OP_INPUT):
            slots.pop(written[0], None)
            continue
        found[k] = op == ca.OP_OUTPUT or slots.pop(written[0], False)
        chosen = read[:1] if op == ca.OP_IF_ELSE_ZERO else read
        for slot in chosen:
            slots[slot] = slots.get(slot, False) or found[k]
    return found


def straight_line(
    name: str,
    inputs: Sequence[Array],
    output: tuple[str, ca.SX],
    *,
    linkage: str = "",
    sign: str = SIGN,
    precision: Precision = DOUBLE,
) -> str:
    """C text of `void name(const double input[], …, double output[])`.

    The output's entries are dense, a matrix row by row.

    Args:
        sign: C expression for the sign of {a}.

    Raises:
        NotImplementedError: the graph has an operation that no kernel has either, which no
            mechanism can be built with (`kernel.llvm_ir.operations_unknown`).
    """
    (out_name, expression), real = output, precision.c_type
    dense = ca.vec(ca.densify(expression).T)
    found = body(inputs, out_name, dense, _C(precision, sign))
    arguments = [f"const {real} {a.name}[{a.symbols.numel()}]" for a in inputs if not a.is_table]
    signature = ", ".join([*arguments, f"{real} {out_name}[{dense.numel()}]"])
    unused = [f"    (void){a.name};" for a in inputs if not a.is_table and a.name not in found.used]
    return "\n".join(
        [
            *wrapped(f"{linkage}void {name}({signature})"),
            "{",
            *(wrapped(f"    {real} {', '.join(found.slots)};") if found.slots else []),
            *unused,
            *found.lines,
            "}",
        ]
    )


@dataclass(frozen=True)
class _C(Dialect):
    """Statements of C99."""

    precision: Precision
    sign: str

    def number(self, x: float) -> str:
        return self.precision.c_number(x)

    def set(self, target: str, text: str) -> list[str]:
        return [f"    {target} = {text};"]

    def operation(self, target: str, op: int, args: list[str], needed: bool) -> list[str]:
        return self.set(target, self._expression(op, args))

    def _expression(self, op: int, args: list[str]) -> str:
        """One scalar operation."""
        a, b, f, real = args[0], args[-1], self.precision.suffix, self.precision.c_type
        if op in _INFIX:
            return f"{a} {_INFIX[op]} {b}"
        if op in _COMPARED:
            return f"({real})({a} {_COMPARED[op]} {b})"
        if op in _CALLED:
            return f"{_CALLED[op]}{f}({', '.join(args)})"
        sign = self.sign if not f else self.sign.replace("double", real).replace("0.0", "0.0f")
        simple = {
            ca.OP_ASSIGN: a,
            ca.OP_NEG: f"-{a}",
            ca.OP_SQ: f"{a} * {a}",
            ca.OP_TWICE: f"{a} + {a}",
            ca.OP_INV: f"1.0{f} / {a}",
            ca.OP_SIGN: sign.format(a=a),
            ca.OP_NOT: f"({real})({a} == 0.0{f})",
            ca.OP_AND: f"({real})({a} != 0.0{f} && {b} != 0.0{f})",
            ca.OP_OR: f"({real})({a} != 0.0{f} || {b} != 0.0{f})",
            ca.OP_IF_ELSE_ZERO: f"({a} != 0.0{f}) ? {b} : 0.0{f}",
        }
        if op not in simple:
            raise NotImplementedError(f"CasADi's {operation_name(op)} has no C form here")
        return simple[op]


def number(x: float) -> str:
    """A double as C text that reads back with every bit."""
    return DOUBLE.c_number(x)


def wrapped(text: str) -> list[str]:
    """A declaration in lines of at most 96 characters, broken after commas."""
    indent = text[: len(text) - len(text.lstrip())]
    whole = text.strip().replace(" ", "\0").replace(",\0", ", ")
    lines = textwrap.wrap(
        whole,
        96,
        initial_indent=indent,
        subsequent_indent=f"{indent}    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace("\0", " ") for line in lines]
