"""Drift of friction in simulated fleets: what is found, how soon, and how often by mistake.

    python benchmarks/drift.py --level series [ROBOTS]     # series of friction, drawn: minutes
    python benchmarks/drift.py --level files [ROBOTS]      # factor files, drawn: the whole way

One recording a day for 26 weeks, with four drives. Friction follows the temperature of season,
weather and hour, with a slope of every robot and drive and a curvature; wanders from day to day;
recordings are missed, some are far out; tools change, unknown to anybody, and friction with them.
On 5 % of drives friction rises by 2 % a month from a day between the 8th and the 20th week on.
Evaluated as a plant would: day by day, with no more than the recordings up to then. Leaves
`tables/drift.md` and `tables/drift_files.md`.
"""

import sys
import time
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np
from _table import leave
from drawn_fleet import SETTINGS, DrawnType, drawn_type, made_alike

from deltaid.drift.evidence import MONTH, YEAR
from deltaid.drift.friction import FrictionSeries, friction_series
from deltaid.drift.recorded import Recorded
from deltaid.drift.robot_drift import drift_of
from deltaid.drift.series import Regressors, explained
from deltaid.drift.settings import DriftSettings
from deltaid.dynamics.parameters import prior_parameters
from deltaid.factors.identify import identify_gathered
from deltaid.model.record import IdentifiedModel
from deltaid.robot.load import load_robot

DAYS, DRIVES, WEEKS = 182, 4, 7.0
FIRST, WITHIN = 21, 42


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
    """A fleet."""
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


def alarms(case: Case, fleet: Fleet, every: int) -> tuple[np.ndarray, np.ndarray]:
    """Days on which one looks, and what the alarm goes by (looks, robots, drives) [years]."""
    looks, found = np.arange(FIRST, DAYS + 1, every), []
    robots = len(fleet.y)
    for n in looks:
        days = np.arange(n, dtype=float)
        y = fleet.y[:, :, :n].reshape(-1, n)
        beside = [
            Regressors.of(
                days,
                fleet.recorded[k, :n] if case.known else np.full(n, np.nan),
                np.zeros(n),
                (fleet.tool[k],),
            )
            for k in range(robots)
        ]
        found.append(explained(days, y, np.full(y.shape, 0.2), beside).found.R)
    return looks - 1.0, np.array(found).reshape(len(looks), robots, DRIVES)


def judged(looks: np.ndarray, hit: np.ndarray, onset: np.ndarray) -> tuple[int, int, int, int]:
    """Drives that drift, those found within six weeks and at all, and false alarms."""
    day = looks[:, None, None]
    drifts = np.isfinite(onset)
    before = (hit & (day < onset)).any(axis=0)
    after = hit & (day >= onset)
    soon = (after & (day <= onset + WITHIN)).any(axis=0) & drifts
    return (
        int(drifts.sum()),
        int(soon.sum()),
        int((after.any(axis=0) & drifts).sum()),
        int(before.sum()),
    )


def series(robots: int) -> None:
    """All cases."""
    rows = []
    for case in CASES:
        count = robots if case is CASES[0] else max(robots // 4, 50)
        every = 1 if case is CASES[0] else 3
        # Enough drives that drift where only these are counted.
        own = case if case is CASES[0] else replace(case, drifting=0.1)
        start, totals = time.time(), np.zeros(4, dtype=int)
        clean = 0.0
        for first in range(0, count, 50):
            # Constants of the method were chosen with other seeds than this.
            rng = np.random.default_rng([17, CASES.index(case), first])
            fleet = drawn(own, min(50, count - first), rng)
            looks, R = alarms(own, fleet, every)
            threshold = DRIVES / DriftSettings().false_alarms
            totals += judged(looks, threshold <= R, fleet.onset)
            clean += float(np.minimum(fleet.onset, DAYS).sum()) / YEAR / DRIVES
        drifting, soon, ever, false = totals.tolist()
        rows.append(
            (case.name, f"{case.scatter:.2f} %", count, drifting, f"{soon / drifting:.0%}",
             f"{ever / drifting:.0%}", false, f"{clean:.0f}", f"{false / clean:.3f}")
        )  # fmt: skip
        print(f"{time.time() - start:.0f} s")
        leave(
            ("fleet", "scatter", "robots", "drives that drift", "found within 6 weeks",
             "found by the end", "false alarms", "robot-years without drift",
             "false alarms a robot-year"),
            rows, _NOTE,
        )  # fmt: skip


_NOTE = """Series of friction, one value a drive and day over 26 weeks, four drives a robot.
*As above*: scatter from day to day of 0.69 % (0.6 % new every day, 0.35 % that wanders with a
memory of two days, half of its variance common to the drives of a robot); temperature of season
±6 K, weather 1.5 K and hour 3 K, recorded within 0.5 K, which adds 0.45 % of scatter; friction
−0.9 ± 0.3 % a degree (±0.1 between drives) with a curvature; 10 % of days missed, 1 % of values off
by 8 %; a tool change on half of the robots, with which friction steps by 0.4 % (one standard
deviation); rising 2 % a month on 5 % of drives (10 % in the other rows) from a day between the 8th
and the 20th week on. Other rows change one thing. The first row is looked at every day, the others
every third, always with no more than what was recorded up to then. False alarms: alarms on drives
that do not drift, or before they do; the bound is 0.1 a robot-year."""


def files(robots: int) -> None:
    """Factor files of a fleet, drawn, and the whole way from there."""
    robot, start = load_robot("clavel-delta3"), time.time()
    kind = drawn_type(robot, motions=4, loaded=2)
    drives, case = len(robot.drives), CASES[0]
    totals, clean, tools, late = np.zeros(4, dtype=int), 0.0, [0, 0, 0], list[float]()
    inside = np.zeros((2, 2), dtype=int)
    for k in range(robots):
        fleet = drawn(case, 1, np.random.default_rng([21, k]), drives)
        friction, own, model = _recorded(kind, fleet, k)
        at = [int(one.time.toordinal() - _START.toordinal()) for one in own]
        looks, hit, last = [], [], None
        for day in _looks(fleet.onset[0]):
            n = int(np.searchsorted(at, day, side="right"))
            last = drift_of(own[:n], friction.first(n), model, DriftSettings())
            looks.append(float(day))
            hit.append([one.state not in ("steady", "unknown") for one in last.findings])
        totals += judged(np.array(looks), np.array(hit)[:, None], fleet.onset)
        clean += float(np.minimum(fleet.onset, DAYS).sum()) / YEAR / drives
        assert last is not None
        first = at[0]
        near = [abs(one.day + first - fleet.tool[0]) <= 2 for one in last.tools]
        there = int(np.isfinite(fleet.tool[0]))
        tools = [tools[0] + any(near), tools[1] + len(near) - sum(near), tools[2] + there]
        late += [100 * one.scatter for one in last.findings]
        for i, one in enumerate(last.findings):
            onset = fleet.onset[0, i]
            if np.isfinite(onset) and one.state == "rising":
                truth = np.expm1(CASES[0].rate / 100.0)
                inside[0] += (one.rate.low <= truth <= one.rate.high, 1)
                inside[1] += (one.change.low <= onset - first <= one.change.high, 1)
        if k % 10 == 9 or k == robots - 1:
            drifting, soon, ever, false = totals.tolist()
            leave(
                ("robots", "factor files", "drives that drift", "found within 6 weeks",
                 "found by the end", "false alarms", "robot-years without drift",
                 "false alarms a robot-year", "rates within 95 %", "onsets within 95 %",
                 "tool changes found", "tool changes that were none", "scatter found"),
                [(k + 1, (k + 1) * len(own), drifting, soon, ever, false, f"{clean:.1f}",
                  f"{false / clean:.3f}", "{} of {}".format(*inside[0]),
                  "{} of {}".format(*inside[1]), f"{tools[0]} of {tools[2]}", tools[1],
                  f"{np.median(late):.2f} %")],
                f"{_FILES} {(time.time() - start) / 60:.0f} minutes.", "drift_files",
            )  # fmt: skip


_START = datetime(2026, 1, 1)
_FILES = """The first row of the other table by factor files, with three drives, 5 % of which
drift: robots of one type with bodies and friction of their own, a recording of 12 s a day on one of
several motions with 2 % of torque noise, a third of them with a load in cycles whose mass nobody
tells, tool changes of 0.1 to 0.3 kg that nobody told. The model is that of the first three weeks.
Looked at every week, and every third day in the six weeks after friction begins to rise, always
with no more than the files up to then."""


def _looks(onset: np.ndarray) -> list[int]:
    """Days on which a robot is looked at."""
    weekly = set(range(FIRST, DAYS, 7))
    for one in onset[np.isfinite(onset)]:
        weekly |= set(range(int(one) + 21, int(one) + WITHIN + 1, 3))
    return sorted({*weekly, DAYS - 1})


def _recorded(
    kind: DrawnType, fleet: Fleet, k: int
) -> tuple[FrictionSeries, list[Recorded], IdentifiedModel]:
    """A robot's recordings and what they say of friction."""
    rng, layout = np.random.default_rng([12, k]), kind.dynamics.layout
    p, own = made_alike(kind.robot, prior_parameters(kind.robot), rng), list[Recorded]()
    tool = rng.uniform(0.1, 0.3)
    for day in range(DAYS):
        y = fleet.y[0, :, day]
        if np.isnan(y).any():
            continue
        q = p.copy()
        for drive, change in zip(kind.robot.drives, y, strict=True):
            for name in (f"viscous.{drive}", f"coulomb.{drive}"):
                q[layout.names.index(name)] *= np.exp(change / 100.0)
        q[layout.names.index("P.m")] += tool * (day >= fleet.tool[0])
        file = kind.drawn(
            f"robot{k}", day, q, temperature=float(fleet.recorded[0, day]),
            loaded=bool(rng.uniform() < 1 / 3),
        )  # fmt: skip
        own.append(Recorded(file, _START + timedelta(days=day)))
    early = [one.file for one in own if one.time < _START + timedelta(days=FIRST)]
    model = identify_gathered(kind.robot, early, SETTINGS).model
    return friction_series([one.file for one in own], model), own, model


def main() -> int:
    """Study, print, and write tables."""
    level = sys.argv[sys.argv.index("--level") + 1] if "--level" in sys.argv else "series"
    given = [int(one) for one in sys.argv[1:] if one.isdigit()]
    if level == "series":
        series(given[0] if given else 200)
    else:
        files(given[0] if given else 200)
    return 0


if __name__ == "__main__":
    sys.exit(main())
