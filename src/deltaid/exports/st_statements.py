"""A CasADi graph as statements of structured text.

Controllers may stop on a division by zero or the root of a negative number, where C goes on with
NaN. So what could do that is looked at before, and the function returns, with the status that it
holds by then. What matters only where a choice of the graph takes it becomes zero there instead:
choices are in a graph to stay away from what cannot be computed, and both sides of one are always
computed here. There is no expression with more than one operation, and no function that the
standard has not had from its first edition on (ATAN2 is a function of the file's own).
"""

import math
from dataclasses import dataclass

import casadi as ca

from deltaid.errors import DeltaidError
from deltaid.exports.straight_line import Dialect
from deltaid.exports.text import DOUBLE, Precision
from deltaid.kernel.llvm_ir import operation_name

_INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*"}
_TRUTH = {
    ca.OP_LT: "{a} < {b}",
    ca.OP_LE: "{a} <= {b}",
    ca.OP_EQ: "{a} = {b}",
    ca.OP_NE: "{a} <> {b}",
    ca.OP_NOT: "{a} = 0.0",
    ca.OP_AND: "({a} <> 0.0) AND ({b} <> 0.0)",
    ca.OP_OR: "({a} <> 0.0) OR ({b} <> 0.0)",
}
_CALLED = {
    ca.OP_FABS: "ABS({a})",
    ca.OP_SIN: "SIN({a})",
    ca.OP_COS: "COS({a})",
    ca.OP_ATAN: "ATAN({a})",
    ca.OP_ASSIGN: "{a}",
    ca.OP_NEG: "-{a}",
    ca.OP_SQ: "{a} * {a}",
    ca.OP_TWICE: "{a} + {a}",
}
# What must not be, then the result.
_GUARDED = {
    ca.OP_SQRT: ("{a} < 0.0", "SQRT({a})"),
    ca.OP_ASIN: ("ABS({a}) > 1.0", "ASIN({a})"),
    ca.OP_ACOS: ("ABS({a}) > 1.0", "ACOS({a})"),
    ca.OP_LOG: ("{a} <= 0.0", "LN({a})"),
    ca.OP_DIV: ("ABS({b}) < {least}", "{a} / {b}"),
    ca.OP_INV: ("ABS({a}) < {least}", "1.0 / {a}"),
}
_BRANCHED = {
    ca.OP_IF_ELSE_ZERO: "IF {a} <> 0.0 THEN {w} := {b}; ELSE {w} := 0.0; END_IF;",
    ca.OP_FMIN: "IF {a} < {b} THEN {w} := {a}; ELSE {w} := {b}; END_IF;",
    ca.OP_FMAX: "IF {a} > {b} THEN {w} := {a}; ELSE {w} := {b}; END_IF;",
    ca.OP_COPYSIGN: "IF {b} < 0.0 THEN {w} := -ABS({a}); ELSE {w} := ABS({a}); END_IF;",
    ca.OP_SIGN: (
        "IF {a} > 0.0 THEN {w} := 1.0; ELSIF {a} < 0.0 THEN {w} := -1.0; ELSE {w} := 0.0; END_IF;"
    ),
    ca.OP_EXP: (
        "IF {a} > {most} THEN RETURN; ELSIF {a} < -{most} THEN {w} := 0.0; "
        "ELSE {w} := EXP({a}); END_IF;"
    ),
}
# Calls of functions of the file's own (`st_helpers`); to subtract is to add the negative.
_PAIRED = {
    ca.OP_ADD: ("pair_sum", "{a}", "{r}", "{b}", "{s}"),
    ca.OP_SUB: ("pair_sum", "{a}", "{r}", "-{b}", "-{s}"),
    ca.OP_MUL: ("pair_product", "{a}", "{r}", "{b}", "{s}"),
    ca.OP_SQ: ("pair_product", "{a}", "{r}", "{a}", "{r}"),
    ca.OP_DIV: ("pair_quotient", "{a}", "{r}", "{b}", "{s}"),
    ca.OP_INV: ("pair_quotient", "1.0", "0.0", "{a}", "{r}"),
    ca.OP_SQRT: ("pair_root", "{a}", "{r}"),
    ca.OP_SIN: ("pair_sine", "{a}", "{r}", "0.0"),
    ca.OP_COS: ("pair_sine", "{a}", "{r}", "1.0"),
}
# The rest first: the target may be what is read.
_EXACT = {
    ca.OP_ASSIGN: "{v} := {r}; {w} := {a};",
    ca.OP_NEG: "{v} := -{r}; {w} := -{a};",
    ca.OP_TWICE: "{v} := {r} + {r}; {w} := {a} + {a};",
    ca.OP_FABS: (
        "IF {a} < 0.0 THEN {v} := -{r}; {w} := -{a}; ELSE {v} := {r}; {w} := {a}; END_IF;"
    ),
    ca.OP_IF_ELSE_ZERO: (
        "IF {a} <> 0.0 THEN {v} := {s}; {w} := {b}; ELSE {v} := 0.0; {w} := 0.0; END_IF;"
    ),
}
_POWERS = (ca.OP_POW, ca.OP_CONSTPOW)
# MATIEC refuses literals of LREAL that a REAL cannot hold; nothing of a robot is so small.
_SMALLEST = 1e-37


@dataclass(frozen=True)
class StructuredText(Dialect):
    """Statements of structured text.

    Attributes:
        precision: of its numbers.
        prefix: of names of functions of the file's own.
    """

    precision: Precision
    prefix: str

    def number(self, x: float) -> str:
        return literal(self.precision, x)

    def set(self, target: str, text: str) -> list[str]:
        return [f"{target} := {text};"]

    def operation(self, target: str, op: int, args: list[str], needed: bool) -> list[str]:
        named = {
            "w": target,
            "a": args[0],
            "b": args[-1],
            "least": literal(self.precision, self.precision.least),
            "most": "700.0" if self.precision is DOUBLE else "80.0",
        }
        if op in _INFIX:
            return self.set(target, f"{args[0]} {_INFIX[op]} {args[-1]}")
        if op in _CALLED:
            return self.set(target, _CALLED[op].format(**named))
        if op in _TRUTH:
            truth = _TRUTH[op].format(**named)
            return [f"IF {truth} THEN {target} := 1.0; ELSE {target} := 0.0; END_IF;"]
        if op in _BRANCHED:
            return [_BRANCHED[op].format(**named)]
        if op in _GUARDED:
            bad, result = (part.format(**named) for part in _GUARDED[op])
            known = args[-1][0] in "(0123456789"  # a constant, which is not zero
            if known:
                return self.set(target, result)
            if not needed:
                return [f"IF {bad} THEN {target} := 0.0; ELSE {target} := {result}; END_IF;"]
            return [f"IF {bad} THEN RETURN; END_IF;", f"{target} := {result};"]
        if op == ca.OP_ATAN2:
            return self.set(target, f"{self.prefix}_atan2({args[0]}, {args[-1]})")
        if op in _POWERS:
            return _power(target, *args)
        raise DeltaidError(
            f"structured text has no function for CasADi's {operation_name(op)}, which this "
            "robot's mechanism uses",
            where="--to st",
            cure="choose c, or write the mechanism with roots, sines, arctangents and powers",
        )

    def doubled(
        self, targets: tuple[str, str], op: int, args: list[tuple[str, str]], needed: bool
    ) -> list[str]:
        (target, rest), ((a, r), (b, s)) = targets, (args[0], args[-1])
        least = literal(self.precision, self.precision.least)
        named = {"a": a, "r": r or "0.0", "b": b, "s": s or "0.0", "least": least}
        if op in _EXACT:
            return [_EXACT[op].format(w=target, v=rest, **named)]
        name, *given = (part.format(**named) for part in _PAIRED[op])
        inputs = zip(("a", "da", "b", "db"), map(_one_sign, given), strict=False)
        passed = ", ".join(f"{x} := {value}" for x, value in inputs)
        call = f"{target} := {self.prefix}_{name}({passed}, dc => {rest});"
        known = op in (ca.OP_DIV, ca.OP_INV) and b[0] in "(0123456789"
        if op not in _GUARDED or known:
            return [call]
        bad = _GUARDED[op][0].format(**named)
        if needed:
            return [f"IF {bad} THEN RETURN; END_IF;", call]
        return [f"IF {bad} THEN {target} := 0.0; {rest} := 0.0;", f"ELSE {call}", "END_IF;"]


def _one_sign(text: str) -> str:
    """-(-0.5) as 0.5, and zero without a sign."""
    if text.startswith("-(-"):
        return text[3:-1]
    return "0.0" if text == "-0.0" else text


def plain(precision: Precision, x: float) -> str:
    """A number with digits on both sides of its point; none but 0 is too small for a REAL."""
    if x and abs(x) < _SMALLEST:
        x = math.copysign(_SMALLEST, x)
    digits, _, exponent = precision.digits(x).partition("e")
    text = digits if "." in digits else f"{digits}.0"
    return text + (f"E{int(exponent)}" if exponent else "")


def literal(precision: Precision, x: float) -> str:
    """The same for expressions: in parentheses where it has a sign."""
    text = plain(precision, x)
    return f"({text})" if text.startswith("-") else text


def _power(target: str, base: str, exponent: str) -> list[str]:
    """A power; of a negative base where the exponent is a small whole number only."""
    whole = exponent.removesuffix(".0")
    if whole.isdigit() and 0 < int(whole) <= 8:
        return [f"{target} := {' * '.join([base] * int(whole))};"]
    return [
        f"IF {base} > 0.0 THEN {target} := EXPT({base}, {exponent});",
        f"ELSIF ({base} < 0.0) OR ({exponent} <= 0.0) THEN RETURN;",
        f"ELSE {target} := 0.0; END_IF;",
    ]
