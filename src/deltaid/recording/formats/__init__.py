"""Kinds of files, one module each: to add one, write its class and put it into `FORMATS`."""

from deltaid.recording.formats.csv import Csv
from deltaid.recording.formats.format import Format
from deltaid.recording.formats.hdf5 import Hdf5
from deltaid.recording.formats.matlab import Matlab
from deltaid.recording.formats.npy import Npy, Npz
from deltaid.recording.formats.parquet import Parquet
from deltaid.recording.formats.rosbag import RosBag
from deltaid.recording.formats.twincat import TwinCat

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
