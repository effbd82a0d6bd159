"""MATLAB files of versions 5 to 7; those of 7.3 are HDF5."""

import mmap
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from deltaid.errors import RecordingError
from deltaid.recording.address import Pick, RecordedField
from deltaid.recording.formats.arrays import Arrays, ArrayTable
from deltaid.recording.formats.matlab_elements import (
    DamagedMatError,
    MatVariable,
    Numbers,
    contents,
    variables,
)
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import BATCH_ROWS, LogTable, opened


def is_matlab(start: bytes, path: Path) -> bool:
    """Whether the header is one of MATLAB."""
    return start.startswith(b"MATLAB") or start[126:128] in (b"IM", b"MI")


def open_matlab(path: Path, mapping: ColumnMapping) -> LogTable:
    """A MATLAB file before 7.3: its variables, and what structs and cells hold."""
    fields: list[RecordedField] = []
    places: dict[str, tuple[MatVariable, Numbers]] = {}
    with _mapped(path) as data:
        for variable in variables(data):
            for name, held in contents(data, variable):
                if isinstance(held, Numbers):
                    fields.append(RecordedField(name, held.shape, is_truth=held.dtype == "?"))
                    places.setdefault(name, (variable, held))
                else:
                    fields.append(held)
    return ArrayTable(path, tuple(fields), partial(_arrays, path, places))


@contextmanager
def _arrays(
    path: Path, places: Mapping[str, tuple[MatVariable, Numbers]], picks: Sequence[Pick]
) -> Generator[Arrays, None, None]:
    """Variables of some columns: compressed ones are in memory, others in the file."""
    used = {pick.field.name: places[pick.field.name] for pick in picks}
    with _mapped(path) as data:
        unpacked = {variable: variable.unpacked(data) for variable, _ in used.values()}
        arrays = {
            name: numbers.array(unpacked[variable]) for name, (variable, numbers) in used.items()
        }
        yield arrays, BATCH_ROWS


@contextmanager
def _mapped(path: Path) -> Generator[memoryview, None, None]:
    """The bytes of a file, which are read when they are used.

    Raises:
        RecordingError: it is damaged, with the place.
    """
    with opened(path) as file:
        # Arrays cut out of the map keep it, so it is closed when they are gone.
        data = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        try:
            yield data
        except DamagedMatError as error:
            raise RecordingError(
                f"is a damaged MATLAB file: {error}",
                where=str(path),
                cure="copy it again, or save it again with save('log.mat', '-v7')",
            ) from None
