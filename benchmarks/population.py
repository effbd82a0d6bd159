"""What a fleet knows of a type, and what it is worth to each of its robots and to the next one.

    pip install -e '.[test,benchmark]'
    python benchmarks/population.py [ROBOTS [TYPES]]

Types with bodies away from their description, robots with bodies and friction away from their type
(`plants.made_alike`), three recordings of 12 s each, 2 % torque noise. The same once more with
one robot whose parts were weighed. Leaves `tables/population.md`.
"""

import sys
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from _drawn_templates import SETTINGS
from _table import STATED, leave, table
from drawn_fleet import DrawnType, drawn_type

from deltaid.estimation.scatter import NORMAL
from deltaid.fleets.identify_gathered import identify_gathered
from deltaid.fleets.member import TypeMember, member
from deltaid.fleets.population import Population, next_robot
from deltaid.fleets.robot_recordings import merged_files
from deltaid.fleets.type_fit import fitted
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.robot.measured import Measured
from deltaid.robot.tolerances import Tolerances
from plants import BODY, FRICTION, made_alike

# The description is off by about as much as it says.
FIT = SETTINGS.changed(prior_spread=0.2)
TYPE, RECORDINGS, NEXT, SCALE = 0.3, 3, 20, 0.005
# What is weighed of one robot.
WEIGHED = {"clavel-delta3": ("S", "P"), "irb360-6-1600": ("S", "P", "TU", "TL", "EE")}


@dataclass
class Counts:
    """How many intervals hold, by what they are of."""

    held: dict[str, list[float]] = field(default_factory=dict)

    def count(self, what: str, inside: np.ndarray) -> None:
        self.held.setdefault(what, []).extend(np.ravel(inside).astype(float).tolist())

    def share(self, what: str) -> str:
        own = self.held.get(what, [])
        return f"{np.mean(own):.1%} of {len(own)}" if own else "–"


def described(name: str) -> RobotDescription:
    """A catalogue robot whose lengths are exact, as those of drawn recordings are."""
    exact = Tolerances(lengths=0.0, homing=0.0, mounting=0.0)
    return load_robot(name).changed(tolerances=exact)


def weighed(
    robot: RobotDescription, p: np.ndarray, kind: DrawnType, rng: np.random.Generator
) -> RobotDescription:
    """A robot's own description, with masses of parts from a scale."""
    bodies = dict(robot.bodies)
    for body in WEIGHED[robot.name]:
        mass = float(p[kind.dynamics.layout.body(body).start])
        read = mass * (1 + SCALE * rng.standard_normal())
        bodies[body] = bodies[body].changed(measured=(Measured(mass=read, std=SCALE * mass),))
    return robot.changed(bodies=bodies)


def fleet(
    kind: DrawnType, mean: np.ndarray, robots: int, rng: np.random.Generator, seed: int
) -> tuple[list[TypeMember], np.ndarray, TypeMember]:
    """Robots of a type, their truths, and the first of them with its parts weighed."""
    truths = np.array([
        made_alike(kind.robot, mean, rng) for _ in range(robots)
    ])  # fmt: skip
    files = [
        [kind.drawn(f"robot {k}", day, p, seed=seed) for day in range(RECORDINGS)]
        for k, p in enumerate(truths)
    ]
    members = [
        member(f"robot {k:03}", merged_files(recordings, kind.robot, FIT), FIT)
        for k, recordings in enumerate(files)
    ]
    own = weighed(kind.robot, truths[0], kind, rng)
    return members, truths, member("robot 000", merged_files(files[0], own, FIT), FIT)


def next_ones(
    kind: DrawnType,
    found: Population,
    mean: np.ndarray,
    rng: np.random.Generator,
    seed: int,
    counts: Counts,
    what: str,
) -> np.ndarray:
    """Standard deviations of new robots by the type's description over those by the plain one."""
    robot, ratios = next_robot(found, "a simulated fleet"), []
    bodies = [k for k in np.flatnonzero(found.free) if k < 10 * len(found.layout.bodies)]
    for k in range(NEXT):
        p = made_alike(kind.robot, mean, rng)
        files = [kind.drawn(f"next {k}", day, p, seed=seed) for day in range(RECORDINGS)]
        plain = identify_gathered(kind.robot, files, FIT).model.parameters
        own = identify_gathered(robot, files, FIT).model.parameters
        counts.count(what, np.array([own[i].low <= p[i] <= own[i].high for i in bodies]))
        ratios.append([own[i].std / plain[i].std for i in bodies])
    return np.exp(np.mean(np.log(ratios), axis=0))


def study(name: str, robots: int, types: int) -> tuple[list[tuple[object, ...]], Counts]:
    """One robot of the catalogue: rows of its bodies' entries, and what holds."""
    kind, counts = drawn_type(described(name), motions=3), Counts()
    columns = defaultdict[str, list[np.ndarray]](list)
    for seed in range(types):
        rng = np.random.default_rng([seed, 11])
        mean = surrogate_parameters(kind.robot, rng, TYPE)
        members, truths, with_scale = fleet(kind, mean, robots, rng, seed)
        for what, counted in (("none", members), ("one", [with_scale, *members[1:]])):
            found = fitted(counted, kind.robot, FIT)
            _count(found, truths, mean, counts, what)
            at = np.flatnonzero(found.free)
            bodies = at < 10 * len(found.layout.bodies)
            size = np.abs(mean[at[bodies]])
            others = found.members[1:]
            stds = {
                "alone": np.mean([robot.alone_std for robot in others], axis=0),
                f"within, {what}": np.mean([robot.within.std for robot in others], axis=0),
                "differ": truths.std(axis=0),
            }
            for key, std in stds.items():
                columns[key].append(std[at][bodies] / np.where(size > 0, size, np.nan))
            ratio = next_ones(kind, found, mean, rng, seed, counts, f"next, {what}")
            columns[f"next, {what}"].append(ratio)
            names = [found.layout.names[k] for k in at[bodies]]
            print(name, seed, what, counts.held.keys(), flush=True)
    mean_of = {key: np.mean(values, axis=0) for key, values in columns.items()}
    rows = [
        (name, entry, *(_percent(mean_of[key][k]) for key in ("differ", "alone", "within, none",
                                                            "within, one")),
         *(f"{mean_of[key][k]:.2f}" for key in ("next, none", "next, one")))
        for k, entry in enumerate(names)
    ]  # fmt: skip
    return rows, counts


def _percent(share: float) -> str:
    return f"{share:.1%}" if np.isfinite(share) else "(mean 0)"


def _count(
    found: Population, truths: np.ndarray, mean: np.ndarray, counts: Counts, what: str
) -> None:
    at = found.free
    for robot, p in zip(found.members, truths, strict=True):
        inside = np.abs(robot.within.value - p) <= robot.within.half
        counts.count(f"robots, {what}", inside[at])
        counts.count(f"named, {what}", np.array([not robot.belongs]))
    inside = np.abs(found.mean.value - mean) <= found.mean.half
    counts.count(f"mean, {what}", inside[at])
    truly = {"viscous": FRICTION, "coulomb": FRICTION, "rotor": FRICTION}
    deviation = NORMAL * np.sqrt(np.diag(found.spreads.covariance))
    for kind, log, half in zip(found.spreads.kinds, found.spreads.log, deviation, strict=True):
        counts.count(f"spreads, {what}", np.array(abs(log - np.log(truly.get(kind, BODY))) <= half))


def strangers(robots: int) -> list[tuple[object, ...]]:
    """Robots that do not belong, one kind after the other, among others that do."""
    kind = drawn_type(described("clavel-delta3"), motions=3)
    rng, rows = np.random.default_rng(5), list[tuple[object, ...]]()
    mean = surrogate_parameters(kind.robot, rng, TYPE)
    members, _, _ = fleet(kind, mean, robots, rng, 0)
    layout, before = kind.dynamics.layout, fitted(members, kind.robot, FIT)

    def stranger(k: int, what: str) -> TypeMember:
        p = made_alike(kind.robot, mean, rng)
        gain = 1.15 if what == "torque constants 15 % off" else 1.0
        if what == "tool 25 % of the platform heavier":
            p[layout.body("P").start] *= 1.25
        if what == "another type":
            p = surrogate_parameters(kind.robot, np.random.default_rng([k, 3]), TYPE)
        if what == "friction of one drive doubled":
            p[layout.viscous.start + 1] *= 2.0
        drawn = [kind.drawn(f"stranger {what} {k}", d, p, gain=gain) for d in range(RECORDINGS)]
        return member(f"stranger {k}", merged_files(drawn, kind.robot, FIT), FIT)

    for what in ("tool 25 % of the platform heavier", "torque constants 15 % off", "another type",
                 "friction of one drive doubled"):  # fmt: skip
        for share in (1, robots // 4):
            some = [stranger(k, what) for k in range(max(share, 1))]
            found = fitted([*members, *some], kind.robot, FIT)
            own = [each for each in found.members if each.name.startswith("stranger")]
            bodies = np.flatnonzero(before.free[: 10 * len(layout.bodies)])
            shift = np.abs(found.mean.value - before.mean.value)[bodies]
            moved = np.max(shift / before.mean.std[bodies])
            named, every = (sum(not x.belongs for x in xs) for xs in (own, found.members))
            rows.append((what, f"{len(some)} of {robots + len(some)}", f"{named} of {len(own)}",
                         every - named, f"{moved:.1f}", own[0].reason))  # fmt: skip
            print(*rows[-1], flush=True)
    return rows


def main() -> None:
    robots = int(sys.argv[1]) if len(sys.argv) > 1 else STATED["population"]["robots"]
    types = int(sys.argv[2]) if len(sys.argv) > 2 else STATED["population"]["types"]
    rows, holds = list[tuple[object, ...]](), list[tuple[object, ...]]()
    for name in WEIGHED:
        found, counts = study(name, robots, types)
        rows += found
        for what, words in (("none", "none weighed"), ("one", "parts of one robot weighed")):
            keys = ("robots", "mean", "spreads", "next", "named")
            holds.append((name, words, *(counts.share(f"{key}, {what}") for key in keys)))
    head = ("robot", "fleet", "parameters of robots", "means of types", "spreads", "next robot",
            "named that belong")  # fmt: skip
    others = ("what is different", "robots", "named", "others named", "bodies' mean moved by, std",
              "reason given")  # fmt: skip
    note = (
        f"{types} types of {robots} robots each; bodies' entries differ by {BODY:.0%} of their "
        f"sizes, friction by {FRICTION:.0%}; {RECORDINGS} recordings of 12 s a robot.\n\n"
        f"Share of 95 % intervals that hold the truth:\n\n{table(head, holds)}\n\n"
        f"Robots that do not belong:\n\n{table(others, strangers(min(robots, 60)))}\n\n"
        "Standard deviations of bodies' entries as shares of their values: of a robot by its own "
        "recordings, within its fleet, and within one of which one other robot's parts were "
        "weighed; and of a new robot by the type's description over that by the plain one"
    )
    leave(("robot", "entry", "robots differ by", "alone", "within the fleet",
           "with one robot weighed", "next robot", "next, one weighed"), rows, note,
          robots=robots, types=types)  # fmt: skip


if __name__ == "__main__":
    main()
