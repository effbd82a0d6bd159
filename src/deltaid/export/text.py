"""Numbers and comments in the text of other languages."""

import re
from collections.abc import Iterable


def numbers(values: Iterable[float]) -> str:
    """Numbers in a row that read back with every bit; no negative zero."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def c_comment(text: str) -> str:
    """Text that neither ends a comment of C nor seems to begin another one."""
    return re.sub(r"([*/])(?=[*/])", r"\1 ", text)


def xml_comment(text: str) -> str:
    """Text that may stand between <!-- and -->."""
    return f" {re.sub('-(?=-)', '- ', text)} "
