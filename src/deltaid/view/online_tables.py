"""Tables of a recording that was run through online, for the terminal and for a page."""

from deltaid.online.events import Touch, WeighedLoad
from deltaid.online.watch import Watched
from deltaid.view.numbers import number
from deltaid.view.table import Table

UNTOLD = (
    "No gripper was told: a push that looks like a load taken or left, straight up or down, is not "
    "told from one."
)


def loads_table(watched: Watched) -> Table:
    """Each load with its interval, when it was held, and its centre as far as that showed."""
    last = watched.loads[-1:]
    rows = [_load(one, "held still" if one in last else "a hole") for one in watched.loads]
    head = ("taken [s]", "left [s]", "mass [kg]", "95 %", "after 0.2 s [kg]", "centre [mm]")
    by = "as the gripper told" if watched.told else "found from torques alone"
    return Table(head, tuple(rows), title=f"Loads, {by}")


def _load(one: WeighedLoad, until: str) -> tuple[str, ...]:
    end = until if one.end is None else f"{one.end:.3f}"
    soon = "left before" if one.soon is None else f"{one.soon[0]:.3f}"
    centre = ", ".join(f"{axis} {1e3 * x:z.0f}" for axis, x in one.centre) or "not shown"
    mass = one.mass
    return (
        f"{one.start:.3f}",
        end,
        f"{mass.value:.3f}",
        between(mass.low, mass.high),
        soon,
        centre,
    )


def between(low: float, high: float) -> str:
    """An interval in a few characters."""
    return f"{low:.3f} to {high:.3f}"


def touches_table(watched: Watched) -> Table:
    """Each contact: when, how long, where, how hard."""
    head = ("at [s]", "for [ms]", "place", "size", "of threshold")
    rows = tuple(_touch(one, watched) for one in watched.touches)
    return Table(head, rows, title="Contacts")


def _touch(one: Touch, watched: Watched) -> tuple[str, ...]:
    unit = "N" if one.force else watched.robot.units(one.place).force
    return (
        f"{one.start:.3f}",
        f"{1e3 * (one.end - one.start):.0f}",
        one.place if one.place == "platform" else f"limb of {one.place}",
        f"{number(one.strength, 3)} {unit}",
        number(one.size, 3),
    )


def friction_table(watched: Watched) -> Table:
    """Friction in the model and at the end."""
    rows = tuple(
        (one.name, number(one.before, 3), number(one.value, 3), f"± {number(1.96 * one.std, 2)}",
         one.unit)
        for one in watched.friction
    )  # fmt: skip
    return Table(("friction", "model", "now", "95 %", "unit"), rows, title="Friction, followed")


def at_most(watched: Watched) -> str:
    """The rate of false alarms that was asked for."""
    ending = "s" * (watched.false_alarms != 1)
    return f"at most {watched.false_alarms:g} false alarm{ending} an hour"


def told_lines(watched: Watched) -> tuple[str, ...]:
    """What could be told at all, and how long a cycle took."""
    lines = [
        f"smallest force on the platform that is told: {number(watched.best, 2)} N along the best "
        f"direction, {number(watched.worst, 2)} N along the worst (95 % of cases, "
        f"{at_most(watched)})"
    ]
    if not watched.told:
        lines.append(UNTOLD)
    if watched.bad:
        lines.append(f"{watched.bad} of {watched.cycles} cycles could not be used")
    lines.append(
        f"{watched.cycles} cycles at {watched.rate:.5g} Hz, {1e6 * watched.seconds:.2g} µs each"
    )
    return tuple(lines)
