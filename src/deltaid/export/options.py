"""What a user may export by name; imports nothing that is slow."""

from typing import Literal

TargetName = Literal["c", "mjcf", "urdf", "fmu", "fmu-inverse", "casadi", "npz"]
FmiVersion = Literal["2", "3"]
