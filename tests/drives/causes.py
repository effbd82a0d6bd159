"""The second table of rows: faults that nobody named, and random mixtures of faults.

A cause changes what is recorded by a fault of a size; several can be in one recording. What else
there is of a fault (which drive, which direction) is drawn, and `Made.words` says it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from drives.happening import Happening
from drives.pulls import Balancer, Hose
from drives.robots import Machine
from drives.rows import LENGTHS, lever, unit
from drives.sensors import Sensors
from oracle.composed import ComposedOracle
from oracle.tree import Array

# Strut of the robot of the class that sizes are written for (m).
_STRUT = 1.18


class Made(NamedTuple):
    """What happens and how it is recorded, with the words of every fault in it."""

    happening: Happening
    sensors: Sensors
    words: tuple[str, ...] = ()

    @property
    def machine(self) -> Machine:
        """The true robot."""
        return self.happening.machine

    def on(self, words: str, **changes: object) -> Made:
        """With other sensors."""
        return self._replace(sensors=replace(self.sensors, **changes), words=(*self.words, words))

    def but(self, words: str, **changes: object) -> Made:
        """With something else happening."""
        return self._replace(
            happening=replace(self.happening, **changes), words=(*self.words, words)
        )

    def of(self, words: str, oracle: ComposedOracle, p: Array | None = None) -> Made:
        """Of another true robot on the same path."""
        m = self.machine
        plant = replace(m.plant, oracle=oracle, p=m.plant.p if p is None else p)
        M = np.array([oracle.mass_matrix(z) for z in m.poses])
        return self.but(words, machine=replace(m, plant=plant, M=M))


Cause = Callable[[Made, np.random.Generator, float], Made]


@dataclass(frozen=True)
class Faults:
    """A row of the second table: its causes, each with its size, or with bounds of a random one.

    Random sizes are log-uniform.
    """

    words: str
    causes: tuple[tuple[Cause, float | tuple[float, float]], ...]

    def make(self, made: Made, rng: np.random.Generator) -> Made:
        """One cause after the other."""
        for cause, size in self.causes:
            drawn = log_uniform(rng, *size) if isinstance(size, tuple) else size
            made = cause(made, rng, drawn)
        return made


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A random number of log-uniform density."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


# --- how torques and angles are measured ------------------------------------------------------


def ripple(made: Made, rng: np.random.Generator, size: float) -> Made:
    """12 waves a radian; on a drive that slides, as many over what a radian is of the class."""
    m = made.machine
    return made.on(
        f"ripple {size:.1%}, 12 waves a radian", ripple=size,
        waves=12 / np.where(m.rotary, 1.0, lever(m)), phase=rng.uniform(0, 2 * np.pi, m.dof),
    )  # fmt: skip


def zeros(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Homing off by normal errors of this standard deviation (degrees)."""
    m = made.machine
    homing = np.deg2rad(size) * lever(m) * rng.standard_normal(m.dof)
    homing[len(m.plant.oracle.limbs) :] = 0.0
    return made.on(f"zeros {size:.2g}°", homing=homing)


def gear_ratio(made: Made, rng: np.random.Generator, size: float) -> Made:
    """The recorded angle of one drive of a limb is too large by a share; torques are right.

    Not of a telescope's drive, where a wrong ratio is another moment of inertia.
    """
    m = made.machine
    drive = int(rng.integers(len(m.plant.oracle.limbs)))
    scale = np.ones(m.dof)
    scale[drive] += size
    return made.on(f"gear ratio of {m.robot.drives[drive]} {size:.2%} off", scale=scale)


def falling_gain(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Torque constants that fall with current, by a share at the largest of the motion.

    Recorded is what the drive believes, r; true is r (1 − size (r / largest r)²).
    """
    del rng

    def believed(true: Array) -> Array:
        # At the largest torque r is 1 / (1 − size). With x = r / largest r, size x³ − x + y = 0 is
        # solved by x = A sin θ, A² = 4 / (3 size), sin 3θ = 3 y / A.
        y, A = (1 - size) * true, np.sqrt(4 / (3 * size))
        return A * np.sin(np.arcsin(3 * y / A) / 3) / (1 - size)

    return made.on(f"torque constants −{size:.1%} at full current", believed=believed)


def saturation(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Motors that saturate: true is s tanh(r / s), s a share of the largest recorded r."""
    del rng
    limit = 1 / np.tanh(1 / size)  # s over the largest true torque
    return made.on(
        f"torques saturate at {size:.0%}",
        believed=lambda true: limit * np.arctanh(true / limit),
    )


# --- forces that nobody described -------------------------------------------------------------


def _way(rng: np.random.Generator) -> Array:
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


def force(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A constant force at the platform (N), in a random direction."""
    way = _way(rng)
    pull = Hose(size * unit(made.machine) * way, 0.0, 0.0, np.zeros(3))
    return made.but(f"{size:.2g} N along {np.round(way, 2).tolist()}",
                    pulls=(*made.happening.pulls, pull))  # fmt: skip


def _stiffness(m: Machine, size: float) -> float:
    """Of a spring at the platform in proportion to the robot (N/m)."""
    return size * unit(m) / (m.robot.limbs.geometry()[0].strut / _STRUT)


def spring(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A spring at the platform (N/m) which hangs from anywhere above the motion's middle."""
    m = made.machine
    path = m.plant.path[:, :3]
    middle, half = path.mean(axis=0), 0.5 * np.ptp(path, axis=0)
    rest = middle + half * rng.uniform(-1, 1, 3)
    rest[2] = middle[2] * (1 - 0.5 * rng.uniform())
    pull = Hose(np.zeros(3), 0.0, _stiffness(m, size), rest)
    return made.but(f"spring {size:.2g} N/m", pulls=(*made.happening.pulls, pull))


def hose(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A constant force (N), a drag of 20 to 60 % of it, and a spring of ten times as many N/m."""
    m, way, drag = made.machine, _way(rng), float(rng.uniform(0.2, 0.6) * size)
    pull = Hose(size * unit(m) * way, drag * unit(m), _stiffness(m, 10 * size),
                m.plant.path[:, :3].mean(axis=0))  # fmt: skip
    words = f"hose {size:.2g} N along {np.round(way, 2).tolist()}, drag {drag:.2g} N"
    return made.but(words, pulls=(*made.happening.pulls, pull))


def balancer(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A spring at every drive, of at most a share of its largest torque."""
    m = made.machine
    q = m.plant.oracle.positions(m.plant.path[::8])
    middle, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0)
    rest = middle + half * rng.uniform(-1, 1, m.dof)
    stiffness = size * m.largest_torque / np.abs(q - rest).max(axis=0)
    pulls = (*made.happening.pulls, Balancer(stiffness, rest))
    return made.but(f"balancers of {size:.1%} of the torque", pulls=pulls)


# --- a robot that is not as described ---------------------------------------------------------


def long_limb(made: Made, rng: np.random.Generator, size: float) -> Made:
    """The arm or the strut of one limb is longer (m)."""
    oracle = made.machine.plant.oracle
    limbs, k = list(oracle.limbs), int(rng.integers(len(oracle.limbs)))
    arm = limbs[k].arm
    if arm is not None and rng.uniform() < 0.5:
        limbs[k], part = replace(limbs[k], arm=arm + size), "arm"
    else:
        limbs[k], part = replace(limbs[k], strut=limbs[k].strut + size), "strut"
    words = f"{part} of limb {k + 1} {1e3 * size:.2g} mm longer"
    return made.of(words, replace(oracle, limbs=tuple(limbs)))


def tilt(made: Made, rng: np.random.Generator, size: float) -> Made:
    """The base is not level, by an angle in degrees about a random horizontal axis."""
    oracle, about = made.machine.plant.oracle, rng.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(about), np.sin(about), 0.0])
    gravity = Rotation.from_rotvec(np.deg2rad(size) * axis).apply(oracle.gravity)
    return made.of(f"tilt {size:.2g}°", replace(oracle, gravity=gravity))


CAUSES = {
    "ripple": Faults("ripple of 3 %", ((ripple, 0.03),)),
    "clean-ripple": Faults("ripple of 0.5 %", ((ripple, 0.005),)),
    "homing-0.3": Faults("homing 0.3° off, not stated", ((zeros, 0.3),)),
    "homing-0.5": Faults("homing 0.5° off, not stated", ((zeros, 0.5),)),
    "hose": Faults("5 N, 1 to 3 N of drag, 50 N/m at the platform", ((hose, 5.0),)),
    "force": Faults("5 N at the platform", ((force, 5.0),)),
    "spring": Faults("50 N/m at the platform", ((spring, 50.0),)),
    "hose-tilted": Faults("a hose and a tilt of 1°", ((hose, 5.0), (tilt, 1.0))),
    "falling-gain": Faults("torque constants −15 % at full current", ((falling_gain, 0.15),)),
    "saturation": Faults("motors that saturate at 90 %", ((saturation, 0.9),)),
    "gear-ratio": Faults("gear ratio of one drive 1 % off", ((gear_ratio, 0.01),)),
    "long-limb": Faults("arm or strut of one limb 1 mm longer", ((long_limb, LENGTHS),)),
    "balancer": Faults("springs at the drives, 3 to 10 % of the torque",
                       ((balancer, (0.03, 0.1)),)),
    "tilt": Faults("base tilted by 2°", ((tilt, 2.0),)),
}  # fmt: skip
