"""Recordings with one fault each, and clean ones, of random robots, motions and sensors.

`clean(seed)` is what a careful lab hands over; `fault(case, kind, rng)` spoils it in one way and says
which verdict is right. Every kind has its size drawn from a wide range. Torques come from the oracle
(`plants.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl

from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue, load_robot
from oracle.tree import Array
from plants import Plant, Truth, even_pace, random_plant

RATES = (250.0, 500.0, 1000.0, 2000.0, 4000.0)


@dataclass(frozen=True, eq=False)
class Setting:
    """A robot that moves, and its sensors.

    Attributes:
        plant: the true robot and its path.
        period: s for one round of the path.
        duration: s.
        rate: Hz.
        rest: spans of standing still (s).
        step: of the encoders behind their gears, (dof,) in rad or m.
        noise: of torques, as a share of each drive's largest.
        velocity: whether q̇ is recorded.
        seed: of whatever is random in sensors.
        extra: torques that the robot does not have, of what happens.
    """

    plant: Plant
    period: float
    duration: float
    rate: float
    rest: tuple[tuple[float, float], ...]
    step: Array
    noise: float
    velocity: bool
    seed: int
    extra: Callable[[Truth], Array] | None = None

    @property
    def time(self) -> Array:
        """Of the samples."""
        return np.arange(round(self.duration * self.rate)) / self.rate

    @cached_property
    def truth(self) -> Truth:
        """What happens."""
        return self.at(self.time)

    def at(self, time: Array) -> Truth:
        """What happens at other times (ascending)."""
        pace = even_pace(time, self.period, self.rest)
        truth = self.plant.move(pace, np.random.default_rng([self.seed, 1]))
        return replace(truth, tau=truth.tau + self.extra(truth)) if self.extra else truth

    @property
    def scale(self) -> Array:
        """Largest torque of each drive."""
        return np.abs(self.truth.tau).max(axis=0)

    def sensed(self) -> dict[str, Array]:
        """What the sensors make of it: t, q, qd if recorded, tau."""
        truth, rng = self.truth, np.random.default_rng([self.seed, 2])
        columns = {"t": truth.time, "q": self.step * np.round(truth.q / self.step)}
        if self.velocity:
            # A drive differentiates its encoder and smooths it; what is left is white and small.
            spread = 1e-3 * np.abs(truth.qd).max(axis=0)
            columns["qd"] = truth.qd + spread * rng.standard_normal(truth.qd.shape)
        noise = self.noise * self.scale * rng.standard_normal(truth.tau.shape)
        return columns | {"tau": truth.tau + noise}


@dataclass(frozen=True, eq=False)
class Case:
    """A robot as described, a recording of it, and what is right to say.

    Attributes:
        robot: its description; where `text` is not empty, that stands for it.
        columns: t (samples,), and q, qd, tau (samples, drives), as a log has them.
        setting: how it came about.
        kind: of fault; 'clean' for none.
        size: of the fault, in words.
        keys: any of these verdicts is right; none for a clean recording.
        subject: what the verdict must be about; empty if that is open.
        related: verdicts that follow from the fault, so that they are no mistake.
        changes: to the description as a file holds it, where a description is at fault.
    """

    robot: RobotDescription
    columns: Mapping[str, Array]
    setting: Setting
    kind: str = "clean"
    size: str = ""
    keys: tuple[str, ...] = ()
    subject: str = ""
    related: tuple[str, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)

    @property
    def seed(self) -> int:
        """Of the recording."""
        return self.setting.seed

    @cached_property
    def table(self) -> pl.DataFrame:
        """The recording with the default names of columns."""
        columns = {"t": self.columns["t"]}
        for name in ("q", "qd", "tau"):
            if name in self.columns:
                columns |= {f"{name}{i + 1}": x for i, x in enumerate(self.columns[name].T)}
        return pl.DataFrame(columns)


def clean(seed: int, robot: str | None = None) -> Case:
    """A recording without faults, of a random catalogue robot or of a given one."""
    rng = np.random.default_rng([seed, 0])
    names = catalogue()
    name = names[int(rng.integers(len(names)))]
    described = load_robot(robot or name)
    harmonics = int(rng.integers(4, 9))
    period = harmonics * np.exp(rng.uniform(np.log(0.45), np.log(1.2)))
    plant = random_plant(described, rng, period, harmonics, rng.uniform(0.7, 1.0))
    duration = max(rng.uniform(8, 25), 1.3 * period)
    ends = rng.uniform(0, 0.5, 2) * (rng.uniform(size=2) < 0.5)
    rest = ((-1.0, ends[0]),) if ends[0] > 0 else ()
    rest += ((duration - ends[1], duration + 1.0),) if ends[1] > 0 else ()
    linear = np.array([described.is_linear(drive) for drive in described.drives])
    counts = 2.0 ** rng.integers(14, 23)
    turn = 2 * np.pi / np.exp(rng.uniform(0, np.log(100)))
    lead = rng.uniform(0.01, 0.06)
    setting = Setting(
        plant=plant,
        period=period,
        duration=duration,
        rate=float(rng.choice(RATES)),
        rest=rest,
        step=np.where(linear, lead, turn) / counts,
        noise=float(np.exp(rng.uniform(np.log(0.003), np.log(0.03)))),
        velocity=bool(rng.uniform() < 0.4),
        seed=seed,
    )
    return Case(described, setting.sensed(), setting)


Maker = Callable[[Case, np.random.Generator], Case]
FAULTS: dict[str, Maker] = {}


def maker(function: Maker) -> Maker:
    """List a kind of fault by the name of its function."""
    FAULTS[function.__name__.replace("_", "-")] = function
    return function


def fault(case: Case, kind: str, rng: np.random.Generator) -> Case:
    """The case with a fault of a kind, of random size.

    Raises:
        Impossible: this robot or recording cannot have it.
    """
    return replace(FAULTS[kind](case, rng), kind=kind)


class Impossible(Exception):
    """A robot or a recording that cannot have a fault."""


def cases(kind: str, seed: int) -> Case:
    """The faulty case of a seed: the first clean one from that seed on that can have the fault."""
    for attempt in range(30):
        rng = np.random.default_rng([seed, attempt, 3])
        try:
            return fault(clean(seed + 1_000_003 * attempt), kind, rng)
        except Impossible:
            continue
    raise Impossible(f"no robot for {kind}")


# --- helpers of the kinds ------------------------------------------------------------------------


def drives(case: Case) -> tuple[str, ...]:
    """Names."""
    return case.robot.drives


def one(case: Case, rng: np.random.Generator) -> int:
    """A drive."""
    return int(rng.integers(len(drives(case))))


def spread(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two, evenly by its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def scaled(case: Case, name: str, factors: Array | float) -> dict[str, Array]:
    """The columns with one quantity times a factor a drive."""
    return dict(case.columns) | {name: case.columns[name] * factors}


def only(case: Case, drive: int, factor: float) -> Array:
    """A factor for one drive and 1 for the others."""
    return np.where(np.arange(len(drives(case))) == drive, factor, 1.0)


def rotary(case: Case) -> Array:
    """Which drives turn."""
    return np.array([not case.robot.is_linear(drive) for drive in drives(case)])


def recorded(case: Case, **changes: Any) -> Case:
    """The case with another setting, recorded anew."""
    setting = replace(case.setting, **changes)
    return replace(case, setting=setting, columns=setting.sensed())


def some(case: Case, rng: np.random.Generator) -> tuple[Array, str]:
    """All drives and no subject, or one drive and its name."""
    if rng.uniform() < 0.5:
        return np.ones(len(drives(case)), bool), ""
    drive = one(case, rng)
    return np.arange(len(drives(case))) == drive, drives(case)[drive]


# --- units and wiring ----------------------------------------------------------------------------


@maker
def angle_unit(case: Case, rng: np.random.Generator) -> Case:
    """Degrees for radians, or millimetres for metres."""
    which, subject = some(case, rng)
    factor = np.where(rotary(case), np.rad2deg(1.0), 1e3)
    columns = scaled(case, "q", np.where(which, factor, 1.0))
    words = f"degrees or millimetres, {subject or 'all drives'}"
    return replace(case, columns=columns, size=words, keys=("angle-unit",), subject=subject,
                   related=("velocity", "velocity-unit"))  # fmt: skip


@maker
def velocity_unit(case: Case, rng: np.random.Generator) -> Case:
    """rpm or degrees a second for rad/s, or mm/s for m/s."""
    if "qd" not in case.columns:
        case = recorded(case, velocity=True)
    turning = 60 / (2 * np.pi) if rng.uniform() < 0.6 else np.rad2deg(1.0)
    columns = scaled(case, "qd", np.where(rotary(case), turning, 1e3))
    return replace(case, columns=columns, size=f"{turning:.3g} or mm/s", keys=("velocity-unit",),
                   related=("velocity",))  # fmt: skip


@maker
def torque_unit(case: Case, rng: np.random.Generator) -> Case:
    """mN m for N m, or per mille of a rated torque."""
    if rng.uniform() < 0.5:
        factor, words = np.full(len(drives(case)), 1e3), "mN m"
    else:
        rated = case.setting.scale * rng.uniform(0.3, 1.0)
        rated = np.full_like(rated, rated.max()) if rng.uniform() < 0.7 else rated
        factor, words = 1e3 / rated, f"per mille of {rated.max():.3g}"
    return replace(case, columns=scaled(case, "tau", factor), size=words, keys=("torque-unit",))


@maker
def gear(case: Case, rng: np.random.Generator) -> Case:
    """Angles of the motor, whose gear the mapping does not declare."""
    ratio = spread(rng, 5, 100)
    while 40 < ratio < 80:  # next to degrees
        ratio = spread(rng, 5, 100)
    lead = rng.uniform(0.01, 0.06)
    factor = np.where(rotary(case), ratio, 2 * np.pi / lead)
    columns = scaled(case, "q", factor)
    if "qd" in columns:
        columns["qd"] = columns["qd"] * factor
    words = f"{factor.max():.4g}"
    if rng.uniform() < 0.5:
        columns["tau"] = columns["tau"] / factor
        words += " and torques of the motor"
    return replace(case, columns=columns, size=words, keys=("gear",),
                   related=("angle-unit", "torque-unit"))  # fmt: skip


@maker
def motor_torque(case: Case, rng: np.random.Generator) -> Case:
    """Torques of the motor beside angles of the joint."""
    factor = np.where(rotary(case), spread(rng, 8, 100), 2 * np.pi / rng.uniform(0.01, 0.06))
    return replace(case, columns=scaled(case, "tau", 1 / factor), size=f"1 / {factor.max():.3g}",
                   keys=("gear", "torque-unit"))  # fmt: skip


@maker
def angle_sign(case: Case, rng: np.random.Generator) -> Case:
    """One drive's angle counts the other way."""
    drive = one(case, rng)
    columns = scaled(case, "q", only(case, drive, -1.0))
    if "qd" in columns:
        columns["qd"] = columns["qd"] * only(case, drive, -1.0)
    return replace(case, columns=columns, size=drives(case)[drive], keys=("angle-sign",),
                   subject=drives(case)[drive])  # fmt: skip


@maker
def torque_sign(case: Case, rng: np.random.Generator) -> Case:
    """One drive's torque, or that of all, counts the other way."""
    drive = one(case, rng)
    every = rng.uniform() < 0.25
    columns = scaled(case, "tau", -1.0 if every else only(case, drive, -1.0))
    name = drives(case)[drive]
    return replace(case, columns=columns, size="all" if every else name, keys=("torque-sign",),
                   subject="" if every else name)  # fmt: skip


@maker
def both_signs(case: Case, rng: np.random.Generator) -> Case:
    """One drive's angle and torque count the other way."""
    drive = one(case, rng)
    columns = scaled(angle_sign_of(case, drive), "tau", only(case, drive, -1.0))
    return replace(case, columns=columns, size=drives(case)[drive],
                   keys=("angle-sign", "torque-sign"), subject=drives(case)[drive],
                   related=("torque-sign", "angle-sign"))  # fmt: skip


def angle_sign_of(case: Case, drive: int) -> Case:
    """The case with one drive's angle turned."""
    columns = scaled(case, "q", only(case, drive, -1.0))
    if "qd" in columns:
        columns["qd"] = columns["qd"] * only(case, drive, -1.0)
    return replace(case, columns=columns)


@maker
def torque_order(case: Case, rng: np.random.Generator) -> Case:
    """Torque columns in another order."""
    order = permutation(case, rng)
    columns = dict(case.columns) | {"tau": case.columns["tau"][:, order]}
    return replace(case, columns=columns, size=str(order), keys=("drive-order",))


def permutation(case: Case, rng: np.random.Generator) -> Array:
    """An order that is not the right one."""
    order = np.arange(len(drives(case)))
    while np.all(order == np.arange(len(order))):
        order = rng.permutation(len(order))
    return order


def all_kinds() -> Iterator[str]:
    """Names of the kinds of fault."""
    yield from FAULTS
