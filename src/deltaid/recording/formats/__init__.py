"""Kinds of files, one module each: to add one, write its class and put it into `FORMATS`."""

from pathlib import Path
from typing import Protocol

from deltaid.recording.formats.csv import Csv
from deltaid.recording.formats.hdf5 import Hdf5
from deltaid.recording.formats.matlab import Matlab
from deltaid.recording.formats.npy import Npy, Npz
from deltaid.recording.formats.parquet import Parquet
from deltaid.recording.formats.rosbag import RosBag
from deltaid.recording.formats.twincat import TwinCat
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import Table


class Format(Protocol):
    """A kind of file."""

    @property
    def name(self) -> str:
        """What a file of this kind is called, such as 'a Parquet file'."""
        ...

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Ends of names that stand for this kind where no signature is known."""
        ...

    @property
    def unpacks(self) -> bool:
        """Whether it reads files that are compressed as a whole by gzip or zstd."""
        ...

    def claims(self, start: bytes, path: Path) -> bool:
        """Whether a file is of this kind, by its signature.

        Args:
            start: the first 4096 bytes, without compression; empty for a folder.
            path: the file or folder.
        """
        ...

    def open(self, path: Path, mapping: ColumnMapping) -> Table:
        """Read what a file holds, but none of its numbers.

        Raises:
            RecordingError: it is damaged, or a library that reads it is not installed.
        """
        ...


# In the order in which they are asked; CSV, which has no signature, takes what is left.
FORMATS: tuple[Format, ...] = (
    Parquet(),
    Hdf5(),
    Matlab(),
    Npy(),
    Npz(),
    RosBag(),
    TwinCat(),
    Csv(),
)
