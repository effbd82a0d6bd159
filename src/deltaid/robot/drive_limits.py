"""What a drive can do, as a user writes it."""

import numpy as np
from pydantic import Field, model_validator

from deltaid.robot.part import Coordinate, Part, Position, Positive, Speed


class DriveLimits(Part):
    """What one drive can do: a motor in degrees and newton metres, a rail in metres and newtons."""

    angle_deg: tuple[Coordinate, Coordinate] | None = Field(
        default=None, description="lowest and highest angle of a rotary drive, degrees"
    )
    speed_deg_s: Positive | None = Field(
        default=None, description="largest speed of a rotary drive, degrees/s"
    )
    acceleration_deg_s2: Positive | None = Field(
        default=None, description="largest acceleration of a rotary drive, degrees/s²"
    )
    torque: Positive | None = Field(
        default=None, description="largest torque of a rotary drive, N m"
    )
    position: tuple[Position, Position] | None = Field(
        default=None, description="lowest and highest position of a linear drive, m"
    )
    speed: Speed | None = Field(default=None, description="largest speed of a linear drive, m/s")
    acceleration: Positive | None = Field(
        default=None, description="largest acceleration of a linear drive, m/s²"
    )
    force: Positive | None = Field(default=None, description="largest force of a linear drive, N")

    @model_validator(mode="after")
    def _check(self) -> "DriveLimits":
        for name in ("angle_deg", "position"):
            value = getattr(self, name)
            if value is not None and value[0] >= value[1]:
                raise ValueError(f"{name} must be given as [lowest, highest]")
        if self._given(_ROTARY) and self._given(_LINEAR):
            raise ValueError("has limits of a motor and of a rail; a drive is one or the other")
        return self

    def _given(self, names: tuple[str, ...]) -> list[str]:
        return [name for name in names if getattr(self, name) is not None]

    def foreign(self, *, linear: bool) -> list[str]:
        """Keys given that are of the other kind of drive."""
        return self._given(_ROTARY if linear else _LINEAR)

    @property
    def range(self) -> tuple[float, float] | None:
        """Lowest and highest drive coordinate [rad or m]."""
        if self.angle_deg is not None:
            low, high = np.deg2rad(self.angle_deg)
            return float(low), float(high)
        return self.position

    @property
    def top_speed(self) -> float | None:
        """Largest speed [rad/s or m/s]."""
        return float(np.deg2rad(self.speed_deg_s)) if self.speed_deg_s else self.speed

    @property
    def top_acceleration(self) -> float | None:
        """Largest acceleration [rad/s² or m/s²]."""
        in_degrees = self.acceleration_deg_s2
        return float(np.deg2rad(in_degrees)) if in_degrees else self.acceleration

    @property
    def effort(self) -> float | None:
        """Largest torque or force [N m or N]."""
        return self.torque or self.force


_ROTARY = ("angle_deg", "speed_deg_s", "acceleration_deg_s2", "torque")
_LINEAR = ("position", "speed", "acceleration", "force")
