"""Tolerances of a description: of geometry, gravity's direction and torque constants.

Each is one standard deviation: about a third of all machines deviate more.
"""

from typing import Annotated

from pydantic import Field

from deltaid.robot.part import Part, limited, schema_limits

# Largest tolerances of lengths [m], angles [rad] and shares: larger ones are in a wrong unit
# (millimetres, degrees, per cent).
_LONG, _WIDE, _UNSURE = 0.05, 0.2, 0.5
# Defaults of a well-made robot: parts to a tenth of a millimetre [m], zeros set with a gauge [rad
# or m], base levelled with a machinist's level [rad].
_LENGTH, _ZERO, _TILT = 5e-5, 1e-4, 2e-4
# Largest tilt of a base that was levelled by eye [rad], and largest error of a zero that was set by
# eye [rad or m]: a larger one is a wrong description, or something pulls at the robot.
BY_EYE = 0.05


LengthTolerance = Annotated[
    float,
    limited(0.0, _LONG, "{:g} m is no tolerance of a length; it is in metres"),
    schema_limits(minimum=0.0, maximum=_LONG),
]
AngleTolerance = Annotated[
    float,
    limited(0.0, _WIDE, "{:g} is no tolerance of an angle in rad, or of a rail in m"),
    schema_limits(minimum=0.0, maximum=_WIDE),
]
ShareTolerance = Annotated[
    float,
    limited(0.0, _UNSURE, "{:g} is no tolerance of a torque constant; 0.03 stands for 3 %"),
    schema_limits(minimum=0.0, maximum=_UNSURE),
]

# Kinds of lengths whose tolerance may be given by name.
LENGTHS = ("base_radius", "platform_radius", "upper_arm", "strut", "platform", "telescope")


class Tolerances(Part):
    """How far lengths, zeros of drives, the direction of gravity and torque constants may be off,
    one standard deviation each; intervals of identified parameters take them in."""

    lengths: LengthTolerance | dict[str, LengthTolerance] = Field(
        default=_LENGTH,
        description="of distances between joints, m; or by name: base_radius, platform_radius "
        "(or points), upper_arm, strut, platform (half_length, length), telescope. A number that "
        "stands for all limbs may be off for all, and each limb from it by as much again",
    )
    homing: AngleTolerance | dict[str, AngleTolerance] = Field(
        default=_ZERO,
        description="of each drive's zero, rad, or m for a rail; or by drive: drive1, drive2, …",
    )
    mounting: AngleTolerance = Field(
        default=_TILT,
        description="of the base's tilt against gravity, rad, about each of two axes",
    )

    torque_constants: ShareTolerance = Field(
        default=0.0,
        description="of the drives' torque constants, as a share (0.03 for 3 %): off for all, "
        "and each drive from that by as much again; 0 takes what a drive records for N m. "
        "Of no effect where a known load or a sensor determines them",
    )

    def of_length(self, name: str) -> float:
        """Standard deviation of one kind of length [m]."""
        return self.lengths.get(name, _LENGTH) if isinstance(self.lengths, dict) else self.lengths

    def of_drive(self, name: str) -> float:
        """Standard deviation of a drive's zero [rad or m]."""
        return self.homing.get(name, _ZERO) if isinstance(self.homing, dict) else self.homing

    @property
    def exact(self) -> bool:
        """Whether all tolerances are zero."""
        by_name = (
            sizes.values() if isinstance(sizes, dict) else [sizes]
            for sizes in (self.lengths, self.homing)
        )
        given = [size for sizes in by_name for size in sizes]
        return not (any(given) or self.mounting or self.torque_constants)
