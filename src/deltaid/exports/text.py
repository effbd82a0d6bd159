"""Text generation: numbers in double and single precision and as pairs of floats, comments, and
templates."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import factorial
from typing import Any
from xml.etree import ElementTree as ET
from xml.sax.saxutils import quoteattr

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from deltaid.mechanism.forward import CLOSED, CLOSED_SINGLE, OTHER_MODE

_PLAIN = {
    "²": "^2", "³": "^3", "·": " ", "−": "-", "–": "-", "⁻": "^-", "¹": "1", "×": "x", "√": "sqrt ",
    "α": "alpha", "β": "beta", "ψ": "psi", "Λ": "Lambda", "Σ": "sum ", "τ": "tau", "ρ": "rho",
    "σ": "sigma", "μ": "mu", "δ": "delta", "∂": "d", "°": " deg", "q̇": "qd", "q̈": "qdd",
}  # fmt: skip


def numbers(values: Iterable[float]) -> str:
    """Numbers separated by spaces, with every bit, without negative zeros."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def attributes(**values: str | float | Sequence[float] | np.ndarray | None) -> str:
    """XML attributes; numbers keep every bit, and None is omitted."""
    written = {
        name: value if isinstance(value, str) else numbers(np.atleast_1d(value))
        for name, value in values.items()
        if value is not None
    }
    return "".join(f" {name}={quoteattr(value)}" for name, value in written.items())


def xml_text(root: ET.Element, head: str = "", comment: str = "") -> str:
    """An XML element with its content as a file, indented.

    Args:
        head: line before the element.
        comment: placed first in the element.
    """
    if comment:
        root.insert(0, ET.Comment(f" {re.sub('-(?=-)', '- ', comment)} "))
    ET.indent(root)
    return f"{head}{ET.tostring(root, encoding='unicode')}\n"


@dataclass(frozen=True)
class Export:
    """An exported model.

    Attributes:
        parts: content by the ending of the file's name; the requested file first.
        warnings: differences of the target from the model.
    """

    parts: Mapping[str, str | bytes]
    warnings: tuple[str, ...] = ()

    def text(self, end: str) -> str:
        """Content of a part that is text."""
        part = self.parts[end]
        return part if isinstance(part, str) else part.decode()


def c_comment(text: str) -> str:
    """Text in which no sequence opens or closes a comment of C."""
    return re.sub(r"([*/])(?=[*/])", r"\1 ", text)


def plain_letters(text: str) -> str:
    """Text in ASCII for all compilers, with readable units and formulas."""
    for letter, plain in _PLAIN.items():
        text = text.replace(letter, plain)
    return text.encode("ascii", "replace").decode()


@dataclass(frozen=True)
class Precision:
    """A floating-point precision.

    Attributes:
        c_type, st_type: its names in C and in structured text.
        suffix: of C's literals and of the functions of math.h.
        closed: distance [m, rad] below which loops count as closed, and by which a pose must be
            inside a limb's reach.
        mode: distance [m] within which rounding may put a limb in its other working mode.
        last: gap [m, rad] from which one more step of Newton's method ends below rounding.
        least: size below which a divisor counts as zero, so that divisions do not overflow.
    """

    c_type: str
    st_type: str
    suffix: str
    closed: float
    mode: float
    last: float
    least: float

    def digits(self, x: float) -> str:
        """The shortest decimal number with every bit; nonzero numbers stay nonzero."""
        if self is DOUBLE:
            return repr(float(x))
        short = np.float32(x)
        return str(short if short or not x else np.copysign(np.finfo(np.float32).tiny, short))

    def c_number(self, x: float) -> str:
        """A literal of C, in parentheses if it has a sign."""
        text = self.digits(x) + self.suffix
        return f"({text})" if text.startswith("-") else text


# A float has 24 bits: coordinates of a metre are known to 1e-7 m, and sums of a few of their
# squares to 1e-6 m².
DOUBLE = Precision("double", "LREAL", "", CLOSED, OTHER_MODE, 1e-9, 1e-150)
SINGLE = Precision("float", "REAL", "f", CLOSED_SINGLE, 1e-5, 1e-6, 1e-18)


_FILES = Environment(
    loader=PackageLoader("deltaid.exports", "templates"),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
    autoescape=False,  # attributes() escapes XML
)
_GLOBALS: dict[str, Any] = {"attr": attributes, "numbers": numbers}
_FILES.globals.update(_GLOBALS)


def rendered(template: str, /, **values: Any) -> str:
    """A template with its values."""
    return _FILES.get_template(template).render(**values)


def rendered_xml(template: str, /, **values: Any) -> ET.Element:
    """A template of XML with its values, without white space between elements."""
    root = ET.fromstring(rendered(template, **values))
    for part in root.iter():
        part.text = part.text if (part.text or "").strip() else None
    return root


# Numbers of terms of Taylor's series about zero, whose remainder up to an eighth of a turn is below
# 1e-14: the leading ones as pairs of floats; all of sine; all of cosine.
_AS_PAIRS, _SINE, _COSINE = 4, 7, 8


@dataclass(frozen=True)
class TaylorSeries:
    """c₀ + z (c₁ + z (…)) with z = x².

    Attributes:
        pairs: the first coefficients, each a float and its rest.
        tail: the other coefficients, floats.
    """

    pairs: tuple[tuple[float, float], ...]
    tail: tuple[float, ...]


def _series(first: int, count: int) -> TaylorSeries:
    """Taylor series of sin(x)/x (first 1) or of cos(x) (first 0)."""
    c = [(-1) ** k / factorial(first + 2 * k) for k in range(count)]
    return TaylorSeries(tuple(map(split, c[:_AS_PAIRS])), tuple(c[_AS_PAIRS:]))


def split(x: float) -> tuple[float, float]:
    """The nearest float of a number, and the difference as another float."""
    return float(np.float32(x)), x - float(np.float32(x))


SINE, COSINE, QUARTER = _series(1, _SINE), _series(0, _COSINE), split(np.pi / 2)


def pairs_of_c(text: str) -> dict[str, object]:
    """Variables of templates/pairs.c.jinja: functions that a text calls, and their constants."""
    names, number = ("sum", "product", "quotient", "root", "sine", "cosine"), SINGLE.c_number
    series = {
        name: (
            [number(x) for pair in series.pairs for x in pair],
            " + z * (".join(map(number, series.tail)) + ")" * (len(series.tail) - 1),
        )
        for name, series in (("sine", SINE), ("cosine", COSINE))
    }
    return {
        "used": {name for name in names if f"pair_{name}(" in text},
        "quarter": [number(x) for x in QUARTER],
        "over_quarter": number(2 / np.pi),
        "series": series,
    }
