"""Names of export targets and functions; imports nothing slow."""

from typing import Literal, get_args

TargetName = Literal["c", "st", "mjcf", "urdf", "fmu", "fmu-inverse", "casadi", "npz"]
FmiVersion = Literal["2", "3"]
FurtherName = Literal["constraint-forces", "passive-joints", "regressor", "online"]
# Additional functions of code, in the order in which they are written.
FURTHER: tuple[FurtherName, ...] = get_args(FurtherName)
