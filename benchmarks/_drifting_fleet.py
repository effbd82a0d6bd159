"""Friction of simulated fleets over 26 weeks: weather, scatter, tools, and drives that drift."""

from dataclasses import dataclass

import numpy as np

from deltaid.fleets.drift_evidence import MONTH, YEAR

DAYS, DRIVES = 182, 4
WITHIN = 42


@dataclass(frozen=True)
class Case:
    """What a fleet is like; changes of friction in %.

    Attributes:
        white, wander, memory: scatter from day to day that is new every day, that wanders, and how
            long the latter remembers [days]; half of its variance is common to a robot's drives.
        season, weather, hour: of temperature [K]: amplitude over a year, standard deviations.
        sensor: error of the recorded temperature [K].
        drifting, rate: share of drives, and how fast [% a month].
        outliers: share of recordings, off by 8 %.
        missed: share of days.
        tool: standard deviation of the step of friction as a tool changes, on half of the robots.
        known: whether temperature is recorded.
    """

    name: str
    white: float = 0.6
    wander: float = 0.35
    memory: float = 2.0
    season: float = 6.0
    weather: float = 1.5
    hour: float = 3.0
    sensor: float = 0.5
    drifting: float = 0.05
    rate: float = 2.0
    outliers: float = 0.01
    missed: float = 0.1
    tool: float = 0.4
    known: bool = True

    @property
    def scatter(self) -> float:
        """From day to day, temperature taken out [%]."""
        return float(np.hypot(self.white, self.wander))


CASES = (
    Case("as above"),
    Case("one and a half times the scatter", white=0.9, wander=0.52),
    Case("twice the scatter", white=1.2, wander=0.7),
    Case("three times the scatter", white=1.8, wander=1.05),
    Case("wander of a week", memory=7.0),
    Case("wander of three weeks", memory=21.0),
    Case("temperature off by 2 K", sensor=2.0),
    Case("every day at the same hour", hour=0.5),
    Case("no temperature", known=False),
    Case("rising 4 % a month", rate=4.0),
)


@dataclass(frozen=True, eq=False)
class Fleet:
    """Series of friction.

    Attributes:
        temperature: as it is, and as it is recorded (robots, days) [°C].
        y: changes of friction [%] (robots, drives, days); NaN where a day was missed.
        onset: day from which on friction rises; infinite where it does not (robots, drives).
        tool: day of the tool change; infinite where there is none (robots).
    """

    temperature: np.ndarray
    recorded: np.ndarray
    y: np.ndarray
    onset: np.ndarray
    tool: np.ndarray


def drawn(case: Case, robots: int, rng: np.random.Generator, drives: int = DRIVES) -> Fleet:
    days, shape = np.arange(DAYS, dtype=float), (robots, drives)
    phase = rng.uniform(size=(robots, 1))
    T = case.season * np.sin(2 * np.pi * (days / YEAR + phase))
    T = T + wandering(rng, (robots,), case.weather, 2.0)
    T = T + case.hour * rng.standard_normal(T.shape)
    slope = rng.normal(-0.9, 0.3, (robots, 1, 1)) + rng.normal(0, 0.1, (*shape, 1))
    curve = rng.normal(0.008, 0.004, (robots, 1, 1)) + rng.normal(0, 0.002, (*shape, 1))
    y = slope * T[:, None] + curve * T[:, None] ** 2
    y = y + case.white * rng.standard_normal(y.shape)
    half = case.wander * np.sqrt(0.5)
    y = y + wandering(rng, shape, half, case.memory)
    y = y + wandering(rng, (robots, 1), half, case.memory)
    y = y + 8.0 * rng.standard_normal(y.shape) * (rng.uniform(size=y.shape) < case.outliers)
    tool = rng.integers(14, DAYS - 14, robots).astype(float)
    tool[rng.uniform(size=robots) < 0.5] = np.inf
    step = case.tool * rng.standard_normal((*shape, 1))
    y = y + step * (days >= tool[:, None])[:, None]
    onset = np.where(
        rng.uniform(size=shape) < case.drifting, rng.integers(56, DAYS - WITHIN, shape), np.inf
    )
    y = y + case.rate / MONTH * np.maximum(days - onset[..., None], 0.0)
    y[np.broadcast_to(rng.uniform(size=(robots, 1, DAYS)) < case.missed, y.shape)] = np.nan
    return Fleet(T + 25, T + 25 + case.sensor * rng.standard_normal(T.shape), y, onset, tool)


def wandering(
    rng: np.random.Generator, shape: tuple[int, ...], size: float, memory: float
) -> np.ndarray:
    """A first-order wander."""
    a, noise = np.exp(-1.0 / memory), rng.standard_normal((*shape, DAYS))
    found = noise.copy()
    for t in range(1, DAYS):
        found[..., t] = a * found[..., t - 1] + np.sqrt(1 - a * a) * noise[..., t]
    return size * found
