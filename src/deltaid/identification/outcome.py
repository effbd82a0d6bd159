"""What a contest of causes came to, for the stages after it and for the model."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from deltaid.effects.all import UNKNOWNS
from deltaid.model.inseparable import Inseparable
from deltaid.robot.description import RobotDescription

WIND_UP = "compliance"

Coefficients = Float[np.ndarray, " coefficients"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What won a contest.

    Attributes:
        described: the robot as it is described.
        kept: names of effects.
        values, deviations: of those that are applied exactly.
        moves: what parameters of the robot, by name, move by where these are off as they may be,
            or where another cause takes the place of one of them: one standard deviation each.
        inseparable: causes that rows do not separate.
        doubts: sentences, by effect, on what is beyond all that a description may be off by.
    """

    described: RobotDescription
    kept: tuple[str, ...] = ()
    values: dict[str, Coefficients] = field(default_factory=dict[str, Coefficients])
    deviations: dict[str, Coefficients] = field(default_factory=dict[str, Coefficients])
    moves: tuple[dict[str, float], ...] = ()
    inseparable: tuple[Inseparable, ...] = ()
    doubts: dict[str, str] = field(default_factory=dict[str, str])

    @property
    def read(self) -> dict[str, Coefficients]:
        """Those that recordings have been corrected by."""
        robot = [unknown.name for unknown in UNKNOWNS if unknown.corrects == "robot"]
        return {name: values for name, values in self.values.items() if name not in robot}

    def within_limits(self) -> "Outcome":
        """Without effects that are beyond their limits, and with doubts in their place."""
        beyond = {
            unknown.name: unknown.doubt(self.values[unknown.name])
            for unknown in UNKNOWNS
            if unknown.name in self.values
            and np.linalg.norm(self.values[unknown.name]) > unknown.limit
        }
        values = {name: value for name, value in self.values.items() if name not in beyond}
        kept = tuple(name for name in self.kept if name not in beyond)
        return replace(self, kept=kept, values=values, doubts=self.doubts | beyond)

    @property
    def winds_up(self) -> bool:
        """Whether rows need gears that wind up beside all else."""
        return WIND_UP in self.values

    def of(self, name: str) -> tuple[float, ...]:
        return tuple(self.values.get(name, np.zeros(0)).tolist())
