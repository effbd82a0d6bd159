"""What robots do in a drawn hour of production: cycles of picks, what they carry, who pushes them.

Cycles go up, across and down again between random places, with a stand at either end in which a
load is taken or left. Loads have random mass, centre and inertia; pushes random force, place, time.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.limits import effort_limits
from deltaid.model.model import Model
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody

# Of rows [Hz].
RATE = 1000.0
# Stand at either end [s], and the share of it after which a load is on or off.
STAND, GRIPPED = 0.06, 0.5
# How long a push lasts [s].
_PUSHED = 0.1
# Share of the drives' torque and speed that cycles use at most.
_USE = 0.75
# Acceleration that a move is planned with where no limit is nearer [m/s²].
_ACCELERATION = 40.0


@dataclass(frozen=True)
class Pick:
    """A load, from when to when it is held [s], and its ten parameters about the carrier."""

    start: float
    end: float
    p: Float[np.ndarray, " 10"]

    @property
    def mass(self) -> float:
        return float(self.p[0])


@dataclass(frozen=True)
class Push:
    """A force from outside, [start, end) in s.

    Attributes:
        place: 'platform', or the drive whose arm (elbow or carriage) is pushed.
        force: [N]: in the world at the platform's point; its part that turns an arm, at the elbow.
    """

    start: float
    end: float
    place: str
    force: Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class Cycles:
    """A desired motion, one sample a row, and when grips close and open [s]."""

    z: Float[np.ndarray, "samples dof"]
    q: Float[np.ndarray, "samples dof"]
    qd: Float[np.ndarray, "samples dof"]
    qdd: Float[np.ndarray, "samples dof"]
    grips: Float[np.ndarray, "picks 2"]


def draw_cycles(model: Model, payload: float, rng: np.random.Generator, duration: float) -> Cycles:
    """Cycles as fast as the drives allow with the largest payload, or slower.

    Every other move carries something.
    """
    pace, slower = rng.uniform(0.6, 1.0), 1.0
    heavy = model.with_load(load_of(payload, np.zeros(3), np.full(3, 0.05)))
    seed = int(rng.integers(2**31))
    for _ in range(40):
        cycles = _cycles(model, np.random.default_rng(seed), duration, slower)
        use = _use(heavy, cycles)
        if use <= 1.0:
            break
        slower *= max(1.03, np.sqrt(use) ** 0.8)
    return _cycles(model, np.random.default_rng(seed), duration, slower / pace)


def draw_load(payload: float, rng: np.random.Generator) -> Float[np.ndarray, " 10"]:
    """A box that hangs below the flange, somewhat aside, 5 % to all of the payload."""
    mass = payload * np.exp(rng.uniform(np.log(0.05), 0.0))
    size = 0.02 + 0.06 * rng.uniform(size=3)
    centre = np.array([*rng.uniform(-0.02, 0.02, 2), -0.5 * size[2] - rng.uniform(0, 0.06)])
    return load_of(mass, centre, size)


def load_of(
    mass: float, centre: Float[np.ndarray, " 3"], size: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " 10"]:
    """The ten parameters of a box with edges `size` [m]."""
    second = mass * (np.diag(size**2 / 12) + np.outer(centre, centre))
    return RigidBody.of_moments(mass, mass * centre, second).p


def is_near(found: float, mass: float) -> bool:
    """Whether a mass is right within 10 % or 60 g."""
    return bool(abs(found - mass) <= max(0.1 * mass, 0.06))


def draw_picks(cycles: Cycles, payload: float, rng: np.random.Generator) -> list[Pick]:
    return [Pick(start, end, draw_load(payload, rng)) for start, end in cycles.grips]


def draw_pushes(
    model: Model, duration: float, rng: np.random.Generator, force: float
) -> list[Push]:
    """Pushes at random times, half of them at the platform, one at most in a second."""
    arms, pushes = model.robot.drives[: len(model.robot.limb_geometry)], []
    for k in range(int(duration) - 1):
        start = k + 0.5 + rng.uniform(0, 1 - 2 * _PUSHED)
        n = rng.standard_normal(3)
        place = "platform" if rng.uniform() < 0.5 else str(rng.choice(arms))
        n = n / np.linalg.norm(n) if place == "platform" else np.array([rng.choice([-1, 1]), 0, 0])
        pushes.append(Push(start, start + _PUSHED, place, force * n))
    return pushes


def _cycles(model: Model, rng: np.random.Generator, duration: float, slower: float) -> Cycles:
    robot, kinematics = model.robot, model.dynamics.kinematics
    middle, half = robot.within(0.0)
    points = robot.task.moves
    turn = robot.task.turn
    low = middle[2] - 0.6 * half[2]
    at = _place(robot, rng, middle, half, low)
    parts, grips, now = [], [], 0.0
    begin, carries = 0.0, False
    while now < duration:
        to = _place(robot, rng, middle, half, low)
        stand = round(STAND * RATE)
        parts.append(np.repeat(at[None], stand, axis=0))
        change = now + round(GRIPPED * stand) / RATE
        if carries:
            grips.append((begin, change))
        begin, carries = change, not carries
        now += stand / RATE
        way = float(np.linalg.norm((to - at)[points][:2]))
        time = slower * 2.4 * np.sqrt(max(way, 0.5 * half[2]) / _ACCELERATION)
        if turn is not None:
            time = max(time, slower * 2.0 * abs(to[turn] - at[turn]) / robot.turn.speed)
        samples = max(round(time * RATE), 20)
        parts.append(_move(at, to, min(half[2], 0.3 * way), np.arange(samples) / samples))
        at, now = to, now + samples / RATE
    z = np.concatenate(parts)[: round(duration * RATE)]
    zd, zdd = _derivatives(parts, len(z))
    q, qd, qdd = kinematics.drive_motion(z, zd, zdd)
    return Cycles(z, q, qd, qdd, np.array(grips).reshape(-1, 2))


def _place(
    robot: RobotDescription,
    rng: np.random.Generator,
    middle: np.ndarray,
    half: np.ndarray,
    low: float,
) -> np.ndarray:
    at = middle + 0.85 * half * rng.uniform(-1, 1, len(half))
    at[2] = low + 0.1 * half[2] * rng.uniform(-1, 1)
    turn = robot.task.turn
    if turn is not None:
        limits = robot.turn
        reach = min(0.5 * (limits.high - limits.low), 0.5 * np.pi)
        at[turn] = 0.5 * (limits.high + limits.low) + 0.8 * reach * rng.uniform(-1, 1)
    return at


def _rise(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 with speed and acceleration zero at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 + x * (6 * x - 15))


def _move(at: np.ndarray, to: np.ndarray, lift: float, x: np.ndarray) -> np.ndarray:
    """Up, across, down; the three overlap."""
    z = at + _rise((x - 0.1) / 0.8)[:, None] * (to - at)
    z[:, 2] += lift * (_rise(x / 0.45) - _rise((x - 0.55) / 0.45))
    return z


def _derivatives(parts: list[np.ndarray], n: int) -> tuple[np.ndarray, np.ndarray]:
    """Central differences of a path whose third derivative is bounded: 1e-6 of the path's own."""
    z = np.concatenate([*parts, np.repeat(parts[-1][-1:], 2, axis=0)])[: n + 1]
    if len(z) == n:
        z = np.concatenate([z, z[-1:]])
    before = np.concatenate([z[:1], z[:-2]])
    after, now = z[1:], z[:-1]
    return 0.5 * RATE * (after - before), RATE**2 * (after - 2 * now + before)


def _use(model: Model, cycles: Cycles) -> float:
    """Largest share of torque and speed that drives may use, of what cycles need; 1 just fits."""
    part = slice(0, min(len(cycles.z), 8000))
    tau = model.dynamics.torque(cycles.z[part], cycles.qd[part], cycles.qdd[part], model.p)
    shares = np.abs(tau).max(axis=0) / effort_limits(model.robot)
    limits = model.robot.drive_limits
    for i, drive in enumerate(model.robot.drives):
        speed = limits[drive].top_speed if drive in limits else None
        if speed:
            shares[i] = max(shares[i], np.abs(cycles.qd[part, i]).max() / speed)
    return float(shares.max()) / _USE
