"""Functions of structured text that the others call.

Those for numbers that are the sum of two are as templates/pairs.c.jinja has them, one operation a
statement, so that each is rounded to a REAL.
"""

import numpy as np

from deltaid.exports.st_statements import literal
from deltaid.exports.st_units import Unit, Variable
from deltaid.exports.text import COSINE, QUARTER, SINE, SINGLE, Precision, TaylorSeries

# What no coordinate, rate, acceleration or torque of a robot exceeds in SI units; squares of it and
# their products are far from overflow in either precision. And what no result exceeds.
LARGEST_INPUT, LARGEST_RESULT = 1e6, 1e30


def helpers(prefix: str, precision: Precision) -> list[Unit]:
    """PREFIX_sane(x, most) and PREFIX_atan2(y, x)."""
    real, sane, atan2 = precision.st_type, f"{prefix}_sane", f"{prefix}_atan2"
    pi = [literal(precision, value) for value in (3.141592653589793, 1.5707963267948966)]
    return [
        Unit(
            sane,
            "BOOL",
            ("Whether x is a number of at most that size: not NaN, not infinite.",),
            (Variable("x", real), Variable("most", real)),
            (),
            (),
            (
                f"{sane} := FALSE;",
                "IF x = x THEN",  # the one comparison that NaN stops no controller by
                f"    IF ABS(x) <= most THEN {sane} := TRUE; END_IF;",
                "END_IF;",
            ),
            real,
        ),
        Unit(
            atan2,
            real,
            ("Angle of the point x, y; the first edition of the standard has none.",),
            (Variable("y", real), Variable("x", real)),
            (),
            (Variable("a", real),),
            (
                "a := 0.0;",
                "IF ABS(x) >= ABS(y) THEN",
                "    IF ABS(x) > 0.0 THEN a := ATAN(y / x); END_IF;",
                f"    IF (x < 0.0) AND (y < 0.0) THEN a := a - {pi[0]};",
                f"    ELSIF x < 0.0 THEN a := a + {pi[0]}; END_IF;",
                f"ELSIF y > 0.0 THEN a := {pi[1]} - ATAN(x / y);",
                f"ELSE a := -{pi[1]} - ATAN(x / y); END_IF;",
                f"{atan2} := a;",
            ),
            real,
        ),
    ]


# Where products leave no rest that a REAL could hold, or splitting them would overflow.
_SMALL, _LARGE = 1e-20, 1e25
# Adding and taking it off rounds to whole numbers.
_WHOLE = 1.5 * 2.0**23


def pair_functions(prefix: str) -> list[Unit]:
    """PREFIX_pair_sum and so on; c + dc is the result, dc a second output."""
    missing = f"{prefix}_pair_missing"
    return [
        _unit(prefix, "missing", "a b - p without rounding, p being near a b.", "a b p", "", [
            "{name} := 0.0;",
            f"IF (ABS(p) > {_n(_SMALL)}) AND (ABS(p) < {_n(_LARGE)}) THEN",
            f"    IF (ABS(a) < {_n(_LARGE)}) AND (ABS(b) < {_n(_LARGE)}) THEN",
            "        ah := 4097.0 * a; t := ah - a; ah := ah - t; al := a - ah;",
            "        bh := 4097.0 * b; t := bh - b; bh := bh - t; bl := b - bh;",
            "        e := ah * bh; e := e - p; t := ah * bl; e := e + t;",
            "        t := al * bh; e := e + t; t := al * bl; {name} := e + t;",
            "    END_IF;",
            "END_IF;",
        ], "ah al bh bl e t"),
        _unit(prefix, "sum", "a + b.", "a da b db", "dc", [
            "s := a + b; v := s - a; t := s - v; e := a - t; t := b - v; e := e + t;",
            "t := da + db; e := e + t;",
            *_normal("s"),
        ], "s v e t c"),
        _unit(prefix, "product", "a b.", "a da b db", "dc", [
            f"s := a * b; e := {missing}(a := a, b := b, p := s);",
            "t := a * db; v := da * b; t := t + v; e := e + t;",
            *_normal("s"),
        ], "s v e t c"),
        _unit(prefix, "quotient", "a / b; b is not zero.", "a da b db", "dc", [
            f"s := a / b; e := {missing}(a := s, b := b, p := a);",
            "t := s * db; t := da - t; e := t - e; e := e / b;",
            *_normal("s"),
        ], "s e t c"),
        _unit(prefix, "root", "The root of a, which is not negative.", "a da", "dc", [
            "s := SQRT(a); e := 0.0;",
            "IF s > 0.0 THEN",
            f"    e := {missing}(a := s, b := s, p := a); e := da - e; t := s + s; e := e / t;",
            "END_IF;",
            *_normal("s"),
        ], "s e t c"),
        _unit(prefix, "sine", "Sine of the angle a, with b = 1 its cosine.", "a da b", "dc", [
            f"n := {_n(2 / np.pi)} * a; n := n + {_n(_WHOLE)}; n := n - {_n(_WHOLE)};",
            *_call(prefix, "product", ("-n", "0.0", *map(_n, QUARTER)), "x", "dx"),
            *_call(prefix, "sum", ("a", "da", "x", "dx"), "x", "dx"),
            *_call(prefix, "product", ("x", "dx", "x", "dx"), "z", "dz"),
            f"t := 0.25 * n; t := t + {_n(_WHOLE)}; t := t - {_n(_WHOLE)}; t := 4.0 * t;",
            "n := n - t; n := n + b;",
            "IF (n = 1.0) OR (n = 3.0) OR (n = -1.0) THEN",
            *_sum_of(prefix, COSINE),
            "ELSE",
            *_sum_of(prefix, SINE),
            *_call(prefix, "product", ("y", "dy", "x", "dx"), "y", "dy"),
            "END_IF;",
            "IF (n >= 2.0) OR (n < 0.0) THEN y := -y; dy := -dy; END_IF;",
            "{name} := y; dc := dy;",
        ], "n t x dx y dy z dz"),
    ]  # fmt: skip


def _n(x: float) -> str:
    return literal(SINGLE, x)


def _normal(first: str) -> list[str]:
    """The result of a number and what it lacks, e."""
    return [f"c := {first} + e; t := c - {first}; dc := e - t; {{name}} := c;"]


def _call(prefix: str, name: str, given: tuple[str, ...], to: str, rest: str) -> list[str]:
    inputs = ", ".join(f"{x} := {y}" for x, y in zip(("a", "da", "b", "db"), given, strict=False))
    return [f"{to} := {prefix}_pair_{name}({inputs}, dc => {rest});"]


def _sum_of(prefix: str, series: TaylorSeries) -> list[str]:
    *others, last = series.tail
    lines = [f"y := {_n(last)}; dy := 0.0;"]
    lines += [f"y := y * z; y := {_n(c)} + y;" for c in reversed(others)]
    for pair in reversed(series.pairs):
        lines += _call(prefix, "product", ("y", "dy", "z", "dz"), "y", "dy")
        lines += _call(prefix, "sum", (*map(_n, pair), "y", "dy"), "y", "dy")
    return [f"    {line}" for line in lines]


def _unit(
    prefix: str, name: str, note: str, inputs: str, output: str, lines: list[str], own: str
) -> Unit:
    whole, real = f"{prefix}_pair_{name}", SINGLE.st_type
    variables = [[Variable(x, real) for x in names.split()] for names in (inputs, output, own)]
    body = [line.replace("{name}", whole) for line in lines]
    return Unit(whole, real, (note,), *variables, body, real)
