"""A CasADi SX graph as straight-line statements, without loops, and with calls of math.h only.

The code works on the numbered slots of the graph's instruction list: `w17 = w3*w4;`. Slots are a
few hundred local numbers, so a function needs a small, fixed stack and has no state. Results that
need more digits than a float has are sums of two numbers, `w17` and the rest `r17` (`digits`). A
dialect defines the statements: that of C is here, that of structured text in `st_units`.
"""

import textwrap
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca

from deltaid.exports.digits import Care, OutputPart
from deltaid.exports.text import DOUBLE, Precision, split
from deltaid.kernel.llvm_ir import LIBM_BINARY, LIBM_UNARY, operation_name, steps_of

_LOGIC = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_ONE = {**LIBM_UNARY, ca.OP_SQRT: "sqrt", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor",
        ca.OP_CEIL: "ceil"}  # fmt: skip
_TWO = {**LIBM_BINARY, ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax", ca.OP_COPYSIGN: "copysign"}
# Expressions of C: operands {a}, {b}, type of numbers {real}, suffix of literals and functions {f}.
_C_FORMS = {
    ca.OP_ASSIGN: "{a}",
    ca.OP_NEG: "-{a}",
    ca.OP_ADD: "{a} + {b}",
    ca.OP_SUB: "{a} - {b}",
    ca.OP_MUL: "{a} * {b}",
    ca.OP_DIV: "{a} / {b}",
    ca.OP_SQ: "{a} * {a}",
    ca.OP_TWICE: "{a} + {a}",
    ca.OP_INV: "1.0{f} / {a}",
    ca.OP_NOT: "({real})({a} == 0.0{f})",
    ca.OP_AND: "({real})({a} != 0.0{f} && {b} != 0.0{f})",
    ca.OP_OR: "({real})({a} != 0.0{f} || {b} != 0.0{f})",
    ca.OP_IF_ELSE_ZERO: "({a} != 0.0{f}) ? {b} : 0.0{f}",
    **{op: f"({{real}})({{a}} {sign} {{b}})" for op, sign in _LOGIC.items()},
    **{op: f"{name}{{f}}({{a}})" for op, name in _ONE.items()},
    **{op: f"{name}{{f}}({{a}}, {{b}})" for op, name in _TWO.items()},
}
# Result and rest of operations that do not round.
_C_EXACT = {
    ca.OP_ASSIGN: ("{a}", "{r}"),
    ca.OP_NEG: ("-{a}", "-{r}"),
    ca.OP_TWICE: ("{a} + {a}", "{r} + {r}"),
    ca.OP_FABS: ("fabsf({a})", "({a} < {zero}) ? -{r} : {r}"),
    ca.OP_IF_ELSE_ZERO: ("({a} != {zero}) ? {b} : {zero}", "({a} != {zero}) ? {s} : {zero}"),
}


# Functions of templates/pairs.c.jinja; subtraction adds the negative.
_PAIRED = {
    ca.OP_ADD: "pair_sum({a}, {r}, {b}, {s}",
    ca.OP_SUB: "pair_sum({a}, {r}, -{b}, -{s}",
    ca.OP_MUL: "pair_product({a}, {r}, {b}, {s}",
    ca.OP_SQ: "pair_product({a}, {r}, {a}, {r}",
    ca.OP_DIV: "pair_quotient({a}, {r}, {b}, {s}",
    ca.OP_INV: "pair_quotient(1.0f, {zero}, {a}, {r}",
    ca.OP_SQRT: "pair_root({a}, {r}",
    ca.OP_SIN: "pair_sine({a}, {r}",
    ca.OP_COS: "pair_cosine({a}, {r}",
}


@dataclass(frozen=True)
class Array:
    """An input of a function: its name and its symbols. A table is global and no argument."""

    name: str
    symbols: ca.SX
    is_table: bool = False


SIGN = "(double)(({a} > 0.0) - ({a} < 0.0))"


class Dialect(ABC):
    """Syntax of a language for the steps of a graph; values are expressions as text."""

    @abstractmethod
    def number(self, x: float) -> str:
        """A constant as text of the language."""

    @abstractmethod
    def operation(self, target: str, op: int, args: list[str], needed: bool) -> list[str]:
        """Statements that assign the result of an operation to a variable.

        Args:
            needed: whether the result matters in every branch of the graph.
        """

    @abstractmethod
    def doubled(
        self, targets: tuple[str, str], op: int, args: list[tuple[str, str]], needed: bool
    ) -> list[str]:
        """Statements for a result that is the sum of two numbers, as operands may be."""


def body(
    inputs: Sequence[Array],
    out: str,
    expression: ca.SX,
    dialect: Dialect,
    care: Care | None = None,
    parts: Sequence[OutputPart] = (),
) -> tuple[list[str], list[str], set[str]]:
    """Statements that compute a column of expressions, in the order of CasADi's instructions; the
    variables that they write, and the names of the inputs that they read.

    Args:
        care: selects the steps that need twice the digits; None for none.
        parts: of the column, with the scales of their errors.
    """
    f = ca.Function("f", [array.symbols for array in inputs], ca.cse([ca.densify(expression)]))
    names = [array.name for array in inputs]
    twice = frozenset[int]() if care is None else care.pairs(f, names, parts)
    # Content of a slot: its own name, an input's entry or a number, and the rest of a sum.
    value: dict[int, tuple[str, str]] = {}
    lines, used, slots, needed = list[str](), set[str](), set[str](), _needed(f)
    for k, (op, read, written, x) in enumerate(steps_of(f)):
        to, args = written[0], [] if op == ca.OP_INPUT else [value[i] for i in read]
        if op == ca.OP_CONST:
            rest = split(x)[1] if k in twice else 0.0
            value[to] = dialect.number(x), dialect.number(rest) if rest else ""
        elif op == ca.OP_INPUT:
            used.add(names[read[0]])
            value[to] = f"{names[read[0]]}[{read[1]}]", ""
        elif op == ca.OP_OUTPUT:
            lines += dialect.operation(f"{out}[{written[1]}]", ca.OP_ASSIGN, [args[0][0]], True)
        elif k in twice:
            value[to] = f"w{to}", f"r{to}"
            lines += dialect.doubled(value[to], op, args, needed[k])
            slots |= {*value[to]}
        else:
            value[to] = f"w{to}", ""
            lines += dialect.operation(f"w{to}", op, [arg for arg, _ in args], needed[k])
            slots.add(f"w{to}")
    return lines, in_order(slots), used


def in_order(slots: Iterable[str]) -> list[str]:
    """Names of slots in order: w1, w2, …, then the rests r1, …."""
    return sorted(slots, key=lambda slot: (slot[0] == "r", int(slot[1:])))


def _needed(f: ca.Function) -> list[bool]:
    """Whether the result of each instruction matters in every branch of the graph, determined from
    the last instruction backwards."""
    needed, slots = [False] * f.n_instructions(), dict[int, bool]()
    for k, (op, read, written, _) in reversed(list(enumerate(steps_of(f)))):
        if op in (ca.OP_CONST, ca.OP_INPUT):
            slots.pop(written[0], None)
            continue
        needed[k] = op == ca.OP_OUTPUT or slots.pop(written[0], False)
        for slot in read[:1] if op == ca.OP_IF_ELSE_ZERO else read:
            slots[slot] = slots.get(slot, False) or needed[k]
    return needed


def straight_line(
    name: str,
    inputs: Sequence[Array],
    output: tuple[str, ca.SX],
    *,
    sign: str = SIGN,
    precision: Precision = DOUBLE,
    care: Care | None = None,
    parts: Sequence[OutputPart] = (),
) -> str:
    """C text of `static void name(const double input[], …, double output[])`.

    The output's entries are dense, a matrix row by row.

    Args:
        sign: C expression for the sign of {a}.
        care, parts: as of `body`.

    Raises:
        NotImplementedError: the graph has an operation that the kernels lack too, so no mechanism
            can contain it (`kernel.llvm_ir.operations_unknown`).
    """
    (out_name, expression), real = output, precision.c_type
    dense = ca.vec(ca.densify(expression).T)
    lines, slots, used = body(inputs, out_name, dense, _C(precision, sign), care, parts)
    arrays = [array for array in inputs if not array.is_table]
    arguments = [f"const {real} {array.name}[{array.symbols.numel()}]" for array in arrays]
    signature = ", ".join([*arguments, f"{real} {out_name}[{dense.numel()}]"])
    return "\n".join(
        [
            *wrapped(f"static void {name}({signature})"),
            "{",
            *(wrapped(f"    {real} {', '.join(slots)};") if slots else []),
            *(f"    (void){array.name};" for array in arrays if array.name not in used),
            *lines,
            "}",
        ]
    )


@dataclass(frozen=True)
class _C(Dialect):
    precision: Precision
    sign: str

    def number(self, x: float) -> str:
        return self.precision.c_number(x)

    def operation(self, target: str, op: int, args: list[str], needed: bool) -> list[str]:
        real, f = self.precision.c_type, self.precision.suffix
        sign = self.sign.replace("double", real).replace("0.0", f"0.0{f}")
        form = sign if op == ca.OP_SIGN else _C_FORMS.get(op)
        if form is None:
            raise NotImplementedError(f"CasADi's {operation_name(op)} has no C form here")
        return [f"    {target} = {form.format(a=args[0], b=args[-1], real=real, f=f)};"]

    def doubled(
        self, targets: tuple[str, str], op: int, args: list[tuple[str, str]], needed: bool
    ) -> list[str]:
        (target, rest), zero = targets, f"0.0{self.precision.suffix}"
        (a, r), (b, s) = ((high, low or zero) for high, low in (args[0], args[-1]))
        named = {"a": a, "r": r, "b": b, "s": s, "zero": zero}
        if op in _PAIRED:
            return [f"    {target} = {_PAIRED[op].format(**named)}, &{rest});"]
        first, second = (part.format(**named) for part in _C_EXACT[op])
        # The rest is assigned first: the target may be an operand.
        return [f"    {rest} = {second};", f"    {target} = {first};"]


def wrapped(text: str) -> list[str]:
    """A declaration in lines of at most 96 characters, broken after commas."""
    indent = text[: len(text) - len(text.lstrip())]
    lines = textwrap.wrap(
        text.strip().replace(" ", "\0").replace(",\0", ", "),
        96,
        initial_indent=indent,
        subsequent_indent=f"{indent}    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace("\0", " ") for line in lines]
