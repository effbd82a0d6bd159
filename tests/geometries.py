"""Deltas of several geometries with poses within reach, and generic states of catalogue robots."""

from functools import cache

import numpy as np

from composed import Make, twin
from deltaid.dynamics.dynamics import Dynamics
from deltaid.mechanism.kinematics import Kinematics
from deltaid.robot.limbs import Limbs

# Lengths like a 1.6 m robot's, unless a name says otherwise.
PLAIN = {"base_radius": 0.21, "platform_radius": 0.05, "upper_arm": 0.49, "strut": 1.13}
GEOMETRIES = {
    "even": {**PLAIN, "azimuth_deg": (0, 120, 240)},
    "clockwise": {**PLAIN, "azimuth_deg": (10, 250, 130)},
    "uneven": {**PLAIN, "azimuth_deg": (25, 120, 270)},
    "uneven clockwise": {**PLAIN, "azimuth_deg": (-70, 200, 95)},
    "wide platform": {
        "base_radius": 0.1,
        "platform_radius": 0.2,
        "upper_arm": 0.3,
        "strut": 0.8,
        "azimuth_deg": (5, 120, 240),
    },
    "elbows turned over": {
        "base_radius": 0.1,
        "platform_radius": 0.18,
        "upper_arm": 0.5,
        "strut": 0.705,
        "azimuth_deg": (5, 120, 240),
    },
    "random": {},
    "telescope": {},
}


@cache
def kinematics(name: str) -> Kinematics:
    robot = twin(Make(telescope=name == "telescope")).robot.changed(name=name)
    if GEOMETRIES[name]:
        robot = robot.changed(limbs=Limbs(**GEOMETRIES[name]))
    return Kinematics(robot)


# Where poses are taken: middle and half width of boxes for z, as shares of arm + strut, and for the
# arm angles. Far off the axis of a wide platform, the elbows' triangle turns over.
ELSEWHERE = {"z": ((0.03, -0.02, -0.62), (0.18, 0.18, 0.1)), "q": ((0.4, 0.4, 0.4), 0.3)}
WHERE = {
    "elbows turned over": {"z": ((-0.253, -0.487, -0.695), 0.005), "q": ((1.6, 1.6, 0.4), 0.01)}
}


def box(name: str, variable: str, rng: np.random.Generator, n: int) -> np.ndarray:
    middle, half = WHERE.get(name, ELSEWHERE)[variable]
    return middle + half * rng.uniform(-1, 1, (n, 3))


def poses_within_reach(k: Kinematics, n: int = 100) -> np.ndarray:
    """Random task coordinates in a box below the base, ψ over more than a revolution."""
    rng, size = np.random.default_rng(1), k.robot.limbs.upper_arm + k.robot.limbs.strut
    psi = rng.uniform(-9, 9, (n, k.dof - 3))
    return np.hstack([size * box(k.robot.name, "z", rng, n), psi])


def elbows(limbs: Limbs, q: np.ndarray) -> np.ndarray:
    """Elbows (limbs, 3) for the arm angles of one q, from the conventions alone."""
    phi = np.deg2rad(limbs.azimuth_deg)
    radius = limbs.base_radius + limbs.upper_arm * np.cos(q[:3])
    height = -limbs.upper_arm * np.sin(q[:3])
    return np.column_stack([radius * np.cos(phi), radius * np.sin(phi), height])


def platform_joints(limbs: Limbs, z: np.ndarray) -> np.ndarray:
    """Ends of the struts (limbs, 3) at one z."""
    phi = np.deg2rad(limbs.azimuth_deg)
    return z[:3] + limbs.platform_radius * np.column_stack([np.cos(phi), np.sin(phi), 0 * phi])


def generic_states(dynamics: Dynamics, n: int) -> tuple[np.ndarray, ...]:
    """z, q, q̇, q̈ of n random samples within reach of the catalogue's robots."""
    rng, dof = np.random.default_rng(14), dynamics.dof
    z = [0.02, -0.05, -0.98, 0.4] + [0.35, 0.35, 0.12, 3.0] * rng.uniform(-1, 1, (n, 4))
    zd, zdd = ([1, 1, 1, 5] * rng.standard_normal((n, 4)) * scale for scale in (2, 30))
    z, zd, zdd = (x[:, :dof] for x in (z, zd, zdd))
    return z, *dynamics.kinematics.drive_motion(z, zd, zdd)
