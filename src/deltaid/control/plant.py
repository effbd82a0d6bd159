"""What a controller runs on: a robot, and what it does that no model of rigid bodies says."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.known import Parameters
from deltaid.dynamics.motor_side import motor_inertia
from deltaid.dynamics.parameters import parameter_layout
from deltaid.errors import DescriptionError
from deltaid.model.model import Model
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True, eq=False)
class Held:
    """A load that the robot holds for some time; it comes and goes with the platform's velocity.

    Attributes:
        p: its ten parameters about the link frame of what carries it.
        start, end: from when and until when [s].
        body: what carries it; None for EE, or P where there is no EE.
    """

    p: Float[np.ndarray, " 10"]
    start: float = -np.inf
    end: float = np.inf
    body: str | None = None


def point_mass(mass: float) -> Float[np.ndarray, " 10"]:
    """The ten parameters of a mass [kg] at the origin of what carries it."""
    return np.append(mass, np.zeros(9))


@dataclass(frozen=True)
class Payload:
    """A load of a mass that is known more or less.

    Attributes:
        mass: [kg].
        std: its standard deviation [kg].
    """

    mass: float
    std: float = 0.0

    @property
    def ends(self) -> tuple[float, ...]:
        """Masses two standard deviations off, none below zero; nothing where it is exact."""
        if self.std == 0:
            return ()
        return max(self.mass - 2 * self.std, 0.0), self.mass + 2 * self.std


def loaded(robot: RobotDescription, p: Parameters, load: Float[np.ndarray, " 10"]) -> Parameters:
    """p of a robot that holds a load with its tool, whether its bodies can exist or not."""
    layout, p = parameter_layout(robot), p.copy()
    p[layout.body("EE" if "EE" in layout.bodies else "P")] += load
    return p


@dataclass(frozen=True, eq=False)
class DriveRipple:
    """Torque that goes round with a drive, as of cogging and of a gear's teeth.

    τ − amplitude · sin(waves · q + phase) is what moves the robot.

    Attributes:
        amplitude: of each drive [N m or N].
        waves: how far its phase goes on by one radian or metre of the joint [rad].
        phase: [rad].
    """

    amplitude: Float[np.ndarray, " dof"]
    waves: Float[np.ndarray, " dof"]
    phase: Float[np.ndarray, " dof"]


@dataclass(frozen=True, eq=False)
class Plant:
    """A robot as it is.

    Attributes:
        model: its bodies and friction.
        loads: what it holds, and when.
        elastic: gears wind up by the description's `gear_stiffness`, with encoders, friction and
            inertia of the motors on the motors' side.
        ripple: of the drives' torques.
        damping: of the gears, as a share of what is critical for motor against robot.

    Raises:
        DescriptionError: gears are to wind up, and a drive has no stiffness or no rotor inertia.
    """

    model: Model
    loads: tuple[Held, ...] = ()
    elastic: bool = False
    ripple: DriveRipple | None = None
    damping: float = 0.03

    def __post_init__(self) -> None:
        if not self.elastic:
            return
        robot, where = self.model.robot, self.model.source or self.model.robot.name
        inertia = motor_inertia(robot, self.model.p)
        for drive, own in zip(robot.drives, inertia, strict=True):
            if not np.isfinite(robot.stiffness(drive)):
                cure = "give gear_stiffness in the plant's description, N m/rad or N/m"
                what = f"nothing says how stiff the gear of {drive} is"
                raise DescriptionError(what, where=where, cure=cure)
            if not own > 0:
                cure = (
                    "give rotor_inertia, kg m² or kg at the joint: an elastic gear needs two sides"
                )
                what = f"nothing says what inertia the motor of {drive} has"
                raise DescriptionError(what, where=where, cure=cure)

    def held(self, time: float) -> tuple[Held, ...]:
        """What it holds at a time [s]."""
        return tuple(load for load in self.loads if load.start <= time < load.end)

    def model_at(self, time: float) -> Model:
        """The robot with the loads of a time."""
        model = self.model
        for load in self.held(time):
            model = model.with_load(load.p, load.body)
        return model

    def carrying(self, mass: float) -> "Plant":
        """The same with one load, a mass [kg] at the tool that it holds all the time."""
        return replace(self, loads=(Held(point_mass(mass)),))


def as_plant(plant: Model | Plant) -> Plant:
    """A plant; of a model, the robot that it says."""
    return plant if isinstance(plant, Plant) else Plant(plant)
