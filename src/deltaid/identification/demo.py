"""A demonstration on a simulated robot: truth, recordings, identification, errors (Sec. VII)."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled
from deltaid.dynamics.parameters import with_prior
from deltaid.identification.identify import Identification, identify
from deltaid.identification.prediction import validate
from deltaid.identification.torque_error import TorqueError
from deltaid.levels import TORQUE_NOISE
from deltaid.motion.random_motion import random_motion, tamed
from deltaid.motion.surrogate import (
    SensorNoise,
    simulate_recording,
    surrogate_parameters,
    write_recording,
)
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import save_yaml

# What `demonstrate` leaves in its folder.
FILES = ("robot.yaml", "truth.yaml", "identify.csv", "verify.csv", "model.yaml")


@dataclass(frozen=True)
class Demonstration:
    """An identification beside the truth."""

    truth: Parameters
    identification: Identification
    verification: TorqueError  # on a second motion
    # largest relative errors of the entries of M along that motion, as of `mass_matrix_error`
    mass_error_diagonal: float
    mass_error_off_diagonal: float
    friction_error: float  # largest relative error of the friction coefficients


def demonstrate(
    robot: RobotDescription,
    folder: Path,
    *,
    seed: int = 0,
    torque_noise: float = TORQUE_NOISE,
    progress: Callable[[str], None] = lambda _: None,
) -> Demonstration:
    """Simulate, record into `folder`, identify, compare.

    The motions keep every limit of the description with the true parameters, torques with a fifth
    to spare.

    Raises:
        DeltaidError: the folder cannot be written to, or the robot cannot be moved.
    """
    rng, dynamics = np.random.default_rng(seed), compiled(robot)
    progress("simulating two recordings")
    truth, noise = surrogate_parameters(robot, rng), SensorNoise(torque=torque_noise)
    wild = [random_motion(dynamics.kinematics, rng) for _ in range(2)]
    motions = [tamed(dynamics, truth, motion) for motion in wild]
    true_robot = with_prior(robot, truth, name=f"{robot.name}-truth", sources={})
    save_yaml(robot, folder / "robot.yaml")
    save_yaml(true_robot, folder / "truth.yaml")
    for name, motion in zip(("identify", "verify"), motions, strict=True):
        recording = simulate_recording(dynamics, truth, motion, rng, duration=20.0, noise=noise)
        write_recording(recording, folder / f"{name}.csv")
    result = identify(robot, [folder / "identify.csv"], progress=progress)
    progress("verifying")
    verification = validate(result.model, folder / "verify.csv")
    verification.noted(result.model).save(folder / "model.yaml")
    z, _, _ = motions[1].evaluate(np.linspace(0, motions[1].period, 500))
    diagonal, off_diagonal = mass_matrix_error(dynamics, z, truth, result.model.p)
    friction = slice(dynamics.layout.viscous.start, dynamics.layout.coulomb.stop)
    return Demonstration(
        truth=truth,
        identification=result,
        verification=verification.error,
        mass_error_diagonal=diagonal,
        mass_error_off_diagonal=off_diagonal,
        friction_error=float(np.max(np.abs(result.model.p[friction] / truth[friction] - 1))),
    )


def mass_matrix_error(
    dynamics: Dynamics, z: np.ndarray, truth: Parameters, p: Parameters
) -> tuple[float, float]:
    """Largest error of M's entries on and off the diagonal along task coordinates z, relative to
    `mass_reference`."""
    q = dynamics.kinematics.inverse(z)
    M_true, M = dynamics.mass_matrix(q, truth), dynamics.mass_matrix(q, p)
    error = np.abs(M - M_true).max(axis=0) / mass_reference(M_true)
    on = np.eye(dynamics.dof, dtype=bool)
    return float(error[on].max()), float(error[~on].max())


def mass_reference(M: Float[np.ndarray, "samples dof dof"]) -> Float[np.ndarray, "dof dof"]:
    """What errors of each entry of M are compared with: its mean along the motion (Sec. VII).

    Where the entry changes sign, its mean is useless: below a twentieth of √(M_ii M_jj) that size
    takes its place.
    """
    mean = np.abs(M.mean(axis=0))
    size = np.sqrt(np.outer(np.diag(mean), np.diag(mean)))
    return np.where(mean > 0.05 * size, mean, size)
