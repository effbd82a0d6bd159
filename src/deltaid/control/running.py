"""A plant under torques that are held from one sample of its drives to the next."""

import numpy as np
from scipy.linalg import inv

from deltaid.control.plant import Plant
from deltaid.control.simulation import time_steps
from deltaid.dynamics.known import Parameters
from deltaid.dynamics.motor_side import link_side, motor_inertia, motor_speeds
from deltaid.mechanism.kinematics import Samples
from deltaid.model.model import Model

# Longest time step of a gear, as a share of 1/ω of the motor against the robot.
_OF_A_GEAR = 0.2


class Running:
    """The state of a plant from sample to sample, as one row.

    Attributes:
        z: task coordinates; NaN from where the robot left its workspace.
        qd: velocities of the joints behind the gears.
        encoders: coordinates that the drives measure.
    """

    def __init__(
        self, plant: Plant, q: Samples, qd: Samples, rate: float, current_loop: float
    ) -> None:
        self._plant, self._rate = plant, rate
        self._forward = plant.model.forward
        self._lag = 2 * np.pi * current_loop
        self._current: Samples | None = None
        self._held, self._p = plant.held(0.0), plant.model_at(0.0).p
        self._link = link_side(plant.model.robot, self._p)
        self._gear = _Gear(plant, plant.model_at(0.0), q, qd) if plant.elastic else None
        self._substeps, self._h = time_steps(rate)
        if self._gear is not None:
            self._substeps = max(self._substeps, int(np.ceil(1 / (rate * self._gear.longest))))
            self._h = 1 / (rate * self._substeps)
            q = self._gear.links
        self.z, self.qd = self._forward.kinematics.forward(q), qd

    @property
    def encoders(self) -> Samples:
        """Coordinates of the motors, of joints where gears are stiff."""
        if self._gear is not None:
            return self._gear.position
        return self._forward.drive_coordinates(self.z)

    def hold(self, tau: Samples, time: float) -> None:
        """Go on by one sample under torques that the drives are asked for."""
        held = self._plant.held(time)
        if held != self._held:
            self._held, self._p = held, self._plant.model_at(time).p
            self._link = link_side(self._plant.model.robot, self._p)
        for _ in range(self._substeps):
            given = self._given(tau)
            if self._plant.ripple is not None:
                r = self._plant.ripple
                given = given - r.amplitude * np.sin(r.waves * self.encoders + r.phase)
            if self._gear is None:
                self.z, self.qd = self._forward.step(self.z, self.qd, given, self._p, self._h)
            else:
                self._wind(given)

    def _wind(self, given: Samples) -> None:
        """One time step of motors and links, pulled at by what gears carry in its middle."""
        gear, forward = self._gear, self._forward
        assert gear is not None
        carried = gear.carried(forward.drive_coordinates(self.z), self.qd, self._h)
        gear.turn(given, carried, self._p, self._h)
        self.z, self.qd = forward.step(self.z, self.qd, carried, self._link, self._h)

    def _given(self, tau: Samples) -> Samples:
        """Mean torque over a time step behind the current loop, a first-order lag."""
        if not np.isfinite(self._lag):
            return tau
        last = tau if self._current is None else self._current
        share = np.exp(-self._lag * self._h)
        self._current = tau + (last - tau) * share
        return tau + (last - tau) * (1 - share) / (self._lag * self._h)


class _Gear:
    """Motors, and the springs between them and the links.

    Positions go half a step, speeds a whole one by the springs of then, positions the other half:
    so without damping a swing neither grows nor dies down.
    """

    def __init__(self, plant: Plant, loaded: Model, q: Samples, qd: Samples) -> None:
        robot, p = plant.model.robot, loaded.p
        link = link_side(robot, p)
        self._robot, self._k = robot, np.array([robot.stiffness(d) for d in robot.drives])
        yielding = inv(loaded.dynamics.mass_matrix(q, link)[0], assume_a="pos")
        yielding += np.diag(1 / motor_inertia(robot, p))
        self._d = 2 * plant.damping * np.sqrt(self._k / np.diagonal(yielding))
        fastest = np.sqrt(np.linalg.eigvals(self._k[:, None] * yielding).real.max())
        self.longest = float(_OF_A_GEAR / fastest)
        steady = loaded.dynamics.inverse_dynamics(q, qd, np.zeros_like(q), link)
        self.position, self.speed, self.links = q, qd, q - steady / self._k

    def carried(self, q: Samples, qd: Samples, h: float) -> Samples:
        """Torque between motors and links half a step of length h later."""
        faster = self.speed - qd
        return self._k * (self.position - q + 0.5 * h * faster) + self._d * faster

    def turn(self, tau: Samples, carried: Samples, p: Parameters, h: float) -> None:
        """One step of the motors."""
        before = self.speed
        self.speed = motor_speeds(self._robot, p, before, tau, carried, h)
        self.position = self.position + 0.5 * h * (before + self.speed)
