"""Numbers and comments in the text of other languages."""

import re
from collections.abc import Iterable

_PLAIN = {
    "²": "^2", "³": "^3", "·": " ", "−": "-", "–": "-", "⁻": "^-", "¹": "1", "×": "x", "√": "sqrt ",
    "α": "alpha", "β": "beta", "ψ": "psi", "Λ": "Lambda", "Σ": "sum ", "τ": "tau", "ρ": "rho",
    "σ": "sigma", "μ": "mu", "δ": "delta", "∂": "d", "°": " deg", "q̇": "qd", "q̈": "qdd",
}  # fmt: skip


def numbers(values: Iterable[float]) -> str:
    """Numbers in a row that read back with every bit; no negative zero."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def c_comment(text: str) -> str:
    """Text that neither ends a comment of C nor seems to begin another one."""
    return re.sub(r"([*/])(?=[*/])", r"\1 ", text)


def xml_comment(text: str) -> str:
    """Text that may stand between <!-- and -->."""
    return f" {re.sub('-(?=-)', '- ', text)} "


def plain_letters(text: str) -> str:
    """Text in the letters that compilers of all kinds take, units and formulas readable."""
    for letter, plain in _PLAIN.items():
        text = text.replace(letter, plain)
    return text.encode("ascii", "replace").decode()
