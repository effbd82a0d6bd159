"""Production for an hour without a pause: false contacts, and whether pushes make it deaf.

    python benchmarks/online_hours.py [--minutes M] [--kinds NAME,…]

For each kind of robot one run of the cycle that is never begun anew: M minutes without pushes, five
with 30 N about every second, one without pushes, one with 5 to 15 N every second, one with 30 N.
The last three go the same way. Plants are MuJoCo's (`_long_production.py`); the model is an
identification of a recording. Leaves `tables/online_hours.md`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import _alone  # noqa: F401
import numpy as np
from _long_production import Chain, Walk
from _pick_cycles import RATE, Push, draw_pushes, is_near
from _pick_robots import production_of
from _table import STATED, leave
from _timing import options
from online import FORCE, KINDS, LATEST, SOON, STANDS

from deltaid.model.model import Model
from deltaid.online.contact import least_force, threshold
from deltaid.online.events import Touches
from deltaid.online.online import Online, OnlineEstimate
from deltaid.online.settings import OnlineSettings

# Plants, and whether their bodies and friction are unlike the model's.
PLANTS = {"as identified": False, "unlike": True}
WEAK = (5.0, 15.0)
# Minutes of strong ones; every so many rows what can be found, and so many of these at the end.
PUSHED, _EVERY = 5.0, 20
_LAST = round(10.0 * RATE / _EVERY)
HEAD = (
    "robot, payload", "plant", "false contacts in minute 1", "in the minutes after",
    "minutes", "picks", "mass 0.2 s after it moves off within 10 % or 60 g", "interval holds it",
    "pushes of 30 N in motion", "found within 20 ms", "weak pushes found",
    "smallest force, worst, before [N]", "behind weak pushes [N]",
    "pushes of 30 N then in motion", "found within 20 ms ",
)  # fmt: skip
NOTE = f"""One run without a pause. Stands of 30 to 100 ms before and 20 to 300 ms after each grip.
As identified: the plant is the model. Unlike: bodies are those that the recording was made with,
and friction is that of `online.md`. Torque noise 2 % of the largest torque, encoders of 20 bits,
positions differenced, noise of speeds not given, with the gripper's signal. Weak pushes:
{WEAK[0]:g} to {WEAK[1]:g} N, one a second for a minute. In motion: in the first 20 ms of the push
no drive stood or turned round. The smallest force is the median of the last ten seconds of the
minute before the weak ones, and of the last ten of theirs, along the same way."""


@dataclass
class Part:
    touches: list[float] = field(default_factory=list[float])
    soon: list[bool] = field(default_factory=list[bool])
    found: list[bool] = field(default_factory=list[bool])
    near: list[bool] = field(default_factory=list[bool])
    holds: list[bool] = field(default_factory=list[bool])
    least: list[np.ndarray] = field(default_factory=list[np.ndarray])
    seconds: float = 0.0

    def add_picks(self, walk: Walk, known: OnlineEstimate) -> None:
        """Masses 0.2 s after the robot moved off with each load."""
        soon, interval = round(SOON * RATE), known.mass_interval
        for start, end, mass in walk.grips:
            k = int(start) + soon
            if k < end:
                self.near.append(is_near(known.mass[k], mass))
                self.holds.append(bool(interval[k, 0] <= mass <= interval[k, 1]))

    def add_pushes(self, pushes: Sequence[Push], walk: Walk, known: OnlineEstimate) -> None:
        """Pushes while all drives move."""
        speed = np.abs(np.diff(walk.q, axis=0))
        contact = known.contact & ~np.concatenate([[False], known.contact[:-1]])
        for push in pushes:
            first, rows = round(push.start * RATE), round(LATEST * RATE)
            if np.all(speed[first : first + rows].min(axis=0) > STANDS / RATE):
                self.soon.append(bool(contact[first : first + rows + 1].any()))
                self.found.append(bool(contact[first : round(push.end * RATE)].any()))


class Run:
    def __init__(self, model: Model, chain: Chain) -> None:
        settings = OnlineSettings(speed="differenced", largest_mass=chain.payload)
        self.online, self.chain, self.model = Online(model, settings), chain, model
        dof = len(model.robot.drives)
        self.u = threshold(settings.false_alarms, settings.corner, dof)
        self.noise, self.time = np.random.default_rng(5), 0.0

    def part(self, seconds: float, seed: int, forces: tuple[float, float] | None = None) -> Part:
        part, rng = Part(), np.random.default_rng(seed)
        of_pushes = np.random.default_rng([seed, 1])
        while part.seconds < seconds - 1e-9:
            pushes = list[Push]()

            def draw(rows: int, drawn: list[Push] = pushes) -> Sequence[Push]:
                if forces:
                    drawn += draw_pushes(self.model, rows / RATE, of_pushes, 1.0)
                    for k, push in enumerate(drawn):
                        size = of_pushes.uniform(*forces)
                        drawn[k] = Push(push.start, push.end, push.place, size * push.force)
                return drawn

            walk = self.chain.walk(rng, self.noise, draw)
            known = self.online.run(walk.q, None, walk.tau, walk.gripper.astype(float))
            time = self.time + np.arange(len(walk.q)) / RATE
            touches = Touches(self.model.robot)
            touches.add(time, known)
            part.touches += [touch.start for touch in touches.finished()]
            part.add_picks(walk, known)
            part.add_pushes(pushes, walk, known)
            moves = round(np.sqrt(known.outputs["contact_information"].shape[1]))
            information = known.outputs["contact_information"][::_EVERY].reshape(-1, moves, moves)
            part.least.append(least_force(information, self.u)[1])
            self.time += len(walk.q) / RATE
            part.seconds += len(walk.q) / RATE
        return part

    def row(self, name: str, payload: float, plant: str, minutes: float) -> tuple[object, ...]:
        quiet = self.part(60.0 * minutes, 0)
        early = sum(start < 60.0 for start in quiet.touches)
        pushed = self.part(60.0 * PUSHED, 1, (FORCE, FORCE))
        before, weak, strong = (
            self.part(60.0, 2, forces) for forces in (None, WEAK, (FORCE, FORCE))
        )
        least = [float(np.median(np.concatenate(part.least)[-_LAST:])) for part in (before, weak)]
        return (
            f"{name}, {payload:g} kg", plant, early, len(quiet.touches) - early,
            f"{quiet.seconds / 60:.1f}", len(quiet.near), f"{np.mean(quiet.near):.1%}",
            f"{np.mean(quiet.holds):.1%}", len(pushed.soon), f"{np.mean(pushed.soon):.1%}",
            f"{np.mean(weak.found):.0%}", f"{least[0]:.3g}", f"{least[1]:.3g}",
            len(strong.soon), f"{np.mean(strong.soon):.1%}",
        )  # fmt: skip


def main() -> None:
    given = options(__doc__, minutes=STATED["online_hours"]["minutes"], kinds=",".join(KINDS))
    names, rows = given.kinds.split(","), []
    kinds = {name: production_of(name, KINDS[name], 1, seed=21) for name in names}
    for plant, unlike in PLANTS.items():
        for name, kind in kinds.items():
            p = kind.truth[0] if unlike else kind.models[0].p
            chain = Chain.of_kind(kind, p, kind.strange[0] if unlike else None, 21)
            run = Run(kind.models[0], chain)
            rows.append(run.row(name, kind.payload, plant, given.minutes))
            leave(HEAD, rows, NOTE, minutes=given.minutes)


if __name__ == "__main__":
    main()
