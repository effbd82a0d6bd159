"""A case: a described robot, a recording of it, how it was made, and which verdicts are right."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl

from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from logs import tabled
from oracle.tree import Array
from plants import Plant, Truth, even_pace, log_uniform, random_plant
from support import KINDS

RATES = (250.0, 500.0, 1000.0, 2000.0, 4000.0)


@dataclass(frozen=True, eq=False)
class Setting:
    """A moving robot and its sensors.

    Attributes:
        plant: the true robot and its path.
        period: duration of one round of the path (s).
        harmonics: of the path.
        duration: of the recording (s).
        rate: of samples (Hz).
        rest: spans in which the robot stands still (s).
        step: of the encoders behind their gears, (dof,) in rad or m.
        noise: of torques, as a share of each drive's largest.
        velocity: whether q̇ is recorded.
        seed: of the sensors' random numbers.
        extra: torques beyond the plant's, a function of the true motion.
        jitter: delay of each row after its time stamp (s).
    """

    plant: Plant
    period: float
    harmonics: int
    duration: float
    rate: float
    rest: tuple[tuple[float, float], ...]
    step: Array
    noise: float
    velocity: bool
    seed: int
    extra: Callable[[Truth], Array] | None = None
    jitter: Array | None = None

    @property
    def time(self) -> Array:
        """Times of the samples (s)."""
        return np.arange(round(self.duration * self.rate)) / self.rate

    @cached_property
    def truth(self) -> Truth:
        """True motion and torques at the samples."""
        return self.truth_at(self.time)

    def truth_at(self, time: Array) -> Truth:
        """True motion and torques at other times, ascending (s)."""
        pace = even_pace(time, self.period, self.rest)
        truth = self.plant.move(pace, np.random.default_rng([self.seed, 1]))
        return replace(truth, tau=truth.tau + self.extra(truth)) if self.extra else truth

    @property
    def scale(self) -> Array:
        """Largest torque of each drive."""
        return np.abs(self.truth.tau).max(axis=0)

    def sensed(self) -> dict[str, Array]:
        """Readings of the sensors: t, q, qd if recorded, tau."""
        truth, rng = self.truth, np.random.default_rng([self.seed, 2])
        if self.jitter is not None:
            truth = self.truth_at(self.time + self.jitter)
        columns = {"t": self.time, "q": self.step * np.round(truth.q / self.step)}
        if self.velocity:
            columns["qd"] = self._differences(columns["q"] - truth.q) + truth.qd
        noise = self.noise * self.scale * rng.standard_normal(truth.tau.shape)
        return columns | {"tau": truth.tau + noise}

    def _differences(self, error: Array) -> Array:
        """Error of a drive's velocity by the encoder's: differences across up to 4 ms."""
        reach = max(1, round(2e-3 * self.rate))
        padded = np.pad(error, ((reach, reach), (0, 0)), mode="edge")
        return (padded[2 * reach :] - padded[: -2 * reach]) * (self.rate / (2 * reach))


@dataclass(frozen=True, eq=False)
class Case:
    """A described robot, a recording of it, and the verdicts that are right.

    Attributes:
        robot: its description.
        columns: t (samples,), and q, qd, tau (samples, drives), as in a log.
        setting: how the recording was made.
        kind: of fault; 'clean' for none.
        size: of the fault, in words.
        keys: verdicts of which any is right; none for a clean recording.
        subject: required subject of the verdict; empty if any is right.
        related: verdicts that follow from the fault and are accepted.
        data: plain data of the description if it has the fault; the recording is then not used.
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
        """The seed of the recording."""
        return self.setting.seed

    @cached_property
    def exact(self) -> "Case":
        """The same case without noise and encoder steps."""
        setting = replace(self.setting, noise=0.0, step=np.full_like(self.setting.step, 1e-13))
        return replace(self, setting=setting, columns=setting.sensed())

    @cached_property
    def table(self) -> pl.DataFrame:
        """The recording as a table with default names of columns."""
        return tabled(**self.columns)


def clean(seed: int, robot: str | None = None) -> Case:
    """A recording without faults, of a random catalogue robot or of a given one."""
    rng = np.random.default_rng([seed, 0])
    name = KINDS[int(rng.integers(len(KINDS)))]
    described = load_robot(robot or name)
    harmonics = int(rng.integers(4, 9))
    period = harmonics * log_uniform(rng, 0.45, 1.2)
    plant = random_plant(described, rng, period, harmonics, rng.uniform(0.7, 1.0))
    duration = max(rng.uniform(8, 25), 1.3 * period)
    ends = rng.uniform(0, 0.5, 2) * (rng.uniform(size=2) < 0.5)
    rest = ((-1.0, ends[0]),) if ends[0] > 0 else ()
    rest += ((duration - ends[1], duration + 1.0),) if ends[1] > 0 else ()
    linear = np.array([described.is_linear(drive) for drive in described.drives])
    counts = 2.0 ** rng.integers(14, 23)
    turn = 2 * np.pi / log_uniform(rng, 1, 100)
    lead = rng.uniform(0.01, 0.06)
    setting = Setting(
        plant=plant,
        period=period,
        harmonics=harmonics,
        duration=duration,
        rate=float(rng.choice(RATES)),
        rest=rest,
        step=np.where(linear, lead, turn) / counts,
        noise=log_uniform(rng, 0.003, 0.03),
        velocity=bool(rng.uniform() < 0.4),
        seed=seed,
    )
    return Case(described, setting.sensed(), setting)
