"""Kinds of files, one module each: to add one, write its class and put it into `FORMATS`."""

from deltaid.recording.formats.csv import Csv
from deltaid.recording.formats.format import Format
from deltaid.recording.formats.parquet import Parquet
from deltaid.recording.formats.rosbag import RosBag

# In the order in which they are asked; CSV, which has no signature, takes what is left.
FORMATS: tuple[Format, ...] = (Parquet(), RosBag(), Csv())
