"""Robots whose description knows their bodies badly, and what an identification makes of them.

True bodies have no symmetry beyond what `free` asks for. The description has the shapes of a
catalogue: products of inertia zero, the centre of mass on the longest axis, and every mass and
second moment 2 to 20 times too large or too small, in a body alike or each by itself.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.identification.identify import Identification, identify
from deltaid.model.record import Settings
from deltaid.motion.surrogate import Motion, SensorNoise, simulate_recording
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, inertia_parameters, pseudo_inertia
from support import largest_mass_error

# Nothing but the fit itself, and the labels of its parameters.
PLAIN = Settings(friction="described", lag="none", compliance="none", effects="none", events=False)
POSES = 40


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one robot.

    Attributes:
        found: its identification.
        truth: its true parameters.
        mass_error: largest |ΔM_ij| / √(M_ii M_jj) over some poses.
    """

    found: Identification
    truth: np.ndarray
    mass_error: float

    def held(self) -> tuple[Counter[str], Counter[str]]:
        """How many intervals of bodies hold the truth, and how many there are, by origin."""
        hold, every = Counter[str](), Counter[str]()
        bodies = 10 * len(self.found.model.layout.bodies)
        for parameter, true in zip(self.found.model.parameters[:bodies], self.truth, strict=False):
            assert parameter.low is not None
            assert parameter.high is not None
            slack = 1e-6 * abs(true)
            every[parameter.determined_by] += 1
            hold[parameter.determined_by] += parameter.low - slack <= true <= parameter.high + slack
        return hold, every


def true_parameters(robot: RobotDescription, rng: np.random.Generator) -> np.ndarray:
    """p up to twice or half the prior, with first moments and products of any sign."""
    p, layout = prior_parameters(robot), parameter_layout(robot)
    for body in layout.bodies:
        G = np.diag(np.exp(0.5 * np.log(2) * rng.uniform(-1, 1, 4)))
        M = G @ pseudo_inertia(p[layout.body(body)]) @ G
        size = np.sqrt(np.diag(M))
        for entry, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
            if i != j and entry in robot.bodies[body].free:
                more = 0.15 * rng.uniform(-1, 1) * size[i] * size[j]
                M[i, j] = M[j, i] = 0.9 * M[i, j] + more
        p[layout.body(body)] = inertia_parameters(M)
    rest = layout.coefficients
    p[rest] *= np.exp(np.log(2) * rng.uniform(-1, 1, rest.stop - rest.start))
    return p


def poorly_described(
    robot: RobotDescription, truth: np.ndarray, rng: np.random.Generator
) -> RobotDescription:
    """The robot with simple shapes for priors, far off."""
    layout, bodies = parameter_layout(robot), {}
    for body in layout.bodies:
        M = pseudo_inertia(truth[layout.body(body)])
        shape, axis = np.diag(np.diag(M)), int(np.argmax(np.diag(M)[:3]))
        if abs(M[axis, 3]) > 0.5 * np.sqrt(M[axis, axis] * M[3, 3]):
            shape[axis, 3] = shape[3, axis] = M[axis, 3]
        if rng.random() < 0.5:
            off = np.full(4, _signed(rng, 2, 20, 1))
            if rng.random() < 0.5:
                off[3:] = _signed(rng, 1, 2, 1)
        else:
            off = np.where(rng.random(4) < 0.6, _signed(rng, 2, 20, 4), _signed(rng, 1, 2, 4))
        G = np.diag(np.exp(0.5 * off))
        prior = ExplicitInertia.from_parameters(inertia_parameters(G @ shape @ G))
        bodies[body] = robot.bodies[body].changed(prior=prior)
    return robot.changed(bodies=bodies, sources={})


def outcome(
    robot: RobotDescription,
    motion: Motion,
    seed: int,
    *,
    poor: bool,
    duration: float,
    rate: float = 1000.0,
    noise: float = 0.02,
    settings: Settings = PLAIN,
) -> Outcome:
    """Record a random robot of a kind along a motion, and identify it from a description."""
    rng = np.random.default_rng(seed)
    truth, dynamics = true_parameters(robot, rng), compiled(robot)
    log = simulate_recording(
        dynamics, truth, motion, rng, duration=duration, rate=rate, noise=SensorNoise(noise)
    )
    described = poorly_described(robot, truth, rng) if poor else robot
    found = identify(described, log, settings=settings)
    z, _, _ = motion.evaluate(np.linspace(0, duration, POSES, endpoint=False))
    return Outcome(found, truth, mass_error(dynamics, z, truth, found.model.p))


def mass_error(dynamics: Dynamics, z: np.ndarray, truth: np.ndarray, p: np.ndarray) -> float:
    """Largest |ΔM_ij| / √(M_ii M_jj) at some poses."""
    q = dynamics.kinematics.inverse(z)
    return largest_mass_error(dynamics.mass_matrix(q, p), dynamics.mass_matrix(q, truth))


def _signed(rng: np.random.Generator, low: float, high: float, n: int) -> np.ndarray:
    return rng.choice([-1.0, 1.0], n) * rng.uniform(np.log(low), np.log(high), n)
