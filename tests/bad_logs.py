"""A good log as text, and ways to spoil it."""

import polars as pl

from deltaid.recording.mapping import ColumnMapping
from logs import names, recorded, text

ROWS = 300
GOOD = text(recorded(ROWS))
COLUMNS = names("t", "q", "tau")
# Of a log without names.
NUMBERED = ColumnMapping.model_validate(
    {
        "time": {"column": 1},
        "position": [{"column": i, "unit": "rad"} for i in (2, 3, 4)],
        "torque": [{"column": i, "unit": "Nm"} for i in (5, 6, 7)],
    }
)


def with_field(row: int, column: str, value: str, source: str = GOOD) -> str:
    """A log with another text in one field; the row counts as in messages."""
    lines = source.split("\n")
    separator = ";" if ";" in lines[0] else ","
    fields = lines[row - 1].split(separator)
    fields[COLUMNS.index(column)] = value
    lines[row - 1] = separator.join(fields)
    return "\n".join(lines)


def with_line(row: int, line: str) -> str:
    lines = GOOD.split("\n")
    lines[row - 1] = line
    return "\n".join(lines)


def without_rows(first: int, last: int) -> str:
    lines = GOOD.split("\n")
    return "\n".join(lines[: first - 1] + lines[last:])


def changed(**expressions: pl.Expr) -> str:
    return text(recorded(ROWS).with_columns(**expressions))
