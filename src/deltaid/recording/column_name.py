"""What a mapping calls a column by."""

from typing import Annotated

from pydantic import BeforeValidator, Field


def _numbered(value: object) -> object:
    """A column's number as the name that it has in a log without header."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Name = Annotated[
    str,
    BeforeValidator(_numbered, json_schema_input_type=str | int),
    Field(min_length=1, description="as in the log's header; its number from 1 if there is none"),
]
