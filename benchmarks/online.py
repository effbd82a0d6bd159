"""What `deltaid online` finds in simulated production: masses, pushes, false alarms.

    python benchmarks/online.py [--minutes M] [--robots N] [--kinds NAME,…] [--processes N]

Robots pick, place and are pushed as `drawn_picks.py` draws them: true bodies and friction are away
from the description, friction that no model has is on top, each robot's model is an identification
of its own recording. For each kind, M minutes of production without pushes (picks, false alarms)
and as many with a push of 30 N about every second, from cold gears on. Leaves `tables/online.md`.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace

import _alone  # noqa: F401
import numpy as np
from _pick_cycles import RATE, Pick, Push, is_near
from _pick_robots import Production, production_of
from _table import STATED, leave
from _timing import options
from drawn_picks import Produced, produced

from deltaid.online.replay import open_replay
from deltaid.online.settings import OnlineSettings
from deltaid.online.watch import Watched, watch
from deltaid.recording.memory import Recording

# Kinds of robots and the largest mass that they pick [kg].
KINDS = {
    "irb360-6-1600": 3.0, "abb-irb360-1-1130": 1.0, "clavel-delta3": 1.0, "fanuc-dr-3ib-8l": 4.0,
    "par4": 2.0, "linear-delta-45": 2.0,
}  # fmt: skip
FORCE, SOON, LATEST = 30.0, 0.2, 0.02
# A drive below this speed stands [rad/s or m/s].
STANDS = 0.02
# A run [s].
RUN = 60.0
HEAD = (
    "robot, payload", "gripper", "picks", "mass after 0.2 s within 10 % or 60 g",
    "interval holds it", "error, median [g]", "± , median [g]", "pushes of 30 N",
    "found within 20 ms", "of those while it moves", "found at all", "place right",
    "smallest force reported, best, worst [N]", "production without pushes [min]", "false alarms",
)  # fmt: skip
NOTE = """Loads of 5 % to 100 % of the payload; a pick takes the mass 0.2 s after the grip, and the
interval then, which goes from nothing to what may be held unnoticed where no load was found yet.
Torque noise 2 % of the largest torque, encoders of 20 bits, cycles of 1 kHz. Friction that no model
has, drawn for each robot: Stribeck up to 40 % of Coulomb, fading at 2 to 12 % of the largest speed;
up to 4 % of what gears carry; ripple and a hose of up to 10 % of Coulomb each; cold gears up to
20 % of viscous. Found at all: before the push of 100 ms was over. While it moves: pushes in whose
first 20 ms no drive stood or turned round; at rest friction takes up a push, and no torque shows
it. Without the gripper's signal, a load has to be detected from torques, and a push that looks like
one counts as missed."""


@dataclass
class Count:
    near: list[bool] = field(default_factory=list[bool])
    holds: list[bool] = field(default_factory=list[bool])
    errors: list[float] = field(default_factory=list[float])
    widths: list[float] = field(default_factory=list[float])
    delays: list[float] = field(default_factory=list[float])
    moving: list[bool] = field(default_factory=list[bool])
    places: list[bool] = field(default_factory=list[bool])
    best: list[float] = field(default_factory=list[float])
    worst: list[float] = field(default_factory=list[float])
    alarms: int = 0
    seconds: float = 0.0

    def add_picks(self, picks: Sequence[Pick], found: Watched) -> None:
        """Masses 0.2 s after each pick."""
        columns = found.series.select("t", "mass", "mass_low", "mass_high")
        time, masses, lows, highs = columns.to_numpy().T
        for pick in picks:
            if pick.end - pick.start <= SOON or pick.start + SOON >= time[-1]:
                continue
            k = int(np.searchsorted(time, pick.start + SOON))
            self.near.append(is_near(masses[k], pick.mass))
            self.holds.append(bool(lows[k] <= pick.mass <= highs[k]))
            self.errors.append(abs(masses[k] - pick.mass))
            self.widths.append(0.5 * (highs[k] - lows[k]))

    def add_pushes(self, pushes: Sequence[Push], found: Watched, q: np.ndarray) -> None:
        """When and where each push was found, and whether drives moved."""
        time = found.series["t"].to_numpy()
        for push in pushes:
            if push.end >= time[-1]:
                continue
            own = [touch for touch in found.touches if push.start <= touch.start <= push.end]
            self.delays.append(own[0].start - push.start if own else np.inf)
            at = int(np.searchsorted(time, push.start))
            ways = np.abs(np.diff(q[at : at + round(LATEST * RATE)], axis=0))
            self.moving.append(bool(np.all(ways.min(axis=0) > STANDS / RATE)))
            if own:
                strongest = max(own, key=lambda touch: touch.size)
                self.places.append(strongest.place == push.place)

    def row(self, name: str, payload: float, has_signal: bool) -> tuple[object, ...]:
        delays = np.array(self.delays)
        return (
            f"{name}, {payload:g} kg", "signal" if has_signal else "no signal", len(self.near),
            f"{np.mean(self.near):.1%}", f"{np.mean(self.holds):.1%}",
            f"{1e3 * np.median(self.errors):.0f}", f"{1e3 * np.median(self.widths):.0f}",
            len(delays), f"{np.mean(delays <= LATEST):.1%}",
            f"{np.mean(delays[self.moving] <= LATEST):.1%}",
            f"{np.mean(np.isfinite(delays)):.1%}",
            f"{np.mean(self.places):.1%}" if self.places else "",
            f"{np.median(self.best):.2g}, {np.median(self.worst):.2g}",
            f"{self.seconds / 60:.1f}", self.alarms,
        )  # fmt: skip


def recordings(log: Produced, kind: Production) -> Iterator[tuple[int, Recording]]:
    """A recording of each robot that did not leave its workspace."""
    for i in range(len(kind.models)):
        if log.lost[i]:
            continue
        signal = {"gripper": log.gripper[:, i].astype(float)}
        q, tau = log.q[:, i], log.tau[:, i]
        yield i, Recording.from_arrays(t=log.time, q=q, tau=tau, extra=signal, name=f"robot {i}")


def counted(name: str, payload: float, robots: int, minutes: float) -> list[tuple[object, ...]]:
    found = production_of(name, payload, robots, seed=11)
    copies = max(1, round(minutes * 60 / RUN / robots))
    kind = replace(
        found,
        truth=np.tile(found.truth, (copies, 1)),
        models=found.models * copies,
        strange=found.strange * copies,
        largest=np.tile(found.largest, (copies, 1)),
    )
    counts = {True: Count(), False: Count()}
    for run, push in enumerate((0.0, FORCE)):
        log = produced(kind, RUN, 100 + run, push)
        for i, recording in recordings(log, kind):
            for has_signal, count in counts.items():
                replay = open_replay(
                    kind.models[i], recording, gripper="gripper" if has_signal else None
                )
                found = watch(kind.models[i], replay, OnlineSettings(largest_mass=payload))
                count.best.append(found.best)
                count.worst.append(found.worst)
                if push:
                    count.add_pushes(log.pushes[i], found, log.q[:, i])
                    continue
                count.add_picks(log.picks[i], found)
                count.alarms += len(found.touches)
                count.seconds += float(log.time[-1])
        print(name, run, flush=True)
    return [count.row(name, payload, has_signal) for has_signal, count in counts.items()]


def main() -> None:
    minutes, robots = float(STATED["online"]["minutes"]), STATED["online"]["robots"]
    kinds = ",".join(KINDS)
    given = options(__doc__, minutes=minutes, robots=robots, kinds=kinds, processes=2)
    names = given.kinds.split(",")
    own = [KINDS[name] for name in names], [given.robots] * len(names), [given.minutes] * len(names)
    rows = []
    with ProcessPoolExecutor(given.processes) as pool:
        for of_kind in pool.map(counted, names, *own):
            rows += of_kind
            leave(HEAD, rows, NOTE, robots=given.robots, minutes=int(given.minutes))


if __name__ == "__main__":
    main()
