"""Statements of structured text for the operations of a CasADi graph.

Controllers may stop on a division by zero or the root of a negative number, where C continues with
NaN. So operands are checked first, and the function returns its current status if one is invalid.
Both branches of a choice are always computed; an operand that matters in one branch only is
replaced by zero if it is invalid. Expressions have one operation each and use functions of the
standard's first edition only (ATAN2 is defined in the file).
"""

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.errors import DeltaidError
from deltaid.exports.straight_line import Dialect
from deltaid.exports.text import DOUBLE, Precision
from deltaid.kernel.llvm_ir import operation_name

_TRUTH = {
    ca.OP_LT: "{a} < {b}",
    ca.OP_LE: "{a} <= {b}",
    ca.OP_EQ: "{a} = {b}",
    ca.OP_NE: "{a} <> {b}",
    ca.OP_NOT: "{a} = 0.0",
    ca.OP_AND: "({a} <> 0.0) AND ({b} <> 0.0)",
    ca.OP_OR: "({a} <> 0.0) OR ({b} <> 0.0)",
}


_FORMS = {
    ca.OP_ADD: "{w} := {a} + {b};",
    ca.OP_SUB: "{w} := {a} - {b};",
    ca.OP_MUL: "{w} := {a} * {b};",
    ca.OP_FABS: "{w} := ABS({a});",
    ca.OP_SIN: "{w} := SIN({a});",
    ca.OP_COS: "{w} := COS({a});",
    ca.OP_ATAN: "{w} := ATAN({a});",
    ca.OP_ATAN2: "{w} := {prefix}_atan2({a}, {b});",
    ca.OP_ASSIGN: "{w} := {a};",
    ca.OP_NEG: "{w} := -{a};",
    ca.OP_SQ: "{w} := {a} * {a};",
    ca.OP_TWICE: "{w} := {a} + {a};",
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
    **{
        op: f"IF {truth} THEN {{w}} := 1.0; ELSE {{w}} := 0.0; END_IF;"
        for op, truth in _TRUTH.items()
    },
}


# The condition for an invalid operand, then the result.
_GUARDED = {
    ca.OP_SQRT: ("{a} < 0.0", "SQRT({a})"),
    ca.OP_ASIN: ("ABS({a}) > 1.0", "ASIN({a})"),
    ca.OP_ACOS: ("ABS({a}) > 1.0", "ACOS({a})"),
    ca.OP_LOG: ("{a} <= 0.0", "LN({a})"),
    ca.OP_DIV: ("ABS({b}) < {least}", "{a} / {b}"),
    ca.OP_INV: ("ABS({a}) < {least}", "1.0 / {a}"),
}


# Calls of functions in the same file (`structured_text`); subtraction adds the negative.
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


# The rest is assigned first: the target may be an operand.
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


# MATIEC refuses literals of LREAL that a REAL cannot hold; no robot has numbers so small.
_SMALLEST = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class StructuredText(Dialect):
    """Statements of structured text.

    precision: of its numbers.
    prefix: of the names of functions in the same file.
    """

    precision: Precision
    prefix: str

    def number(self, x: float) -> str:
        return literal(self.precision, x)

    def operation(self, target: str, op: int, args: list[str], needed: bool) -> list[str]:
        a, b = args[0], args[-1]
        if op in _FORMS:
            most = "700.0" if self.precision is DOUBLE else "80.0"
            return [_FORMS[op].format(w=target, a=a, b=b, most=most, prefix=self.prefix)]
        if op in _GUARDED:
            result = f"{target} := {_GUARDED[op][1].format(a=a, b=b)};"
            if (bad := self._bad(op, a, b)) and not needed:
                return [f"IF {bad} THEN {target} := 0.0; ELSE {result} END_IF;"]
            return [*([f"IF {bad} THEN RETURN; END_IF;"] if bad else []), result]
        if op in _POWERS:
            return _power(target, *args)
        raise DeltaidError(
            f"structured text has no function for CasADi's {operation_name(op)}, which this "
            "robot's mechanism uses",
            where="--to st",
            cure="choose c, or write the mechanism with roots, sines, arctangents and powers",
        )

    def _bad(self, op: int, a: str, b: str) -> str:
        """The condition for an invalid operand; empty for a nonzero constant."""
        if op not in _GUARDED or b[0] in "(0123456789":
            return ""
        return _GUARDED[op][0].format(a=a, b=b, least=literal(self.precision, self.precision.least))

    def doubled(
        self, targets: tuple[str, str], op: int, args: list[tuple[str, str]], needed: bool
    ) -> list[str]:
        (target, rest), ((a, r), (b, s)) = targets, (args[0], args[-1])
        named = {"a": a, "r": r or "0.0", "b": b, "s": s or "0.0"}
        if op in _EXACT:
            return [_EXACT[op].format(w=target, v=rest, **named)]
        name, *given = (part.format(**named) for part in _PAIRED[op])
        inputs = zip(("a", "da", "b", "db"), map(_one_sign, given), strict=False)
        passed = ", ".join(f"{x} := {value}" for x, value in inputs)
        call = f"{target} := {self.prefix}_{name}({passed}, dc => {rest});"
        if not (bad := self._bad(op, a, b)):
            return [call]
        if needed:
            return [f"IF {bad} THEN RETURN; END_IF;", call]
        return [f"IF {bad} THEN {target} := 0.0; {rest} := 0.0;", f"ELSE {call}", "END_IF;"]


def _one_sign(text: str) -> str:
    """-(-0.5) as 0.5, and zero without sign."""
    if text.startswith("-(-"):
        return text[3:-1]
    return "0.0" if text == "-0.0" else text


def plain(precision: Precision, x: float) -> str:
    """A number with digits on both sides of its point; nonzero numbers stay within a REAL's
    range."""
    if x and abs(x) < _SMALLEST:
        x = math.copysign(_SMALLEST, x)
    digits, _, exponent = precision.digits(x).partition("e")
    return (digits if "." in digits else f"{digits}.0") + (f"E{int(exponent)}" if exponent else "")


def literal(precision: Precision, x: float) -> str:
    """The number in an expression: in parentheses if it has a sign."""
    text = plain(precision, x)
    return f"({text})" if text.startswith("-") else text


def _power(target: str, base: str, exponent: str) -> list[str]:
    """Statements for a power; a negative base takes small integer exponents only."""
    whole = exponent.removesuffix(".0")
    if whole.isdigit() and 0 < int(whole) <= 8:
        return [f"{target} := {' * '.join([base] * int(whole))};"]
    return [
        f"IF {base} > 0.0 THEN {target} := EXPT({base}, {exponent});",
        f"ELSIF ({base} < 0.0) OR ({exponent} <= 0.0) THEN RETURN;",
        f"ELSE {target} := 0.0; END_IF;",
    ]
