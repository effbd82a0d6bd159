"""Robots of a type for simulated production: true ones, and a model of each by identification."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import _alone  # noqa: F401
import numpy as np
from _pick_cycles import RATE, draw_cycles
from jaxtyping import Float

from deltaid.checks.identify import identify
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.limits import effort_limits
from deltaid.model.model import Model, load
from deltaid.model.settings import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.memory import Recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from plants import friction_of

ENCODER = 2 * np.pi / 2**20
# Of torques, as a share of each drive's largest.
NOISE = 0.02
# Speed below which friction that models lack fades out, as a share of the fastest.
_AT_REST = 0.01


# Of one robot, or of many in a column.
Number = float | Float[np.ndarray, "robots 1"]


@dataclass(frozen=True)
class Strange:
    """Friction of drives that their model lacks, as shares.

    Attributes:
        stribeck: of Coulomb friction, at lowest speed; gone at `speed` times the fastest.
        carried: of what gears carry.
        ripple: of Coulomb friction, `waves` to a radian or metre.
        cold: of viscous friction, at the start, and how fast it goes [s].
        hose: of Coulomb friction, what a hose or cable pulls, by the angle.
    """

    stribeck: Number = 0.25
    speed: Number = 0.05
    carried: Number = 0.02
    ripple: Number = 0.05
    waves: Number = 50.0
    cold: Number = 0.1
    warming: Number = 900.0
    hose: Number = 0.0

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Strange":
        return cls(
            stribeck=rng.uniform(0.0, 0.4),
            speed=np.exp(rng.uniform(np.log(0.02), np.log(0.12))),
            carried=rng.uniform(0.0, 0.04),
            ripple=rng.uniform(0.0, 0.1),
            waves=rng.uniform(20.0, 100.0),
            cold=rng.uniform(0.0, 0.2),
            hose=rng.uniform(0.0, 0.1),
        )

    @classmethod
    def of_many(cls, each: Sequence["Strange"]) -> "Strange":
        """All robots' numbers, one robot a row."""
        names = [number.name for number in fields(cls)]
        return cls(**{name: np.array([[getattr(robot, name)] for robot in each]) for name in names})


@dataclass(frozen=True, eq=False)
class Production:
    """Robots of one type.

    Attributes:
        robot: as described.
        truth: of each, one robot a row.
        models: of each, by an identification.
        payload: largest mass that is picked [kg].
        strange: friction that each robot's model lacks.
        fastest: typical largest speed of each drive.
    """

    robot: RobotDescription
    truth: Float[np.ndarray, "robots parameters"]
    models: tuple[Model, ...]
    payload: float
    strange: tuple[Strange, ...]
    largest: Float[np.ndarray, "robots dof"]
    fastest: Float[np.ndarray, " dof"]


def production_of(
    name: str, payload: float, robots: int, seed: int, *, recording: float = 20.0
) -> Production:
    """Draw robots of a type and identify each of them from a recording of its own."""
    robot, rng, drawn = load_robot(name), np.random.default_rng([seed, 1]), []
    for _ in range(robots):
        p, own = surrogate_parameters(robot, rng), Strange.drawn(rng)
        drawn.append((p, own, *_identified(robot, p, payload, own, recording, rng)))
    truth, each, models, largest, fastest = zip(*drawn, strict=True)
    speed, sizes = np.median(fastest, axis=0), np.array(largest)
    return Production(robot, np.array(truth), models, payload, each, sizes, speed)


def _identified(
    robot: RobotDescription,
    p: np.ndarray,
    payload: float,
    strange: Strange,
    duration: float,
    rng: np.random.Generator,
) -> tuple[Model, np.ndarray, np.ndarray]:
    """A robot's model from a recording, and the largest torques and speeds of its cycles.

    Half of it is a random motion, as fast as the drives allow, half are cycles without a load.
    """
    dynamics, kinematics = compiled(robot), compiled(robot).kinematics
    time = np.arange(round(0.5 * duration * RATE)) / RATE
    cycles = draw_cycles(Model(robot, p, robot.name), payload, rng, time[-1])
    limits = effort_limits(robot)
    parts = [(cycles.z, cycles.q, cycles.qd, cycles.qdd)]
    motion, pace = random_motion(kinematics, rng, period=0.4 * duration), 1.5
    while len(parts) < 2:
        z, zd, zdd = motion.evaluate(pace * time)
        q, qd, qdd = kinematics.drive_motion(z, pace * zd, pace**2 * zdd)
        if np.all(np.abs(dynamics.torque(z, qd, qdd, p)) < 0.7 * limits):
            parts.append((z, q, qd, qdd))
        pace *= 0.9
    fastest = np.abs(cycles.qd).max(axis=0)
    largest = np.abs(dynamics.torque(cycles.z, cycles.qd, cycles.qdd, p)).max(axis=0)
    data = []
    for k, (z, q, qd, qdd) in enumerate(parts):
        tau = dynamics.torque(z, qd, qdd, p)
        tau += lacking(strange, friction_of(robot, p)[:, : q.shape[1]], fastest, q, qd, tau, np.inf)
        tau += NOISE * largest * rng.standard_normal(tau.shape)
        steps, at = np.round(q / ENCODER) * ENCODER, time[: len(q)]
        data.append(Recording.from_arrays(t=at, q=steps, tau=tau, name=f"{robot.name} {k}"))
    settings = Settings(
        friction="described", events=False, lag="none", compliance="none", effects="none"
    )
    return load(identify(robot, data, settings=settings, force=True)), largest, fastest


def lacking(
    s: Strange,
    known: Float[np.ndarray, "2 *robots dof"],
    fastest: np.ndarray,
    q: np.ndarray,
    qd: np.ndarray,
    tau: np.ndarray,
    time: float,
) -> np.ndarray:
    """Friction that the model lacks, on the side of the drives' torques."""
    viscous, coulomb = known
    x = qd / fastest
    sign = np.tanh(x / _AT_REST)
    falling = s.stribeck * coulomb * np.exp(-((x / s.speed) ** 2))
    ripple = s.ripple * coulomb * np.sin(s.waves * q)
    cold = s.cold * np.exp(-time / s.warming) * viscous * qd
    pulls = s.hose * coulomb * np.cos(2 * q)
    return sign * (falling + s.carried * np.abs(tau)) + ripple * np.abs(sign) + cold + pulls
