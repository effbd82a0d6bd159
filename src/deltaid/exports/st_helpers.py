"""Functions of structured text that the others call."""

from deltaid.exports.precision import Precision
from deltaid.exports.st_statements import literal
from deltaid.exports.st_units import Unit, Variable

# What no coordinate, rate, acceleration or torque of a robot exceeds in SI units; squares of it and
# their products are far from overflow in either precision. And what no result exceeds.
LARGEST_INPUT, LARGEST_RESULT = 1e6, 1e30


def helpers(prefix: str, precision: Precision) -> list[Unit]:
    """PREFIX_sane(x, most) and PREFIX_atan2(y, x)."""
    real = precision.st_type
    sane, atan2 = f"{prefix}_sane", f"{prefix}_atan2"
    pi = [literal(precision, value) for value in (3.141592653589793, 1.5707963267948966)]
    return [
        Unit(
            "FUNCTION",
            sane,
            "BOOL",
            ("Whether x is a number of at most that size: not NaN, not infinite.",),
            (Variable("x", real), Variable("most", real)),
            (),
            (),
            (),
            real,
            (
                f"{sane} := FALSE;",
                "IF x = x THEN",  # the one comparison that NaN stops no controller by
                f"    IF ABS(x) <= most THEN {sane} := TRUE; END_IF;",
                "END_IF;",
            ),
        ),
        Unit(
            "FUNCTION",
            atan2,
            real,
            ("Angle of the point x, y; the first edition of the standard has none.",),
            (Variable("y", real), Variable("x", real)),
            (),
            (Variable("a", real),),
            (),
            real,
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
        ),
    ]
