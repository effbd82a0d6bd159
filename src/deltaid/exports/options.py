"""What a user may export by name; imports nothing that is slow."""

from typing import Literal, get_args

TargetName = Literal["c", "st", "mjcf", "urdf", "fmu", "fmu-inverse", "casadi", "npz"]
FmiVersion = Literal["2", "3"]
FurtherName = Literal["constraint-forces", "passive-joints", "regressor", "online"]
# Functions of code by choice, in the order in which they are written.
FURTHER: tuple[FurtherName, ...] = get_args(FurtherName)
