"""CSV as people have it: comments, preambles, rows of units, decimal commas, compressed or not."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from deltaid.errors import Doubt
from deltaid.recording.address import Field
from deltaid.recording.formats.csv_layout import CsvLayout, open_csv
from deltaid.recording.formats.csv_text import read_csv
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import Rows, Table


@dataclass(frozen=True)
class Csv:
    """The format."""

    name = "CSV"
    suffixes = ()
    unpacks = True

    def claims(self, start: bytes, path: Path) -> bool:
        """Never: text has no signature."""
        return False

    def open(self, path: Path, mapping: ColumnMapping) -> Table:
        """Its layout."""
        layout = open_csv(path, mapping)
        return CsvTable(
            path,
            tuple(Field(name) for name in layout.header),
            layout,
            first_row=layout.first_row,
            units=layout.units,
            warnings=layout.warnings,
        )


@dataclass(frozen=True)
class CsvTable(Table):
    """An open CSV file, of which a block is in memory at a time."""

    layout: CsvLayout

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """As in `Table.rows`; rows are lines of the file."""
        names = [pick.field.name for pick in self.picks(columns)]
        return read_csv(self.layout, [self.layout.header.index(name) for name in names])

    @property
    def header_place(self) -> str:
        """The line of the names."""
        return self.row_place(self.layout.header_row)

    @property
    def doubts(self) -> list[Doubt]:
        """Lines that may be data behind a comment mark, and an open end."""
        return self.layout.doubts

    def row_place(self, row: int) -> str:
        """One row, counted as an editor counts lines."""
        return self.layout.row_place(row)

    @property
    def cure_of_missing(self) -> str:
        """What to do about a column that is not there."""
        if len(self.fields) == 1:
            return "separate the columns by comma, semicolon, tab or blanks"
        return (
            "rename the columns to t, q1…, tau1… (and qd1…, qdd1… if recorded), or say which is "
            "which with --columns MAPPING.yaml, and in which row (header_row) the names are"
        )

    def cure(self, written: str) -> str:
        """What to do about a field that is no number."""
        return self.layout.cure(written) or super().cure(written)
