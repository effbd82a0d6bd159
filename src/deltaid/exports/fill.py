"""The text files that are filled in; they lie beside this module."""

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

_FILES = Environment(
    loader=PackageLoader("deltaid.exports", "templates"),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
    autoescape=False,  # C source; XML is written by ElementTree
)


def rendered(name: str, **values: Any) -> str:
    """A template with its values."""
    return _FILES.get_template(name).render(**values)
