"""Six kinds of robot with bodies that differ from their priors; one has a random size and rate.

True bodies are M̄ = G M̄_prior G with a random diagonal G, shifted along the axes on which the
description leaves their first moment free, so no true body is symmetric unless described so. The
tool is larger than described. Friction of the linear robot is lower than in the catalogue, because
otherwise noise of 2 % of the largest torque would hide its masses.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any
from zlib import crc32

import numpy as np

from deltaid.dynamics.parameters import ParameterLayout, parameter_layout
from deltaid.mechanism.kinematics import Kinematics
from deltaid.motion.excitation.excite import ExcitationSettings
from deltaid.motion.random_motion import random_motion
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import inertia_parameters, pseudo_inertia
from deltaid.robot.load import load_robot
from drives.motions import excited
from oracle.tree import Array
from plants import GRID, Plant, even_pace, friction_of, log_uniform, oracle_of, true_parameters

# The catalogue robot of each kind; `resized` is Clavel's robot, scaled to half to twice its size.
KINDS = {
    "delta3": "clavel-delta3",
    "delta4": "irb360-6-1600",
    "linear": "linear-delta",
    "h4": "h4",
    "par4": "par4",
    "resized": "clavel-delta3",
}
# Shift of a true body's centre along a free axis, as a share of its radius of gyration.
_OFF = 0.1
_POSES = 40


@dataclass(frozen=True, eq=False)
class Machine:
    """A true robot on a path of period `period` (s), without the friction of its drives.

    Attributes:
        robot: its description.
        plant: bodies, rotors and friction of passive joints; its p includes the drives' friction.
        viscous, coulomb: friction of the drives.
        rate: sampling rate of the drives (Hz).
        poses: z of 40 poses of another motion.
        M: the true mass matrix at these poses.
        largest_speed, largest_torque: of each drive along the path, without its friction.
    """

    robot: RobotDescription
    plant: Plant
    period: float
    viscous: Array
    coulomb: Array
    rate: float
    poses: Array
    M: Array
    largest_speed: Array
    largest_torque: Array

    @property
    def layout(self) -> ParameterLayout:
        """Parameter layout of the description."""
        return parameter_layout(self.robot)

    @property
    def dof(self) -> int:
        """Number of drives."""
        return len(self.viscous)

    @property
    def rotary(self) -> Array:
        """Whether each drive is rotary."""
        return np.array([not self.robot.is_linear(drive) for drive in self.robot.drives])


@lru_cache(maxsize=4)
def machine(kind: str, seed: int, poor: bool = False) -> Machine:
    """A robot of a kind on a motion of `deltaid excite`.

    Args:
        poor: whether bodies are clouds of points, and priors wrong by a factor of 2 to 20.
    """
    rng = np.random.default_rng([seed, crc32(kind.encode())])
    robot = load_robot(KINDS[kind])
    if kind == "resized":
        robot = resized(robot, log_uniform(rng, 0.5, 2.0))
    if poor:
        p = _clouds(robot, rng)
        robot = _poor_priors(robot, rng)
    else:
        p = _moved(robot, true_parameters(robot, rng), rng)
        if "EE" in robot.bodies:
            part = parameter_layout(robot).body("EE")
            G = np.diag([*np.full(3, rng.uniform(3, 4)), 1.2])
            p[part] = inertia_parameters(G @ pseudo_inertia(p[part]) @ G)
        if kind == "linear":
            p[parameter_layout(robot).friction] *= 0.4
    name = f"{kind}-{seed}" + "-poor" * poor
    settings = ExcitationSettings(starts=1, seed=seed, duration=float(rng.uniform(10, 20)))
    motion = excited(name, robot, settings).motion
    rate = float(rng.choice([500.0, 1000.0, 2000.0])) if kind == "resized" else 1000.0
    path, _, _ = motion.evaluate(np.arange(GRID) * (motion.period / GRID))
    return on_path(robot, p, path, motion.period, rate, rng)


def on_path(
    robot: RobotDescription, p: Array, path: Array, period: float, rate: float,
    rng: np.random.Generator,
) -> Machine:  # fmt: skip
    """A robot with parameters p on a path."""
    friction, dof = friction_of(robot, p), len(robot.drives)
    passive = friction.copy()
    passive[:, :dof] = 0.0
    plant = Plant(oracle_of(robot, p), passive, path, p)
    other = random_motion(Kinematics(robot), rng)
    poses, _, _ = other.evaluate(np.linspace(0, other.period, _POSES, endpoint=False))
    M = np.array([plant.oracle.mass_matrix(z) for z in poses])
    time = np.linspace(0, period, 4 * len(path))
    moved = plant.move(even_pace(time, period), rng)
    return Machine(robot, plant, period, friction[0, :dof], friction[1, :dof], rate, poses, M,
                   np.abs(moved.qd).max(axis=0), np.abs(moved.tau).max(axis=0))  # fmt: skip


def resized(robot: RobotDescription, factor: float) -> RobotDescription:
    """The robot in another size: lengths × f, masses × f³, torques × f⁴, speeds × √f."""
    data: dict[str, Any] = robot.model_dump(mode="json")
    for name in ("base_radius", "platform_radius", "upper_arm", "strut"):
        data["limbs"][name] = (np.array(data["limbs"][name]) * factor).tolist()
    for key in ("radius", "z"):
        data["workspace"][key] = (np.array(data["workspace"][key]) * factor).tolist()
    power = np.array([3, 4, 4, 4, 5, 5, 5, 5, 5, 5])
    for name, body in robot.bodies.items():
        parameters = body.reduced_prior() * factor**power
        data["bodies"][name]["prior"] = ExplicitInertia.from_parameters(parameters)
    for law in data["friction"].values():
        law["viscous"] *= factor**4.5
        law["coulomb"] *= factor**4
    for drive in data.get("rotor_inertia") or {}:
        data["rotor_inertia"][drive] *= factor**5
    for limits in data["drive_limits"].values():
        if limits.get("torque"):
            limits["torque"] *= factor**4
    data["platform_speed"] *= np.sqrt(factor)
    return RobotDescription.model_validate(data | {"name": f"{robot.name}-resized"})


def _free_axes(robot: RobotDescription, body: str) -> list[int]:
    """Axes along which the description leaves a body's first moment free."""
    return [k for k, name in enumerate(("mcx", "mcy", "mcz")) if name in robot.bodies[body].free]


def _moved(robot: RobotDescription, p: Array, rng: np.random.Generator) -> Array:
    """p with each body shifted along its free axes."""
    layout = parameter_layout(robot)
    for body in layout.bodies:
        part = layout.body(body)
        size = np.sqrt(0.5 * p[part][4:7].sum() / p[part][0])
        T = np.eye(4)
        axes = _free_axes(robot, body)
        T[axes, 3] = _OFF * size * rng.uniform(-1, 1, len(axes))
        p[part] = inertia_parameters(T @ pseudo_inertia(p[part]) @ T.T)
    return p


def _clouds(robot: RobotDescription, rng: np.random.Generator) -> Array:
    """Bodies of eight random points about the prior's centre, mirrored where no axis is free."""
    p, layout = true_parameters(robot, rng), parameter_layout(robot)
    for body in layout.bodies:
        part, axes = layout.body(body), _free_axes(robot, body)
        m, centre = p[part][0], p[part][1:4] / p[part][0]
        about = np.diag(pseudo_inertia(p[part]))[:3] / m - centre**2
        spread = np.sqrt(3 * np.maximum(about, 1e-6))
        points = centre + spread * rng.uniform(-1, 1, (8, 3))
        x = (
            np.hstack([points, np.ones((8, 1))])
            * np.sqrt(m * rng.dirichlet(np.full(8, 3.0)))[:, None]
        )
        M = x.T @ x
        for k in range(3):
            if k not in axes and centre[k] == 0:
                M[k, np.arange(4) != k] = M[np.arange(4) != k, k] = 0.0
        p[part] = inertia_parameters(M)
    return p


def _poor_priors(robot: RobotDescription, rng: np.random.Generator) -> RobotDescription:
    """The description with each body 2 to 20 times too heavy or too light."""
    data: dict[str, Any] = robot.model_dump(mode="json")
    for name, body in robot.bodies.items():
        factor = np.exp(rng.choice([-1, 1]) * rng.uniform(*np.log([2, 20])))
        parameters = body.reduced_prior() * factor
        data["bodies"][name]["prior"] = ExplicitInertia.from_parameters(parameters)
    return RobotDescription.model_validate(data)
