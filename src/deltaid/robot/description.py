"""What a user writes about a robot: geometry, bodies with priors and reductions, friction, limits.

All lengths are metres, angles degrees where the key ends in `_deg`, everything else SI. Frames are
those of `docs/conventions.md`.
"""

from typing import Annotated, Literal, get_args

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

from deltaid.robot.friction import TERM_KINDS, Friction, FrictionTerm, friction_terms
from deltaid.robot.inertia import (
    PSEUDO_INERTIA_ENTRIES,
    inertia_parameters,
    pseudo_inertia,
    why_inconsistent,
    with_thickness,
)
from deltaid.robot.limbs import Limbs
from deltaid.robot.platform import Platform, RigidPlatform
from deltaid.robot.quantities import (
    Coordinate,
    Mass,
    NotNegative,
    Point,
    Positive,
    Vector,
)
from deltaid.robot.shapes import Shape
from deltaid.robot.workspace import Workspace

Entry = Literal["m", "mcx", "mcy", "mcz", "Sxx", "Syy", "Szz", "Sxy", "Syz", "Sxz"]
TELESCOPE_BODIES = ("TU", "TL", "EE")


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Telescope(_Part):
    """Telescope bar (Cardan axle) from base to platform; adds the rotation ψ as fourth axis."""

    base_joint: Point = Field(
        default=(0.0, 0.0, 0.0), description="centre of the upper universal joint in the world, m"
    )
    platform_joint: Point = Field(
        default=(0.0, 0.0, 0.0),
        description="centre of the lower universal joint from the platform point, m",
    )
    stroke: tuple[float, float] | None = Field(
        default=None, description="shortest and longest distance of the two universal joints, m"
    )

    @model_validator(mode="after")
    def _check(self) -> "Telescope":
        if self.stroke is not None and not 0 < self.stroke[0] < self.stroke[1]:
            raise ValueError("stroke must be given as [shortest, longest], both positive")
        return self


class InertiaTensor(_Part):
    """Entries of the inertia tensor (5) about the link frame's origin, kg m²."""

    xx: NotNegative
    yy: NotNegative
    zz: NotNegative
    xy: Coordinate = 0.0
    yz: Coordinate = 0.0
    xz: Coordinate = 0.0


class ExplicitInertia(_Part):
    """A body given by its numbers: mass, first moment and inertia tensor about the link frame."""

    mass: Mass = Field(description="kg")
    first_moment: Vector = Field(description="mass times centre of mass in the link frame, kg m")
    inertia: InertiaTensor

    def parameters(self) -> Float[np.ndarray, " 10"]:
        """The ten inertia parameters about the link frame."""
        I = self.inertia
        return np.array(
            [self.mass, *self.first_moment, I.xx, I.yy, I.zz, I.xy, I.yz, I.xz], dtype=float
        )

    @classmethod
    def of(cls, p: Float[np.ndarray, " 10"]) -> "ExplicitInertia":
        """A body from its ten inertia parameters."""
        m, x, y, z, *inertia = (float(value) for value in p)
        names = ("xx", "yy", "zz", "xy", "yz", "xz")
        tensor = InertiaTensor(**dict(zip(names, inertia, strict=True)))
        return cls(mass=m, first_moment=(x, y, z), inertia=tensor)


class Body(_Part):
    """A body's prior and which of its ten parameters the identification may change.

    `free` names independent entries of the pseudo-inertia matrix: m, the first moments mcx, mcy,
    mcz, and the second moments Sxx … Sxz (Sxx = ∫x² dm, so Θ_zz = Sxx + Syy). They are the paper's
    α, t1–t3, d1–d3, s12, s23, s13 in that order. First moments and products that are not named are
    zero in the result (Sec. VI a–f); a mass or a second moment that is not named keeps its
    prior, because torques cannot see it, or grows just enough to keep the body consistent. An empty
    list is a body that is known, such as a tool with CAD data (Sec. VI f): all ten stay as given.
    """

    prior: ExplicitInertia | tuple[Shape, ...]
    free: tuple[Entry, ...] = Field(
        default=get_args(Entry),
        description="entries that the identification may change; all ten when left out; [] for a "
        "body that is known and keeps its prior",
    )

    @model_validator(mode="after")
    def _check(self) -> "Body":
        if len(set(self.free)) != len(self.free):
            raise ValueError("free names an entry twice")
        if isinstance(self.prior, tuple) and not self.prior:
            raise ValueError("prior needs at least one shape")
        reason = why_inconsistent(with_thickness(self.prior_parameters()))
        if reason:
            raise ValueError(f"the prior is not a physical body: {reason}")
        return self

    def prior_parameters(self) -> Float[np.ndarray, " 10"]:
        """The ten prior inertia parameters p_reg, before the reduction by `free`."""
        if isinstance(self.prior, ExplicitInertia):
            return self.prior.parameters()
        return np.sum([shape.parameters() for shape in self.prior], axis=0)

    def reduced_prior(self) -> Float[np.ndarray, " 10"]:
        """The prior with the first moments and products that `free` leaves out set to zero.

        Bodies without thickness are made barely solid (`inertia.with_thickness`).
        """
        if not self.free:
            return with_thickness(self.prior_parameters())
        M = pseudo_inertia(self.prior_parameters())
        for name, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
            if i != j and name not in self.free:
                M[i, j] = M[j, i] = 0.0
        return with_thickness(inertia_parameters(M))


class DriveLimits(_Part):
    """What one drive can do: degrees and newton metres for a motor, metres and newtons for a rail."""

    angle_deg: tuple[Coordinate, Coordinate] | None = Field(
        default=None, description="lowest and highest angle of a rotary drive, degrees"
    )
    speed_deg_s: Positive | None = None
    acceleration_deg_s2: Positive | None = None
    torque: Positive | None = Field(default=None, description="N m")
    position: tuple[Coordinate, Coordinate] | None = Field(
        default=None, description="lowest and highest position of a linear drive, m"
    )
    speed: Positive | None = Field(default=None, description="of a linear drive, m/s")
    acceleration: Positive | None = Field(default=None, description="of a linear drive, m/s²")
    force: Positive | None = Field(default=None, description="of a linear drive, N")

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


class RobotDescription(_Part):
    """A Delta robot as a user writes it in YAML."""

    name: str = Field(min_length=1)
    title: str = ""
    gravity: Vector = Field(
        default=(0.0, 0.0, -9.81), description="gravity in the world frame, m/s²"
    )
    limbs: Limbs
    platform: Platform = RigidPlatform()
    telescope: Telescope | None = None
    bodies: dict[str, Body] = Field(
        description="U (or C with linear drives) and S, then those of the platform: P; SB, MB, EE; "
        "MP, R, EE; or HP, EE; and with a telescope TU, TL, EE"
    )
    friction: dict[str, Friction] = Field(
        default_factory=dict,
        description="joints with friction: drive1, drive2, …; platform if it has a joint; slide of a "
        "telescope",
    )
    rotor_inertia: dict[str, Positive] = Field(
        default_factory=dict,
        description="prior inertia of motor and gear reduced to a drive's axis, kg m²",
    )
    workspace: Workspace
    drive_limits: dict[str, DriveLimits] = Field(default_factory=dict)
    platform_speed: Positive = Field(default=5.0, description="largest speed along an axis, m/s")
    platform_acceleration: Positive = Field(
        default=50.0, description="largest acceleration along an axis, m/s²"
    )
    strut_swing_deg: Annotated[float, Field(gt=0, lt=90)] | None = Field(
        default=None,
        description="largest angle between a strut and the plane across its motor axis, which the "
        "cones of its ball joints allow",
    )
    largest_condition: Annotated[float, Field(gt=1)] = Field(
        default=10.0,
        description="distance from singularities: largest ‖J‖_F‖J⁻¹‖_F/δ of a motion, J = ∂q/∂z",
    )
    sources: dict[str, str] = Field(
        default_factory=dict,
        description="where a number comes from, by the path of its key; 'assumed' if from nowhere",
    )

    @property
    def drives(self) -> tuple[str, ...]:
        """Names of the drives, in the order of q."""
        n = self.limbs.count + (self.telescope is not None)
        return tuple(f"drive{i + 1}" for i in range(n))

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies, in the order of p."""
        limbs = [name for i in range(self.limbs.count) for name in self.limb_bodies(i)]
        return (
            *dict.fromkeys(limbs),
            *self.platform.bodies,
            *(TELESCOPE_BODIES if self.telescope else ()),
        )

    def limb_bodies(self, limb: int) -> tuple[str, str]:
        """Names of the driven body and the strut of limb 0, 1, …"""
        own = "" if self.limbs.identical else str(limb + 1)
        driven = "U" if self.limbs.drive == "rotary" else "C"
        return f"{driven}{own}", f"S{own}"

    def is_linear(self, joint: str) -> bool:
        """Whether a joint slides: coordinates in m and forces in N instead of rad and N m."""
        if joint == "platform":
            return self.platform.slides
        limbs = tuple(f"drive{i + 1}" for i in range(self.limbs.count))
        return joint == "slide" or (joint in limbs and self.limbs.drive == "linear")

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of all joints that may have friction."""
        platform = () if isinstance(self.platform, RigidPlatform) else ("platform",)
        return self.drives + platform + (("slide",) if self.telescope else ())

    @property
    def friction_joints(self) -> tuple[str, ...]:
        """Names of the joints with friction, in the order of the joints."""
        return tuple(joint for joint in self.joints if joint in self.friction)

    @property
    def friction_terms(self) -> tuple[FrictionTerm, ...]:
        """All terms of all friction laws in the order of p: by kind, then by joint."""
        terms = [
            term
            for joint in self.friction_joints
            for term in friction_terms(joint, self.friction[joint], sliding=self.is_linear(joint))
        ]
        return tuple(sorted(terms, key=lambda term: TERM_KINDS.index(term.kind)))

    @property
    def load_drives(self) -> tuple[str, ...]:
        """Names of the drives whose friction depends on their own torque."""
        return tuple(term.joint for term in self.friction_terms if term.kind == "load")

    @property
    def rotor_drives(self) -> tuple[str, ...]:
        """Names of the drives with a rotor inertia of their own, in the order of the drives."""
        return tuple(drive for drive in self.drives if drive in self.rotor_inertia)

    @model_validator(mode="after")
    def _check(self) -> "RobotDescription":
        _exactly("bodies", self.bodies, self.body_names)
        _among("friction", self.friction, self.joints)
        for joint, law in self.friction.items():
            if law.load is not None and joint not in self.drives:
                raise ValueError(f"friction.{joint} has a load term, which only drives can have")
        _among("rotor_inertia", self.rotor_inertia, self.drives)
        _among("drive_limits", self.drive_limits, self.drives)
        self._check_drives()
        if not np.any(self.gravity):
            raise ValueError("gravity is zero; give the vector in the world frame, in m/s²")
        return self

    def _check_drives(self) -> None:
        wanted = 3 if isinstance(self.platform, RigidPlatform) else 4
        if self.limbs.count != wanted:
            raise ValueError(
                f"a platform of kind {self.platform.kind} needs {wanted} limbs, but "
                f"limbs.azimuth_deg has {self.limbs.count}"
            )
        if self.telescope is not None and wanted == 4:
            raise ValueError(
                "telescope is given, but the platform turns its tool itself; leave one of them out"
            )
        for drive, limits in self.drive_limits.items():
            foreign = limits.foreign(linear=self.is_linear(drive))
            if foreign:
                kind = "linear" if self.is_linear(drive) else "rotary"
                raise ValueError(f"drive_limits.{drive} has {foreign[0]}, but the drive is {kind}")


def _exactly(key: str, given: dict[str, Body], wanted: tuple[str, ...]) -> None:
    missing = [name for name in wanted if name not in given]
    extra = [name for name in given if name not in wanted]
    if missing or extra:
        parts = [f"lacks {', '.join(missing)}"] if missing else []
        parts += [f"has unknown {', '.join(extra)}"] if extra else []
        raise ValueError(f"{key} {' and '.join(parts)}; this robot has {', '.join(wanted)}")


def _among(key: str, given: dict, allowed: tuple[str, ...]) -> None:
    extra = [name for name in given if name not in allowed]
    if extra:
        raise ValueError(f"{key} has unknown {', '.join(extra)}; choose from {', '.join(allowed)}")
