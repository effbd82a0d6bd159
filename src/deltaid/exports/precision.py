"""Double and single precision in exported code: types, literals, and what rounding leaves open."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Precision:
    """A kind of floating-point numbers.

    Attributes:
        c_type, st_type: its names in C and in structured text.
        suffix: of C's literals and of the functions of math.h.
        closed: distance [m, rad] at which loops count as closed, and by which a pose must be
            inside a limb's reach.
        mode: distance [m] by which rounding may put a limb in its other working mode.
        last: gap [m, rad] from which one more step of Newton's method ends below rounding.
        least: size below which a divisor counts as zero where a division must not overflow.
    """

    c_type: str
    st_type: str
    suffix: str
    closed: float
    mode: float
    last: float
    least: float

    def digits(self, x: float) -> str:
        """The shortest decimal that reads back with every bit; what is not zero stays so."""
        if self is DOUBLE:
            return repr(float(x))
        short = np.float32(x)
        return str(short if short or not x else np.copysign(np.finfo(np.float32).tiny, short))

    def c_number(self, x: float) -> str:
        """A literal of C, in parentheses where it has a sign."""
        text = self.digits(x) + self.suffix
        return f"({text})" if text.startswith("-") else text


# Distances in double precision are those of mechanism.newton and mechanism.forward. A float has 24
# bits: coordinates of a metre are known to 1e-7 m, and sums of a few squares of them to 1e-6 m².
DOUBLE = Precision("double", "LREAL", "", 1e-12, 1e-9, 1e-9, 1e-150)
SINGLE = Precision("float", "REAL", "f", 1e-5, 1e-5, 1e-6, 1e-18)
