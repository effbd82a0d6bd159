"""Kinds of files, one module each: to add one, write how it is opened and put it into `FORMATS`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from deltaid.recording.formats.arrays import is_npz, open_npy, open_npz
from deltaid.recording.formats.bag_reader import is_bag
from deltaid.recording.formats.csv import open_csv
from deltaid.recording.formats.frames import open_parquet
from deltaid.recording.formats.hdf5 import is_hdf5, open_hdf5
from deltaid.recording.formats.matlab import is_matlab, open_matlab
from deltaid.recording.formats.rosbag import open_bag
from deltaid.recording.formats.twincat import is_scope, open_scope
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import LogTable


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes:
        name: what a file of this kind is called, such as 'a Parquet file'.
        claims: whether a file is of this kind, by its signature: takes the first 4096 bytes,
            without compression, empty for a folder; and the file or folder.
        open: reads what a file holds, but none of its numbers. Raises a RecordingError if it is
            damaged, or a library that reads it is not installed.
        suffixes: ends of names that stand for this kind where no signature is known.
        unpacks: whether it reads files that are compressed as a whole by gzip or zstd.
    """

    name: str
    claims: Callable[[bytes, Path], bool]
    open: Callable[[Path, ColumnMapping], LogTable]
    suffixes: tuple[str, ...] = ()
    unpacks: bool = False


# In the order in which they are asked; CSV, which has no signature, takes what is left.
FORMATS = (
    Format(
        "a Parquet file",
        lambda start, _: start.startswith(b"PAR1"),
        open_parquet,
        (".parquet", ".pq"),
    ),
    Format("an HDF5 file", is_hdf5, open_hdf5, (".h5", ".hdf5", ".hdf", ".he5", ".nc")),
    Format("a MATLAB file", is_matlab, open_matlab, (".mat",)),
    Format("a NumPy file", lambda start, _: start.startswith(b"\x93NUMPY"), open_npy, (".npy",)),
    Format("a NumPy archive", is_npz, open_npz, (".npz",)),
    Format("a ROS bag", is_bag, open_bag, (".bag", ".db3", ".mcap"), unpacks=True),
    Format("an export of TwinCAT Scope", is_scope, open_scope, unpacks=True),
    Format("CSV", lambda *_: False, open_csv, unpacks=True),
)
