"""A CasADi SX function as one straight-line C99 function: no loop, no call but those of math.h.

The graph's instruction list works on numbered slots, and so does the C code: `w17 = w3*w4;`. Slots
are few hundred local doubles, so the function needs a small, fixed stack and has no state.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

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
    """An input of a C function: its name and its symbols. A table is no argument, but in scope."""

    name: str
    symbols: ca.SX
    is_table: bool = False


SIGN = "(double)(({a} > 0.0) - ({a} < 0.0))"


def straight_line(
    name: str,
    inputs: Sequence[Array],
    output: tuple[str, ca.SX],
    *,
    linkage: str = "",
    sign: str = SIGN,
) -> str:
    """C text of `void name(const double input[], …, double output[])`.

    The output's entries are dense, a matrix row by row.

    Args:
        sign: C expression for the sign of {a}.

    Raises:
        NotImplementedError: the graph has an operation that no kernel has either, which no
            mechanism can be built with (`kernel.llvm_ir.operations_unknown`).
    """
    out_name, expression = output
    dense = ca.vec(ca.densify(expression).T)
    function = ca.Function("f", [array.symbols for array in inputs], ca.cse([dense]))
    lines, used, slots = _body(function, [array.name for array in inputs], out_name, sign)
    arguments = [f"const double {a.name}[{a.symbols.numel()}]" for a in inputs if not a.is_table]
    signature = ", ".join([*arguments, f"double {out_name}[{dense.numel()}]"])
    unused = [f"    (void){a.name};" for a in inputs if not a.is_table and a.name not in used]
    return "\n".join(
        [
            f"{linkage}void {name}({signature})",
            "{",
            *_declared(slots),
            *unused,
            *lines,
            "}",
        ]
    )


def _body(
    f: ca.Function, names: list[str], out: str, sign: str
) -> tuple[list[str], set[str], list[int]]:
    """Statements, names of the inputs that they read, and the slots that they write."""
    value: dict[int, str] = {}  # what a slot holds: its own name, an input's entry or a number
    lines: list[str] = []
    used: set[str] = set()
    slots: set[int] = set()
    for k in range(f.n_instructions()):
        op, read, written = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if op == ca.OP_CONST:
            value[written[0]] = number(f.instruction_constant(k))
        elif op == ca.OP_INPUT:
            used.add(names[read[0]])
            value[written[0]] = f"{names[read[0]]}[{read[1]}]"
        elif op == ca.OP_OUTPUT:
            lines.append(f"    {out}[{written[1]}] = {value[read[0]]};")
        else:
            text = _operation(op, [value[i] for i in read], sign)
            slots.add(written[0])
            value[written[0]] = f"w{written[0]}"
            lines.append(f"    w{written[0]} = {text};")
    return lines, used, sorted(slots)


def _operation(op: int, args: list[str], sign: str) -> str:
    """One scalar operation as a C expression."""
    a, b = args[0], args[-1]
    if op in _INFIX:
        return f"{a} {_INFIX[op]} {b}"
    if op in _COMPARED:
        return f"(double)({a} {_COMPARED[op]} {b})"
    if op in _CALLED:
        return f"{_CALLED[op]}({', '.join(args)})"
    simple = {
        ca.OP_ASSIGN: a,
        ca.OP_NEG: f"-{a}",
        ca.OP_SQ: f"{a} * {a}",
        ca.OP_TWICE: f"{a} + {a}",
        ca.OP_INV: f"1.0 / {a}",
        ca.OP_SIGN: sign.format(a=a),
        ca.OP_NOT: f"(double)({a} == 0.0)",
        ca.OP_AND: f"(double)({a} != 0.0 && {b} != 0.0)",
        ca.OP_OR: f"(double)({a} != 0.0 || {b} != 0.0)",
        ca.OP_IF_ELSE_ZERO: f"({a} != 0.0) ? {b} : 0.0",
    }
    if op not in simple:
        raise NotImplementedError(f"CasADi's {operation_name(op)} has no C form here")
    return simple[op]


def number(x: float) -> str:
    """A double as C text that reads back with every bit."""
    text = repr(float(x))
    return f"({text})" if text.startswith("-") else text


def _declared(slots: list[int]) -> list[str]:
    if not slots:
        return []
    text = f"double {', '.join(f'w{k}' for k in slots)};"
    return textwrap.wrap(text, 96, initial_indent="    ", subsequent_indent="        ")
