"""Limbs of a description, and the geometry of each.

A limb is a drive (an upper arm on a motor, or a carriage on a rail) and a parallelogram of struts
from there to a joint of the platform. Its frame L has x outwards in direction `azimuth_deg`, y
along the motor axis and z up. `tilt_deg` turns L about its x axis (rotary drive: tilts the motor
axis out of the horizontal), or the rail about y of L (linear drive: tilts it out of the vertical).
"""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.robot.part import (
    Axis,
    Coordinate,
    JointKind,
    Length,
    Part,
    Point,
    Positive,
    Radius,
    require_one,
)

Angle = Annotated[float, Field(ge=-180.0, le=180.0)]

# Lengths and angles: one value for all limbs, or a list with one value per limb.
Lengths = Length | tuple[Length, ...]
Radii = Radius | tuple[Radius, ...]
Angles = Angle | tuple[Angle, ...]


@dataclass(frozen=True)
class LimbGeometry:
    """Geometry of one limb; vectors are in the world frame unless stated otherwise.

    Attributes:
        R_WL: rotation from the limb's frame L to the world.
        base: point A of the motor axis in the plane of the arm, or of the rail at q = 0 [m].
        attachment: from the point of the platform part to the middle of the strut joints [m].
        rail: direction of positive q of a linear drive, in L.
        upper_arm: length of the arm [m]; 0 for a linear drive.
        strut: length of the struts [m].
        struts: number of struts.
        outwards: working mode: whether the elbow points outwards (rotary), or the carriage is
            above the platform's joint along the rail (linear).
        root: sign of the square root in the inverse kinematics of the working mode.
        spacing: distance between the two struts [m]; None if unknown, or for a single strut.
    """

    drive: JointKind
    R_WL: Float[np.ndarray, "3 3"]
    base: Float[np.ndarray, " 3"]
    attachment: Float[np.ndarray, " 3"]
    rail: Float[np.ndarray, " 3"]
    upper_arm: float
    strut: float
    struts: int
    outwards: bool
    root: int
    spacing: float | None = None

    def fitting_struts(self, held: Float[np.ndarray, " 3"]) -> tuple[float, float]:
        """Shortest and longest strut that can join the drive to a point `held` in the world [m]."""
        p = self.R_WL.T @ (held - self.base)
        if self.drive == "linear":
            return float(np.linalg.norm(p - (self.rail @ p) * self.rail)), np.inf
        rho, lateral, arm = np.hypot(p[0], p[2]), p[1], self.upper_arm
        return float(np.hypot(lateral, rho - arm)), float(np.hypot(lateral, rho + arm))


class Limbs(Part):
    """All limbs of a robot, alike but for what is given as a list."""

    drive: JointKind = Field(default="rotary", description="arm on a motor, or carriage on a rail")
    azimuth_deg: tuple[Coordinate, ...] = Field(
        min_length=1,
        max_length=4,
        description="direction of each limb about world z, counted from world x, degrees",
    )
    tilt_deg: Angles = Field(
        default=0.0,
        description="rotary: motor axis out of the horizontal, about the limb's x; linear: lower "
        "end of the rail outwards from the vertical, 90 for a horizontal rail; degrees",
    )
    base_radius: Radii | None = Field(
        default=None,
        description="distance of the motor axes, or of the rails' zero points, from the base "
        "centre, m; or give base_points",
    )
    platform_radius: Radii | None = Field(
        default=None,
        description="distance of the strut joints from the point of their platform part, m; or "
        "give platform_points",
    )
    base_points: tuple[Point, ...] | None = Field(
        default=None, description="in place of base_radius: a point for each limb, world, m"
    )
    platform_points: tuple[Point, ...] | None = Field(
        default=None,
        description="in place of platform_radius: strut joints' middle of each limb, from the "
        "point of its platform part, world axes, m",
    )
    upper_arm: Lengths | None = Field(
        default=None, description="rotary drives: length from motor axis to elbow, m"
    )
    strut: Lengths = Field(description="length of the struts between their joints, m")
    struts_per_limb: Literal[1, 2] = Field(default=2, description="2 for a parallelogram")
    strut_spacing: Lengths | None = Field(
        default=None,
        description="distance of the two struts of a parallelogram, m; no motion and no torque "
        "depends on it, but forces in single struts do",
    )
    socket_force: Positive | None = Field(
        default=None,
        description="force of the springs that hold each end of a strut on its ball, N",
    )
    working_mode: Literal["outwards", "inwards"] | tuple[Literal["outwards", "inwards"], ...] = (
        Field(
            default="outwards",
            description="rotary: where the elbow points; linear: outwards has the carriage above "
            "the platform's joint along the rail, inwards below",
        )
    )
    identical: bool = Field(
        default=True,
        description="all limbs share the inertia parameters of U (or C) and S; if not, each has "
        "its own: U1, S1, U2, …",
    )

    @property
    def count(self) -> int:
        """Number of limbs, each with a drive."""
        return len(self.azimuth_deg)

    @model_validator(mode="after")
    def _check(self) -> "Limbs":
        for name in ("tilt_deg", "base_radius", "platform_radius", "base_points",
                     "platform_points", "upper_arm", "strut", "strut_spacing",
                     "working_mode"):  # fmt: skip
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) != self.count:
                raise ValueError(
                    f"{name} has {len(value)} entries, but azimuth_deg has {self.count} limbs"
                )
        require_one(self, "base_radius", "base_points")
        require_one(self, "platform_radius", "platform_points")
        if self.drive == "rotary" and self.upper_arm is None:
            raise ValueError("upper_arm is missing; rotary drives need its length")
        if self.drive == "linear" and self.upper_arm is not None:
            raise ValueError("upper_arm is given, but a linear drive has none; see drive")
        for name in ("strut_spacing", "socket_force"):
            if self.struts_per_limb == 1 and getattr(self, name) is not None:
                raise ValueError(f"{name} is given, but limbs of one strut have no pair of struts")
        widest = np.max(self.strut_spacing or 0.0)
        if widest >= np.min(self.strut):
            raise ValueError(
                f"strut_spacing is {widest:g} m, no less than the struts' length; it is in metres"
            )
        self._check_places()
        return self

    def _check_places(self) -> None:
        """Refuse coincident limbs, directions in radians, and limbs too short to close."""
        if self.base_points is None and self.platform_points is None:
            angles = np.sort(np.mod(self.azimuth_deg, 360.0))
            gaps = np.diff(np.append(angles, angles[0] + 360.0))
            if gaps.min() < 1.0:
                raise ValueError(
                    "two limbs point the same way; azimuth_deg needs distinct directions"
                )
            # Directions that are given in radians lie within 2π "degrees".
            if self.count > 1 and gaps.max() > 360.0 - 2 * np.pi:
                raise ValueError(
                    f"all limbs point the same way within {360.0 - gaps.max():.3g}°; azimuth_deg "
                    "is in degrees"
                )
        limbs = self.geometry()
        for i, limb in enumerate(limbs):
            for j, other in enumerate(limbs[:i]):
                if np.allclose(limb.base, other.base, atol=1e-6) and _parallel(limb, other):
                    what = "rails coincide" if self.drive == "linear" else "drives coincide"
                    raise ValueError(f"the {what}, those of limbs {j + 1} and {i + 1}")
        if self.drive == "linear" or self.base_points is not None or self.platform_points:
            return
        lengths = (self.upper_arm, self.strut, self.base_radius, self.platform_radius)
        identical = not any(isinstance(length, tuple) for length in lengths)
        for i, limb in enumerate(limbs):
            span = abs(np.linalg.norm(limb.base) - np.linalg.norm(limb.attachment))
            if limb.strut + limb.upper_arm <= span:
                whose = "the limbs" if identical else f"limb {i + 1}"
                raise ValueError(
                    f"{whose} cannot close: upper_arm + strut = {limb.upper_arm + limb.strut:g} m, "
                    f"but base_radius and platform_radius differ by {span:g} m"
                )

    def geometry(self) -> tuple[LimbGeometry, ...]:
        """Geometry of each limb, of a platform below its motors."""
        return tuple(self._limb(i) for i in range(self.count))

    def _limb(self, i: int) -> LimbGeometry:
        upright = rotation("z", self.azimuth_deg[i])
        tilt = float(_of_limb(self.tilt_deg, i))
        rotary = self.drive == "rotary"
        R_WL = upright @ rotation("x", tilt) if rotary else upright
        down = rotation("y", -tilt) @ np.array([0.0, 0.0, -1.0])
        outwards = _of_limb(self.working_mode, i) == "outwards"
        return LimbGeometry(
            drive=self.drive,
            R_WL=R_WL,
            base=_point(self.base_points, self.base_radius, upright, i),
            attachment=_point(self.platform_points, self.platform_radius, upright, i),
            rail=down,
            upper_arm=float(_of_limb(self.upper_arm, i)) if rotary else 0.0,
            strut=float(_of_limb(self.strut, i)),
            struts=self.struts_per_limb,
            outwards=outwards,
            root=1 if outwards else -1,
            spacing=None if self.strut_spacing is None else float(_of_limb(self.strut_spacing, i)),
        )


def _parallel(a: LimbGeometry, b: LimbGeometry) -> bool:
    along = [limb.rail if limb.drive == "linear" else np.array([0.0, 1.0, 0.0]) for limb in (a, b)]
    return bool(np.linalg.norm(np.cross(a.R_WL @ along[0], b.R_WL @ along[1])) < 1e-6)


def rotation(axis: Axis, angle_deg: float) -> Float[np.ndarray, "3 3"]:
    """Matrix of a right-handed rotation by an angle about one axis."""
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


def _of_limb(value: Any, i: int) -> Any:
    return value[i] if isinstance(value, tuple) else value


def _point(
    points: tuple[Point, ...] | None, radius: object, upright: Float[np.ndarray, "3 3"], i: int
) -> Float[np.ndarray, " 3"]:
    if points is not None:
        return np.array(points[i])
    return float(_of_limb(radius, i)) * upright[:, 0]
