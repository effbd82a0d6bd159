"""Description of a robot: geometry, bodies with priors and reductions, friction, limits.

Keys that end in `_deg` are in degrees, all others in SI units. `docs/conventions.md` defines the
frames.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.levels import GRAVITY
from deltaid.robot.body import Body
from deltaid.robot.fitting_parts import require_parts_that_fit
from deltaid.robot.friction import Friction
from deltaid.robot.friction_terms import FrictionTerm, friction_terms
from deltaid.robot.limbs import LimbGeometry, Limbs
from deltaid.robot.limits import NAMES, DriveLimits, Task, Workspace
from deltaid.robot.measured import MeasuredTogether
from deltaid.robot.own import OwnMechanism
from deltaid.robot.parameter import SLIDING, TURNING, JointUnits
from deltaid.robot.part import (
    TOOL_SPEED,
    Acceleration,
    Coordinate,
    Gravity,
    JointKind,
    Part,
    Position,
    Positive,
    Speed,
)
from deltaid.robot.platform import Platform, RigidPlatform, Telescope
from deltaid.robot.sensors import Sensor
from deltaid.robot.tolerances import Tolerances
from deltaid.shown import Plotted, Reported, Shown

TELESCOPE_BODIES = ("TU", "TL", "EE")


class Spring(Part):
    """A linear spring across a joint: force on the joint −stiffness · (ϑ − rest)."""

    stiffness: Positive = Field(description="prior, N m/rad, or N/m in a sliding joint")
    rest_deg: Coordinate | None = Field(
        default=None, description="joint angle without force, degrees; for turning joints"
    )
    rest: Position | None = Field(
        default=None, description="joint position without force, m; for sliding joints"
    )


@dataclass(frozen=True)
class TurnLimits:
    """Limits of the tool's angle ψ [rad], its speed [rad/s] and its acceleration [rad/s²]; without
    a described range it turns without end, and `low` and `high` are one turn."""

    low: float
    high: float
    speed: float
    acceleration: float
    has_range: bool


class RobotDescription(Shown, Plotted, Reported, Part):
    """A Delta robot as a user writes it in YAML."""

    name: str = Field(min_length=1, description="short, as in names of files")
    title: str = Field(default="", description="what it is, as in headings")
    gravity: Gravity = Field(
        default=(0.0, 0.0, -GRAVITY), description="gravity in the world frame, m/s²"
    )
    limbs: Limbs | None = Field(
        default=None, description="drives and struts that hold the platform"
    )
    mechanism: OwnMechanism | None = Field(
        default=None, description="in place of limbs and platform: a geometry in a Python file"
    )
    platform: Platform = Field(
        default=RigidPlatform(),
        description="what the struts hold: one part, or parts that turn a tool",
    )
    telescope: Telescope | None = Field(
        default=None, description="a bar from base to platform that turns the tool"
    )
    bodies: dict[str, Body] = Field(
        description="U (or C with linear drives) and S, then those of the platform: P; SB, MB, EE; "
        "MP, R, EE; or HP, EE; and with a telescope TU, TL, EE"
    )
    friction: dict[str, Friction] = Field(
        default_factory=dict,
        description="joints with friction: drive1, drive2, …; platform if it has a joint; slide "
        "of a telescope",
    )
    springs: dict[str, Spring] = Field(
        default_factory=dict, description="joints with a spring, by the same names"
    )
    rotor_inertia: dict[str, Positive] = Field(
        default_factory=dict,
        description="prior inertia of motor and gear reduced to a drive, kg m², or kg for a rail",
    )
    gear_stiffness: Positive | dict[str, Positive] = Field(
        default_factory=dict[str, Positive],
        description="what gears carry over how far they wind up, where encoders are on the motors, "
        "N m/rad, or N/m for a rail: of all drives or by drive; estimated where not given",
    )
    tolerances: Tolerances = Field(
        default=Tolerances(),
        description="how well lengths, zeros of drives and the direction of gravity are known",
    )
    measured: tuple[MeasuredTogether, ...] = Field(
        default=(), description="measured values of several bodies together, or of one"
    )
    sensors: dict[str, Sensor] = Field(
        default_factory=dict[str, Sensor],
        description="sensors beside the drives' torques, by names that mappings use too",
    )
    workspace: Workspace = Field(description="where the platform point may go")
    drive_limits: dict[str, DriveLimits] = Field(
        default_factory=dict, description="what each drive can do: drive1, drive2, …"
    )
    platform_speed: Speed = Field(default=5.0, description="largest speed along an axis, m/s")
    platform_acceleration: Acceleration = Field(
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
        """Names of all drives, in the order of q."""
        n = len(self._drive_kinds) + (self.telescope is not None)
        return tuple(f"drive{i + 1}" for i in range(n))

    @property
    def identical_drives(self) -> tuple[str, ...]:
        """Names of the drives of identical limbs, which come first in q; empty if limbs differ."""
        if self.limbs is None or not self.limbs.identical:
            return ()
        return self.drives[: self.limbs.count]

    @property
    def label(self) -> str:
        """Title in headings: the described one, or the name."""
        return self.title or self.name

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of all bodies, in the order of p."""
        if self.mechanism is not None:
            return self.mechanism.bodies
        count = self.limbs.count if self.limbs is not None else 0
        limbs = [name for i in range(count) for name in self.limb_bodies(i)]
        return (
            *dict.fromkeys(limbs),
            *self.platform.bodies,
            *(TELESCOPE_BODIES if self.telescope else ()),
        )

    @property
    def load_carrier(self) -> str:
        """Name of the body that carries a load: EE, else P; empty if a user-defined mechanism has
        neither."""
        return next((name for name in ("EE", "P") if name in self.body_names), "")

    def limb_bodies(self, limb: int) -> tuple[str, str]:
        """Names of the driven body and of the struts of a limb (0, 1, …)."""
        number = "" if self.limbs is None or self.limbs.identical else str(limb + 1)
        driven = "U" if self._drive_kinds[limb] == "rotary" else "C"
        return f"{driven}{number}", f"S{number}"

    @property
    def limb_geometry(self) -> tuple[LimbGeometry, ...]:
        """Geometry of each limb; empty for a user-defined mechanism."""
        centre, _ = self.workspace.inner_box
        limbs = self.limbs.geometry() if self.limbs is not None else ()
        return tuple(
            replace(limb, root=-limb.root)  # arms point outwards below the platform, too
            if limb.upper_arm and limb.R_WL[:, 2] @ (centre + limb.attachment - limb.base) > 0
            else limb
            for limb in limbs
        )

    @property
    def _drive_kinds(self) -> tuple[JointKind, ...]:
        """Kind of each drive, except the telescope's."""
        if self.mechanism is not None:
            return self.mechanism.drives
        return (self.limbs.drive,) * self.limbs.count if self.limbs is not None else ()

    @property
    def platform_turns(self) -> bool:
        """Whether the platform turns the tool by ψ itself, without a telescope."""
        if self.mechanism is not None:
            return self.mechanism.task.turn is not None
        return not isinstance(self.platform, RigidPlatform)

    def limits_of(self, drive: str) -> DriveLimits:
        """Limits of a drive; all are None if the description has none."""
        return self.drive_limits.get(drive, DriveLimits())

    def is_linear(self, joint: str) -> bool:
        """Whether a joint slides: its units are m and N instead of rad and N m."""
        if self.mechanism is not None and joint in self.mechanism.joints:
            return self.mechanism.joints[joint] == "linear"
        if joint == "platform":
            return self.platform.slides
        kinds = {f"drive{i + 1}": kind for i, kind in enumerate(self._drive_kinds)}
        return joint == "slide" or kinds.get(joint) == "linear"

    @property
    def linear_drives(self) -> tuple[bool, ...]:
        """Whether each drive slides, in the order of q."""
        return tuple(self.is_linear(drive) for drive in self.drives)

    def units(self, joint: str) -> JointUnits:
        """Units and words of a joint."""
        return SLIDING if self.is_linear(joint) else TURNING

    @property
    def drive_units(self) -> dict[str, JointUnits]:
        """Units and words of each drive, in the order of q."""
        return {drive: self.units(drive) for drive in self.drives}

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of all joints that may have friction."""
        if self.mechanism is not None:
            return self.drives + tuple(self.mechanism.joints)
        platform = () if isinstance(self.platform, RigidPlatform) else ("platform",)
        return self.drives + platform + (("slide",) if self.telescope else ())

    @property
    def turn(self) -> "TurnLimits":
        """Range, speed and acceleration limits of the tool's angle ψ."""
        p = self.mechanism or self.platform
        if self.platform_turns and not isinstance(p, RigidPlatform):
            low, high = np.deg2rad(p.angle_deg)
            speed, acceleration = np.deg2rad([p.speed_deg_s, p.acceleration_deg_s2])
            return TurnLimits(float(low), float(high), float(speed), float(acceleration), True)
        limits = self.limits_of("drive4")
        low, high = limits.range or (-np.pi, np.pi)
        speed, most = limits.top_speed or float(np.deg2rad(TOOL_SPEED)), limits.top_acceleration
        return TurnLimits(low, high, speed, most or np.inf, limits.range is not None)

    @property
    def task(self) -> Task:
        """Names of the task coordinates z."""
        return self.mechanism.task if self.mechanism else Task(NAMES[: len(self.drives)])

    @property
    def home(self) -> Float[np.ndarray, " dof"]:
        """Middle of the workspace as z [m, rad]; ψ is the middle of its range, or 0."""
        middle = 0.5 * (self.turn.low + self.turn.high) if self.turn.has_range else 0.0
        return self.within(middle)[0]

    def within(
        self, middle: float, half: float = 0.0
    ) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
        """Middle and half extents of z [m, rad] in a box inside the workspace.

        Args:
            middle: middle of ψ [rad].
            half: half extent of ψ [rad].
        """
        centre, size = map(self.task.of_point, self.workspace.inner_box)
        turns = self.task.turn is not None
        return np.append(centre, [middle] * turns), np.append(size, [half] * turns)

    @property
    def friction_joints(self) -> tuple[str, ...]:
        """Names of the joints with friction, in the order of the joints."""
        return tuple(joint for joint in self.joints if joint in self.friction)

    @cached_property
    def friction_terms(self) -> tuple[FrictionTerm, ...]:
        """Terms of all friction laws in the order of p: by kind, then by joint."""
        laws = {joint: (self.friction[joint], self.units(joint)) for joint in self.friction_joints}
        return friction_terms(laws)

    @property
    def spring_joints(self) -> tuple[str, ...]:
        """Names of the joints with a spring, in the order of the joints."""
        return tuple(joint for joint in self.joints if joint in self.springs)

    def spring_rest(self, joint: str) -> float:
        """Joint coordinate at which a spring has no force [rad or m]."""
        spring = self.springs[joint]
        if self.is_linear(joint):
            return spring.rest or 0.0
        return float(np.deg2rad(spring.rest_deg or 0.0))

    @cached_property
    def load_drives(self) -> tuple[str, ...]:
        """Names of the drives whose friction depends on the load of their gear."""
        return tuple(term.joint for term in self.friction_terms if term.of_load)

    @property
    def rotor_drives(self) -> tuple[str, ...]:
        """Names of the drives with a rotor inertia, in the order of the drives."""
        return tuple(drive for drive in self.drives if drive in self.rotor_inertia)

    def stiffness(self, drive: str) -> float:
        """Stiffness of a drive's gear [N m/rad or N/m]; infinite by default."""
        given = self.gear_stiffness
        return given.get(drive, np.inf) if isinstance(given, dict) else given

    @model_validator(mode="after")
    def _check(self) -> "RobotDescription":
        require_parts_that_fit(self)
        return self
