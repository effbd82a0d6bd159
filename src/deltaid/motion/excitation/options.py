"""What a user may ask of an excitation by name; imports nothing that is slow."""

from typing import Literal

CriterionName = Literal["logdet", "cond", "a-optimal", "e-optimal"]
PurposeName = Literal["torques", "sensors"]
