"""The plant of a controller: a robot with effects beyond rigid bodies, and its state under sampled
torques."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import inv

from deltaid.control.simulation import LONGEST_STEP, time_steps
from deltaid.dynamics.forward_dynamics import link_side, motor_inertia, motor_speeds
from deltaid.dynamics.parameters import Parameters, parameter_layout
from deltaid.errors import DeltaidError, DescriptionError
from deltaid.mechanism.kinematics import Samples
from deltaid.model.model import Model
from deltaid.robot.description import RobotDescription

_NUMBER = r"[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?"
_PAYLOAD = re.compile(rf"({_NUMBER})(?:\s*(?:±|\+-|\+/-)\s*({_NUMBER}))?\s*(?:kg)?")
# Least and largest load [kg]; a number outside has another unit.
LOADS = (1e-6, 1e3)


@dataclass(frozen=True, eq=False)
class Held:
    """A load that the robot holds for some time. Drive speeds do not jump when it starts or ends.

    Attributes:
        p: its ten parameters about the link frame of the body that carries it.
        start, end: from when and until when [s].
        body: the body that carries it; None for EE, or P for a robot without EE.
    """

    p: Float[np.ndarray, " 10"]
    start: float = -np.inf
    end: float = np.inf
    body: str | None = None


def point_mass(mass: float) -> Float[np.ndarray, " 10"]:
    """The ten parameters of a mass [kg] at the origin of its carrier."""
    return np.append(mass, np.zeros(9))


@dataclass(frozen=True)
class Payload:
    """A load with an uncertain mass.

    Attributes:
        mass: [kg].
        std: its standard deviation [kg].
    """

    mass: float
    std: float = 0.0

    @property
    def ends(self) -> tuple[float, ...]:
        """Masses two standard deviations off, none below zero; empty for an exact mass."""
        if self.std == 0:
            return ()
        return max(self.mass - 2 * self.std, 0.0), self.mass + 2 * self.std


def as_payload(given: Payload | float | str | None) -> Payload | None:
    """A load from kilograms, or from text such as '1.5±0.1'.

    Raises:
        DeltaidError: it is no mass, or outside of `LOADS`.
    """
    if given is None or isinstance(given, Payload):
        return given
    text = str(given)
    what, cure = "mass", "give kilograms, with a standard deviation or without: 1.5 or 1.5±0.1"
    if match := _PAYLOAD.fullmatch(text.strip()):
        mass, std = float(match[1]), float(match[2] or 0.0)
        if LOADS[0] <= mass <= LOADS[1] and std <= mass:
            return Payload(mass, std)
        what = "load of a robot"
        cure = "give kilograms; the standard deviation is no more than the mass"
    raise DeltaidError(f"'{text[:40]}' is no {what}", where="--payload", cure=cure)


def loaded(robot: RobotDescription, p: Parameters, load: Float[np.ndarray, " 10"]) -> Parameters:
    """p of a robot with a load at its tool, whether its bodies are consistent or not."""
    layout, p = parameter_layout(robot), p.copy()
    p[layout.body(robot.load_carrier)] += load
    return p


@dataclass(frozen=True, eq=False)
class Plant:
    """The robot that a controller moves.

    Attributes:
        model: its bodies and friction.
        loads: loads that it holds, with their times.
        elastic: gears wind up by the description's `gear_stiffness`, with encoders, friction and
            inertia of the motors on the motors' side.
        ripple: torque that drives lose as a function of q, such as cogging.
        damping: of the gears, as a share of critical damping of motor against robot.

    Raises:
        DescriptionError: gears are to wind up, and a drive has no stiffness or no rotor inertia.
    """

    model: Model
    loads: tuple[Held, ...] = ()
    elastic: bool = False
    ripple: Callable[[Samples], Samples] | None = None
    damping: float = 0.03

    def __post_init__(self) -> None:
        robot = self.model.robot
        for drive, inertia in zip(robot.drives, motor_inertia(robot, self.model.p), strict=True):
            stiff = np.isfinite(robot.stiffness(drive))
            if not self.elastic or (stiff and inertia > 0):
                continue
            what = f"nothing says what inertia the motor of {drive} has"
            cure = "give rotor_inertia, kg m² or kg at the joint: an elastic gear needs two sides"
            if not stiff:
                what = f"nothing says how stiff the gear of {drive} is"
                cure = "give gear_stiffness in the plant's description, N m/rad or N/m"
            raise DescriptionError(what, where=self.model.source or robot.name, cure=cure)

    def held(self, time: float) -> tuple[Held, ...]:
        """Loads held at a time [s]."""
        return tuple(load for load in self.loads if load.start <= time < load.end)

    def model_at(self, time: float) -> Model:
        """The model with the loads held at a time [s]."""
        model = self.model
        for load in self.held(time):
            model = model.with_load(load.p, load.body)
        return model

    def carrying(self, mass: float) -> "Plant":
        """The same plant with a permanent mass [kg] at the tool."""
        return replace(self, loads=(Held(point_mass(mass)),))


# Longest time step with elastic gears, as a share of 1/ω of the motor against the robot.
_OF_A_GEAR = 0.2


class Running:
    """State of a plant from sample to sample, as one row.

    With elastic gears each time step is a leapfrog step: positions advance by half a step, speeds
    by a whole step with the springs at these positions, positions by the other half. So without
    damping, oscillations keep their amplitude.

    Attributes:
        z: task coordinates; NaN from where the robot left its workspace.
        qd: velocities of the joints behind the gears.
        encoders: coordinates that the drives measure.
    """

    def __init__(
        self, plant: Plant, q: Samples, qd: Samples, rate: float, current_loop: float
    ) -> None:
        self._plant, self._forward, robot = plant, plant.model.forward, plant.model.robot
        self._lag, self._current = 2 * np.pi * current_loop, None
        loaded, longest, links = plant.model_at(0.0), LONGEST_STEP, q
        self._held, self._p, self._link = plant.held(0.0), loaded.p, link_side(robot, loaded.p)
        if plant.elastic:
            self._k = np.array([robot.stiffness(drive) for drive in robot.drives])
            yielding = inv(loaded.dynamics.mass_matrix(q, self._link)[0], assume_a="pos")
            yielding += np.diag(1 / motor_inertia(robot, loaded.p))
            self._d = 2 * plant.damping * np.sqrt(self._k / np.diagonal(yielding))
            fastest = np.sqrt(np.linalg.eigvals(self._k[:, None] * yielding).real.max())
            longest = min(longest, float(_OF_A_GEAR / fastest))
            self._motors, self._speeds = q, qd
            steady = loaded.dynamics.inverse_dynamics(q, qd, np.zeros_like(q), self._link)
            links = q - steady / self._k
        self._substeps, self._h = time_steps(rate, longest)
        self.z, self.qd = self._forward.kinematics.forward(links), qd

    @property
    def encoders(self) -> Samples:
        """Measured coordinates: of the motors, or of the joints where gears are stiff."""
        return self._motors if self._plant.elastic else self._forward.drive_coordinates(self.z)

    def hold(self, tau: Samples, time: float) -> None:
        """Advance by one sample under requested torques."""
        held, plant = self._plant.held(time), self._plant
        if held != self._held:
            self._held, self._p = held, plant.model_at(time).p
            self._link = link_side(plant.model.robot, self._p)
        for _ in range(self._substeps):
            applied, p = self._mean_torque(tau), self._p
            if plant.ripple is not None:
                applied = applied - plant.ripple(self.encoders)
            if plant.elastic:
                applied, p = self._carried(applied), self._link
            self.z, self.qd = self._forward.step(self.z, self.qd, applied, p, self._h)

    def _carried(self, tau: Samples) -> Samples:
        """Torque between motors and links in the middle of a step."""
        before, faster, h = self._speeds, self._speeds - self.qd, self._h
        wound = self._motors - self._forward.drive_coordinates(self.z) + 0.5 * h * faster
        carried, robot = self._k * wound + self._d * faster, self._plant.model.robot
        self._speeds = motor_speeds(robot, self._p, before, tau, carried, h)
        self._motors = self._motors + 0.5 * h * (before + self._speeds)
        return carried

    def _mean_torque(self, tau: Samples) -> Samples:
        """Mean torque over a time step of the current loop, a first-order lag."""
        if not np.isfinite(self._lag):
            return tau
        last, share = tau if self._current is None else self._current, np.exp(-self._lag * self._h)
        self._current = tau + (last - tau) * share
        return tau + (last - tau) * (1 - share) / (self._lag * self._h)
