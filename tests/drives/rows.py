"""The rows of the table: recordings with one fault of known size, or with several.

A row is a function of a kind of robot and a seed. Forces, masses and stiffnesses are stated for a
robot of the IRB 360 class; other robots have them in proportion to their drives' torques.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import polars as pl

from deltaid.robot.description import RobotDescription
from drives.happening import Contact, Happening, Law, Load
from drives.production import held_spans, rhythm
from drives.robots import Machine
from drives.sensors import Sensors
from oracle.tree import Array

# Largest torque of the drives (N m), and upper arm (m), of the IRB 360 class.
_TORQUE, _ARM = 75.0, 0.525
# Standard deviations of errors of drives' zeros (rad; times `lever`) and of lengths (m).
HOMING, LENGTHS = float(np.deg2rad(0.5)), 1e-3


@dataclass(frozen=True, eq=False)
class Case:
    """A described robot, its recordings, and how they were made.

    Attributes:
        row, kind, seed: of the case.
        machine: the true robot.
        robot: its description.
        happenings, sensors: one for each recording.
        logs: tables, one for each recording.
        tells: information for the identification: 'gripper' for a column with the load's state,
            'known' for a known load, 'tolerances' for those of lengths and homing.
        drawn: the faults of a row of `causes.py` and their sizes, in words.
    """

    row: str
    kind: str
    seed: int
    machine: Machine
    robot: RobotDescription
    happenings: tuple[Happening, ...]
    sensors: tuple[Sensors, ...]
    logs: tuple[pl.DataFrame, ...]
    tells: tuple[str, ...] = ()
    drawn: tuple[str, ...] = ()

    @property
    def unit(self) -> float:
        """Ratio of this robot's forces and masses to those of the IRB 360 class."""
        return unit(self.machine)


def unit(m: Machine) -> float:
    """Ratio of a robot's forces at the platform to those of the IRB 360 class."""
    arm = m.robot.limbs.geometry()[0].upper_arm if m.rotary[0] else 1.0
    return float(m.largest_torque[:3].mean() / arm / (_TORQUE / _ARM))


def lever(m: Machine) -> Array:
    """1 for a rotary drive; for a linear one, the metres that correspond to a radian.

    A quarter of this if the platform turns the tool: the platform multiplies errors of the drives,
    and such robots have better gears, or none.
    """
    strut = m.robot.limbs.geometry()[0].strut
    turned = 0.25 if m.robot.platform_turns else 1.0
    return turned * np.where(m.rotary, 1.0, 0.44 * strut)


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        make: makes the row's machine and sensors from a clean machine.
        words: title of the row.
        tells: as in `Case`.
    """

    make: Callable[[Happening, np.random.Generator], tuple[Happening, Sensors]]
    words: str
    tells: tuple[str, ...] = ()


def _clean(happening: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return happening, Sensors()


def _lag(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(delay=rng.uniform(-4e-3, 4e-3, h.machine.dof))


def _one_lag(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(delay=np.full(h.machine.dof, rng.uniform(-4e-3, 4e-3)))


def _current_loop(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(current_loop=min(500.0, 0.5 * h.machine.rate))


def _velocity(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(velocity=True, velocity_lag=2e-3)


def _standing(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    start = rng.uniform(2, h.duration - 6)
    return replace(h, standing=((start, start + 3.0),)), Sensors()


def _brakes(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    start = rng.uniform(2, h.duration - 6)
    return replace(h, standing=((start - 0.3, start + 2.8),), braked=((start, start + 2.7),)), (
        Sensors()
    )  # fmt: skip


def _stops(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    starts = _apart(rng, 3, 1.5, h.duration - 2.5, 2.2)
    return replace(h, braked=tuple((s, s + rng.uniform(0.6, 1.0)) for s in starts)), Sensors()


def _clipped(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return h, Sensors(clip=0.6)


def _contacts(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    count = round(h.duration)
    found = []
    for start in _apart(rng, count, 0.6, h.duration - 0.7, 0.25):
        way = rng.standard_normal(3)
        size, length = rng.uniform(50, 300), rng.uniform(0.02, 0.1)
        force = size * unit(h.machine) * way / np.linalg.norm(way)
        found.append(Contact(start, length, tuple(force.tolist()), size))
    return replace(h, contacts=tuple(found)), Sensors()


def load_of(m: Machine, rng: np.random.Generator, mass: float = 1.0) -> Load:
    """A load in proportion to the robot, with its centre off the tool's axis."""
    size = m.robot.limbs.geometry()[0].strut / 1.18
    centre = size * np.array([*rng.uniform(-0.03, 0.03, 2), -0.05])
    return Load(mass * unit(m), centre, 0.04 * size)


def _cycles(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    edges = np.cumsum(np.append(rng.uniform(0.5, 0.9), rng.uniform(0.35, 0.8, 60)))
    edges = edges[edges < h.duration - 0.6]
    edges = edges[: len(edges) // 2 * 2]
    held = tuple((float(a), float(b)) for a, b in edges.reshape(-1, 2))
    return replace(h, load=load_of(h.machine, rng), held=held), Sensors(gripper=True)


def _half(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    held = ((float(rng.uniform(0.35, 0.65) * h.duration), h.duration + 1),)
    return replace(h, load=load_of(h.machine, rng), held=held), Sensors(gripper=True)


def ways(m: Machine, rng: np.random.Generator) -> Array:
    """Direction in which each drive's friction is higher, as a sign.

    A constant force that all carriages on upright rails share could be their weight, because no
    motion separates their mass from the rotors' inertia. So with linear drives only two differ, and
    the sum is zero.
    """
    if np.all(m.rotary):
        return rng.choice([-1.0, 1.0], m.dof)
    ways, (a, b) = np.zeros(m.dof), rng.permutation(m.dof)[:2]
    least = min(m.coulomb[a], m.coulomb[b])
    ways[a], ways[b] = least / m.coulomb[a], -least / m.coulomb[b]
    return ways


def _law(h: Happening, rng: np.random.Generator, names: str) -> Law:
    """Friction with the named ones of: stribeck (40 %), direction (±10 %), load (5 %)."""
    m, more = h.machine, dict[str, Any]()
    if "stribeck" in names:
        more |= {"stribeck": 0.4, "knee": rng.uniform(0.03, 0.1) * m.largest_speed}
    if "direction" in names:
        more["direction"] = 0.1 * ways(m, rng)
    if "load" in names:
        more["load"] = 0.05
    return Law(m.viscous, m.coulomb, **more)


def _friction(names: str) -> Callable[..., tuple[Happening, Sensors]]:
    def make(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
        return replace(h, law=_law(h, rng, names)), Sensors()

    return make


def _backlash(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    return replace(h, backlash=np.deg2rad(0.05) * lever(h.machine)), Sensors()


def gear(m: Machine, stiffness: float) -> Array:
    """Stiffness of each gear, from that of the IRB 360 class (N m/rad)."""
    return stiffness * (m.largest_torque / _TORQUE / lever(m))


def _gear(stiffness: float) -> Callable[..., tuple[Happening, Sensors]]:
    def make(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
        return replace(h, stiffness=gear(h.machine, stiffness)), Sensors()

    return make


def _homing(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    """Normal errors of zeros and lengths, of the standard deviations `HOMING` and `LENGTHS`."""
    m = h.machine
    limbs = tuple(
        replace(
            limb,
            arm=None if limb.arm is None else limb.arm + LENGTHS * rng.standard_normal(),
            strut=limb.strut + LENGTHS * rng.standard_normal(),
        )
        for limb in m.plant.oracle.limbs
    )
    plant = replace(m.plant, oracle=replace(m.plant.oracle, limbs=limbs))
    machine = replace(m, plant=plant, M=np.array([plant.oracle.mass_matrix(z) for z in m.poses]))
    homing = HOMING * lever(m) * rng.standard_normal(m.dof)
    homing[len(limbs) :] = 0.0
    return replace(h, machine=machine), Sensors(homing=homing)


def _realistic(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    """Small faults of many kinds together."""
    m = h.machine
    h, homed = _homing(h, rng)
    law = replace(
        _law(h, rng, "stribeck"), stribeck=0.3, direction=0.07 * ways(m, rng),
        warm=0.2, constant=0.4 * h.duration,
    )  # fmt: skip
    stop = rng.uniform(3, h.duration - 5)
    h = replace(_gear(2e4)(h, rng)[0], law=law, braked=((stop, stop + 0.8),),
                backlash=np.deg2rad(0.01) * lever(m))  # fmt: skip
    gain = 1 + 0.03 * rng.choice([-1, 1], m.dof) * rng.uniform(0.5, 1, m.dof)
    return h, Sensors(
        delay=np.full(m.dof, 1.2e-3), current_loop=min(500.0, 0.5 * m.rate), gain=gain,
        offset=0.01 * rng.choice([-1, 1], m.dof), ripple=0.02, stale=0.002,
        homing=0.4 * np.asarray(homed.homing),
    )  # fmt: skip


def _production(h: Happening, rng: np.random.Generator) -> tuple[Happening, Sensors]:
    law = replace(_law(h, rng, "stribeck"), stribeck=0.3)
    h = replace(h, law=law, load=load_of(h.machine, rng, 0.6), held=held_spans(h.duration),
                rhythm=rhythm)  # fmt: skip
    return h, Sensors(delay=np.full(h.machine.dof, 1.2e-3), gripper=True)


ROWS = {
    "clean": Row(_clean, "no fault"),
    "lag": Row(_lag, "torques −4 to 4 ms late, each drive its own"),
    "one-lag": Row(_one_lag, "all torques −4 to 4 ms late"),
    "current-loop": Row(_current_loop, "current loop of 500 Hz"),
    "velocity": Row(_velocity, "recorded velocities behind a filter of 2 ms"),
    "standing": Row(_standing, "3 s of standing under control"),
    "brakes": Row(_brakes, "3 s of standing with brakes"),
    "stops": Row(_stops, "3 emergency stops"),
    "clipped": Row(_clipped, "torque channels end at 60 %"),
    "contacts": Row(_contacts, "pushes of 50 to 300 N for 20 to 100 ms, one a second"),
    "load-cycles": Row(_cycles, "1 kg taken and put down, declared", ("gripper",)),
    "load-half": Row(_half, "1 kg from the middle on, declared", ("gripper",)),
    "load-cycles-undeclared": Row(_cycles, "1 kg taken and put down, not declared"),
    "load-half-undeclared": Row(_half, "1 kg from the middle on, not declared"),
    "stribeck": Row(_friction("stribeck"), "Stribeck friction of 40 %"),
    "direction": Row(_friction("direction"), "friction ±10 % by direction"),
    "load-friction": Row(_friction("load"), "5 % of what the gear carries"),
    "three-laws": Row(_friction("stribeck direction load"), "these three"),
    "backlash": Row(_backlash, "0.05° of backlash"),
    "gear-20000": Row(_gear(2e4), "gears of 20 000 N m/rad"),
    "gear-5000": Row(_gear(5e3), "gears of 5 000 N m/rad"),
    "homing": Row(_homing, "homing 0.5° and lengths 1 mm off", ("tolerances",)),
    "realistic": Row(_realistic, "a little of everything"),
    "production": Row(_production, "pick and place in 0.9 s, load declared", ("gripper",)),
    "production-undeclared": Row(_production, "pick and place in 0.9 s, load not declared"),
    "poor-priors": Row(_clean, "priors 2 to 20 times off"),
    "gains": Row(_clean, "torque constants ±10 %, recorded empty and with 1 kg", ("known",)),
    "closed-loop": Row(_clean, "noise that control feeds back"),
    "unlogged": Row(_clean, "the same, and drives give other torques than they log"),
}  # fmt: skip


def _apart(
    rng: np.random.Generator, count: int, low: float, high: float, least: float
) -> list[float]:
    """A number of ascending random times between two, at least `least` apart (s)."""
    free = high - low - (count - 1) * least
    return [
        float(low + free * x + k * least) for k, x in enumerate(np.sort(rng.uniform(size=count)))
    ]
