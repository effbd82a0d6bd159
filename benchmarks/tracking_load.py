"""What it is worth that feed-forward knows the load of the pick cycle at once.

    pip install -e '.[test]'
    python benchmarks/tracking_load.py [--robots NAME,…] [--loads KG,…] [--bandwidths HZ,…]

A robot whose truth is known is identified from one recording with 2 % torque noise, as
`deltaid demo` does it. Then it picks and places: 25 mm up, 305 mm across, 25 mm down and back, in
the shortest time that the robot's limits allow with the load; it comes at rest at one end and goes
at rest at the other. Drives are sampled at 1 kHz, with encoder steps and a current loop of 500 Hz.
Feed-forward with the identified model and PD; what differs is what it knows of the load, and
when; or it knows only that the gripper holds, and `deltaid.Online` estimates the rest.
Leaves `tables/tracking_load.md`, which `docs/simulation.md` explains.
"""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import _alone  # noqa: F401
import numpy as np
from _table import leave
from _timing import options

from deltaid.control.controllers import Controller, ControlModel, Desired
from deltaid.control.infeasible import motion_problems
from deltaid.control.plant import Held, Plant, point_mass
from deltaid.control.tracking import Drives, Knowledge, Tracking, gains, track
from deltaid.control.trajectory import MotionTrajectory
from deltaid.identification.demo import demonstrate
from deltaid.mechanism.kinematics import Samples
from deltaid.model.model import Model, load
from deltaid.online.online import Online
from deltaid.online.settings import OnlineSettings
from deltaid.robot.load import load_robot

UP, ACROSS, REST, CYCLES, LATE, OFF = 0.025, 0.305, 0.1, 2, 0.2, 0.1
HEAD = (
    "robot", "load, kg", "way there, s", "feedback, Hz", "no load", "load, unknown",
    "known 0.2 s late", "estimated online", "known at once, 10 % off", "known at once",
)  # fmt: skip


@dataclass(frozen=True)
class Picks:
    """Ways from rest to rest, there and back, as task coordinates of time.

    Attributes:
        home: pose in the middle of the way, before it is lifted.
        way: time from end to end [s].
    """

    home: np.ndarray
    way: float

    @property
    def duration(self) -> float:
        return 2 * CYCLES * (self.way + REST)

    def evaluate(self, time: np.ndarray) -> tuple[Samples, Samples, Samples]:
        half = self.way + REST
        number, inside = np.divmod(np.clip(time, 0, self.duration - 1e-9), half)
        side = np.where(number % 2 == 0, 1.0, -1.0)
        u = (inside - REST / 2) / self.way
        across, up = _rise(u, 0.12, 0.88), _rise(u, 0.0, 0.4)
        down = _rise(u, 0.6, 1.0)
        out = [np.repeat((self.home if k == 0 else 0 * self.home)[None], len(time), axis=0)
               for k in range(3)]  # fmt: skip
        for k, values in enumerate(out):
            start = -0.5 * side * ACROSS if k == 0 else 0.0
            values[:, 0] += start + side * ACROSS * across[k] / self.way**k
            values[:, 2] += UP * (up[k] - down[k]) / self.way**k
        return out[0], out[1], out[2]

    def held(self, mass: float) -> tuple[Held, ...]:
        """A load on every way there."""
        start = [2 * k * (self.way + REST) for k in range(CYCLES)]
        return tuple(Held(point_mass(mass), t, t + self.way + REST) for t in start)


def _rise(u: np.ndarray, low: float, high: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """From 0 to 1 between two places, at rest with its first two derivatives at both."""
    w = high - low
    s = np.clip((u - low) / w, 0, 1)
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        30 * s**2 * (1 - s) ** 2 / w,
        60 * s * (1 - s) * (1 - 2 * s) / w**2,
    )


def shortest(truth: Model, mass: float) -> Picks:
    """The shortest way that keeps all limits with the load, to a twentieth."""
    way = 0.15
    while way < 3.0:
        picks = Picks(truth.home, way)
        trajectory = MotionTrajectory(truth.dynamics.kinematics, picks, picks.duration)
        if not motion_problems(truth.with_load(point_mass(mass)), trajectory):
            return picks
        way *= 1.05
    raise SystemExit(f"{truth.name} does not move {mass:g} kg")


def knowledge_of(model: ControlModel, picks: Picks, mass: float, late: float = 0.0) -> Knowledge:
    """The model with the load while it is held, from some time after the pick on."""
    with_load, times = model.holding(mass), picks.held(mass)

    def model_at(time: float) -> ControlModel:
        return with_load if any(h.start + late <= time < h.end for h in times) else model

    return model_at


class Estimating:
    """A controller whose model holds what `deltaid.Online` takes the load for.

    Each cycle it gets the last one's positions, velocities and torques that were asked for, and
    whether the gripper holds; so it knows nothing of a load when that is picked, and learns.
    """

    def __init__(self, law: Controller, model: Model, picks: Picks, rate: float) -> None:
        self._law, self._picks, self._period = law, picks, 1 / rate
        settings = OnlineSettings(rate=rate, torque="held", largest_mass=5.0)
        self._online, self._cycle = Online(model, settings), 0
        self._last: tuple[np.ndarray, ...] | None = None

    def torque(self, model: ControlModel, q: Samples, qd: Samples, desired: Desired) -> Samples:
        """The law's, with the load as it is estimated now."""
        time = self._cycle * self._period
        gripper = any(held.start <= time < held.end for held in self._picks.held(0.0))
        self._cycle += 1
        if self._last is not None:
            now = self._online.step(*self._last, gripper=gripper)
            if now.held and now.mass > 0:
                model = model.holding(float(now.mass))
        tau = self._law.torque(model, q, qd, desired)
        self._last = q[0], qd[0], tau[0]
        return tau


def errors(result: Tracking, picks: Picks) -> str:
    """rms while a load is held, the largest, and where the load is let go."""
    if result.ended is not None:
        return f"lost after {result.ended:.2f} s"
    held = np.zeros(len(result.time), dtype=bool)
    ends = []
    for pick in picks.held(0.0):
        held |= (result.time >= pick.start) & (result.time < pick.end)
        ends.append(int(np.searchsorted(result.time, pick.end)) - 1)
    e = 1e3 * result.platform_error
    return f"{np.sqrt((e[held] ** 2).mean()):.2f}, {e[held].max():.2f}, {e[ends].max():.2f}"


def main() -> None:
    robots = "clavel-delta3,irb360-6-1600"
    chosen = options(__doc__, robots=robots, loads="0.5,1,3", bandwidths="10,20")
    rows = []
    for name in chosen.robots.split(","):
        with tempfile.TemporaryDirectory() as folder:
            demonstrate(load_robot(name), Path(folder))
            truth, found = load(f"{folder}/truth.yaml"), load(f"{folder}/model.yaml")
        model = ControlModel(found.robot, found.p)
        for mass in map(float, chosen.loads.split(",")):
            picks = shortest(truth, mass)
            trajectory = MotionTrajectory(truth.dynamics.kinematics, picks, picks.duration)
            plant = Plant(truth, loads=picks.held(mass))
            for bandwidth in map(float, chosen.bandwidths.split(",")):
                law = gains("pd-feedforward", model, trajectory, bandwidth)
                drives = Drives(current_loop=500.0)
                online = Estimating(law, found, picks, drives.rate)
                runs: list[tuple[Plant, Controller, Knowledge]] = [
                    (Plant(truth), law, model),
                    (plant, law, model),
                    (plant, law, knowledge_of(model, picks, mass, LATE)),
                    (plant, online, model),
                    (plant, law, knowledge_of(model, picks, (1 + OFF) * mass)),
                    (plant, law, knowledge_of(model, picks, mass)),
                ]
                cells = [
                    errors(track(moved, by, known, trajectory, drives), picks)
                    for moved, by, known in runs
                ]
                row = (name, f"{mass:g}", f"{picks.way:.2f}", f"{bandwidth:g}", *cells)
                rows.append(row)
                print(*row, sep=" | ", file=sys.stderr, flush=True)
    leave(HEAD, rows, "Distance of the platform from where it should be, mm: rms and largest "
          "while a load is held, and where it is let go.")  # fmt: skip


if __name__ == "__main__":
    main()
