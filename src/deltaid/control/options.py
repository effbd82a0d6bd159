"""What a user may ask of a simulation by name; imports nothing that is slow."""

from typing import Literal

ControllerName = Literal["pd", "pd-feedforward", "computed-torque", "augmented-pd", "slotine-li"]
