"""A surrogate robot with known parameters (Sec. VII), and its recordings as drives log them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.errors import positive
from deltaid.files import write_csv
from deltaid.levels import TORQUE_NOISE
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.one_or_many import numbered
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.sensors.robot_sensors import simulated_sensors

# Friction of Sec. VII for the drives; the slide is not in Sec. VII and has values near Sec. VIII B.
_VISCOUS = {"drive1": 2.0, "drive2": 2.0, "drive3": 2.0, "drive4": 0.5, "slide": 4.0}
_COULOMB = {"drive1": 4.0, "drive2": 4.0, "drive3": 4.0, "drive4": 1.0, "slide": 5.0}
# Largest share of a drive's torque limit for which this Coulomb friction is used; drives for which
# it is more belong to a smaller robot.
_SMALL = 0.1


@runtime_checkable
class Motion(Protocol):
    """Task coordinates over time: a Fourier motion, or a run from rest to rest."""

    def evaluate(
        self, time: Float[np.ndarray, " samples"]
    ) -> tuple[Float[np.ndarray, "samples coordinates"], ...]:
        """z, ż, z̈ at times [s]."""
        ...


@dataclass(frozen=True)
class SensorNoise:
    """Errors of a drive's sensors.

    Attributes:
        torque: standard deviation of white torque noise, as a share of each drive's largest torque.
        encoder_step: resolution of the measured angle [rad].
    """

    torque: float = TORQUE_NOISE
    encoder_step: float = 2 * np.pi / 2**20


def surrogate_parameters(
    robot: RobotDescription, rng: np.random.Generator, spread: float = 0.3
) -> Parameters:
    """True parameters away from the prior, each body still physically consistent.

    Each body's pseudo-inertia matrix becomes G M̄ G with a random diagonal G = diag(e^ε), which
    scales its masses and sizes by about ± spread and keeps its symmetry. Viscous and Coulomb
    friction of a rotary Delta of Sec. VII's size are those of Sec. VII; all other parameters
    deviate from their prior by about ± spread.
    """
    p, layout = prior_parameters(robot), parameter_layout(robot)
    for body in layout.bodies:
        part, G = layout.body(body), np.diag(np.exp(0.5 * spread * rng.uniform(-1, 1, 4)))
        p[part] = RigidBody(p[part]).transformed(G).p
    more = slice(layout.viscous.start, layout.spring.stop)
    efforts = {drive: robot.limits_of(drive).effort or np.inf for drive in robot.drives}
    if not (robot.platform_turns or any(map(robot.is_linear, robot.drives))) and all(
        _COULOMB[drive] <= _SMALL * effort for drive, effort in efforts.items()
    ):  # friction of Sec. VII suits a rotary Delta with drives as strong
        p[layout.viscous] = [_VISCOUS[joint] for joint in robot.friction_joints]
        p[layout.coulomb] = [_COULOMB[joint] for joint in robot.friction_joints]
        more = slice(layout.coulomb.stop, layout.spring.stop)
    p[more] *= np.exp(spread * rng.uniform(-1, 1, more.stop - more.start))
    p[layout.rotor] *= np.exp(spread * rng.uniform(-1, 1, len(robot.rotor_drives)))
    return p


def simulate_recording(
    dynamics: Dynamics,
    p: Parameters,
    motion: Motion,
    rng: np.random.Generator,
    *,
    duration: float = 10.0,
    rate: float = 1000.0,
    noise: SensorNoise | None = None,
    unmodelled: Callable[[Samples], Samples] | None = None,
) -> pl.DataFrame:
    """Time, measured angles and measured torques of a motion: columns t, q1…, tau1….

    Without noise the velocities and accelerations are recorded as well. Readings of the robot's
    sensors are in columns of their default names, with the described noise and unknowns; without
    `noise` they are exact.

    Args:
        unmodelled: torques that the robot's model lacks, a function of the drive speeds q̇.

    Raises:
        KinematicsError: the motion leaves the workspace.
        DeltaidError: duration or rate is not positive.
    """
    positive("duration", duration)
    positive("rate", rate)
    time = np.arange(round(duration * rate)) / rate
    z, zd, zdd = motion.evaluate(time)
    q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd, p)
    if unmodelled is not None:
        tau = tau + unmodelled(qd)
    shown = {"q": q, "qd": qd, "qdd": qdd, "tau": tau}
    if noise is not None:
        noisy = tau + noise.torque * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
        shown = {"q": np.round(q / noise.encoder_step) * noise.encoder_step, "tau": noisy}
    columns = {"t": time} | numbered(**shown)
    if dynamics.robot.sensors:
        columns |= simulated_sensors(dynamics, p, z, qd, qdd, None if noise is None else rng)
    return pl.DataFrame(columns)


def write_recording(recording: pl.DataFrame, path: Path) -> None:
    """Write a recording as CSV, whole or not at all.

    Raises:
        DeltaidError: the file cannot be written.
    """
    write_csv(path, [recording])
