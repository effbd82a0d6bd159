"""Measurement plans: tables for terminal and page, a card."""

from collections.abc import Sequence

import numpy as np
import polars as pl

from deltaid.errors import counted
from deltaid.sensors.planning.null_space import DESCRIBED, PLAN, TORQUES, Opening
from deltaid.sensors.planning.plan import Outlook, SensorPlan
from deltaid.sensors.planning.shopping import KNEE
from deltaid.view.numbers import number, percent
from deltaid.view.page import Table
from deltaid.view.show import Card

# Range of uncertainty, as a share of the prior's, in which an entry is shown by default.
_LEFT, _LEARNT = 0.05, 0.97


def chosen_entries(plan: SensorPlan) -> tuple[str, ...]:
    """Entries for the table of uses by default: torques affect them but leave them uncertain."""
    share = plan.described.shares / plan.unknowns.spread
    free = [
        f"{name}.{entry}"
        for name in plan.model.robot.body_names
        for entry in plan.model.robot.bodies[name].free
    ]
    names = [
        name
        for k, name in enumerate(plan.unknowns.names)
        if name in free and plan.unknowns.prior[k] and _LEFT < share[k] < _LEARNT
    ]
    return tuple(names[:7])


def undetermined(plan: SensorPlan) -> tuple[str, ...]:
    """Entries that neither torques nor any offer determines."""
    every = (plan.torques, plan.described, *plan.uses)
    least = np.min([outlook.shares for outlook in every], axis=0) / plan.unknowns.spread
    names = zip(plan.unknowns.names, plan.unknowns.owners, least, strict=True)
    return tuple(name for name, owner, share in names if owner and share > _LEARNT)


def known_entries(plan: SensorPlan) -> list[int]:
    """Indices of the entries and gains that some measurement determines."""
    hidden, u = undetermined(plan), plan.unknowns
    owned = (k for k, name in enumerate(u.names) if u.owners[k] or name.startswith("gain."))
    return [k for k in owned if u.names[k] not in hidden]


def stages(plan: SensorPlan) -> dict[str, Outlook]:
    """Standard deviations with torques, with described sensors, and with all purchases."""
    described = {"described": plan.described} if plan.has_described else {}
    bought = {"with all bought": plan.last} if plan.steps else {}
    return {"torques": plan.torques, **described, **bought}


def bought(plan: SensorPlan) -> tuple[tuple[str, str, str], ...]:
    """Remaining uncertainty and cost of all worthwhile purchases, and the first one; empty if there
    are none."""
    if not plan.steps:
        return ()
    (first, _), (step, last), money = plan.steps[0], plan.steps[-1], plan.offers.currency
    return (
        ("with all bought", percent(last.goal), f"{step.spent:.0f} {money}"),
        ("buy first", first.use.name, f"{first.cost:.0f} {money}"),
    )


def entry_table(plan: SensorPlan) -> Table:
    """Entries of all bodies that some measurement determines, before and after."""
    u, known = plan.unknowns, stages(plan)
    return Table(
        ("entry", "prior", "unit", "prior ±", *known),
        tuple(
            (
                u.names[k],
                number(u.prior[k]),
                u.units[k] or "1",
                percent(u.spread[k]),
                *(percent(outlook.shares[k]) for outlook in known.values()),
            )
            for k in known_entries(plan)
        ),
        "Standard deviation of each entry, in per cent of its prior value; of an entry whose "
        "prior is zero, of what it is at most for a body with its other entries.",
        title="what is known of each entry, one standard deviation",
    )


def use_table(plan: SensorPlan, entries: Sequence[str]) -> Table:
    """Effect of each measurement alone on some entries and combinations."""
    shown = [plan.entry(name) for name in entries]
    start = [plan.torques, *([plan.described] if plan.has_described else [])]
    uses = [*plan.uses, *plan.combinations]
    rows = [
        *((outlook.title, "", "") for outlook in start),
        *((use.name, f"{use.cost:.0f}", f"{use.gain:.2f}") for use in uses),
    ]
    return Table(
        ("with", plan.offers.currency, "gain", *entries),
        tuple(
            (*row, *(percent(outlook.shares[k]) for k in shown))
            for row, outlook in zip(rows, (*start, *uses), strict=True)
        ),
        "Standard deviation of some entries, in per cent of their prior, with one thing of the "
        f"list at a time. The gain is for {plan.goal}: by how much ½ log det of their covariance "
        "falls, in nats; 0.7 halve one standard deviation.",
        muted=frozenset(range(len(start))),
        title="what each by itself would make of it",
    )


def step_table(plan: SensorPlan) -> Table:
    money = plan.offers.currency
    return Table(
        ("next", money, f"{money} in all", "gain", "left"),
        tuple(
            (
                step.use.name,
                f"{step.cost:.0f}",
                f"{step.spent:.0f}",
                f"{step.gain:.2f}",
                percent(outlook.goal),
            )
            for step, outlook in plan.steps
        ),
        f"Greedy: always what gains most for {plan.goal} per {money}. What a tool costs is paid "
        "once. Left is the geometric mean of the standard deviations.",
        title=f"what to buy next for {plan.goal}",
    )


def stopped(plan: SensorPlan) -> str:
    """Why the list of purchases ends, in words."""
    wanted, count, money = plan.settings.enough, len(plan.steps), plan.offers.currency
    if plan.last.goal <= wanted:
        return f"Enough: {percent(plan.last.goal)} is left, and --enough asks for {percent(wanted)}"
    if not plan.steps:
        return "Nothing that is on offer is worth buying"
    if count == plan.settings.steps:
        return f"{counted(count, 'thing')}, as many as were asked for; --steps asks for more"
    if plan.beyond is None:
        return "nothing else in the list is worth it, or within the budget"
    return (
        f"Enough for its price: {plan.beyond.use.name}, {plan.beyond.cost:.0f} {money}, gains less "
        f"than {percent(KNEE)} as much per {money} as all before it. --budget goes on"
    )


def count_table(plan: SensorPlan) -> Table:
    """Number of determined and undetermined combinations, by sensors; scales have one row each."""
    return Table(
        ("with", "visible", "rank", "open"),
        tuple(
            (
                opening.title,
                str(opening.null.visible),
                str(opening.null.rank),
                str(len(opening.null.directions)),
            )
            for opening in plan.openings
            if ":" not in opening.name or opening.name in (TORQUES, DESCRIBED, PLAN)
        ),
        "Parameters that show at all, combinations of them that are determined, and directions in "
        "which they may change unnoticed.",
        title="what can be determined at all",
    )


def open_table(opening: Opening) -> Table:
    """Undetermined entries, in words, and the measurements that would separate them."""
    rows = tuple(
        (open_.words, ", ".join(open_.entries), ", ".join(parted) or "nothing by itself")
        for open_, parted in zip(opening.null.directions, opening.parted, strict=True)
    )
    columns = ("may change unnoticed", "entries", "parted by any of")
    return Table(columns, rows, title=f"what stays open, {opening.title}")


def plan_card(value: SensorPlan) -> Card:
    """Uncertainty of the goal now and with all purchases, and the first purchase."""
    robot, joined = value.model.robot, (" for ", ", ")
    goal = f"Goal: {value.goal}, as a typical standard deviation; planned for {value.motion}."
    return Card(
        f"What to measure of {robot.label}",
        (goal, stopped(value)),
        "",
        (
            ("now", percent(value.described.goal)),
            *(
                (name, f"{what}{between}{price}")
                for (name, what, price), between in zip(bought(value), joined, strict=False)
            ),
        ),
        more=(("what to buy next", step_table(value)), ("what stays open", count_table(value))),
        methods=(".steps", ".plot()", ".to_frame()", '.report("x.html")'),
    )


def plan_frame(value: SensorPlan) -> pl.DataFrame:
    """Entries, one per row: prior, and standard deviations as shares of their size."""
    known = value.unknowns
    return pl.DataFrame(
        {
            "entry": list(known.names),
            "prior": known.prior,
            "unit": list(known.units),
            "spread": known.spread,
            "torques": value.torques.shares,
            "described": value.described.shares,
            "all_bought": value.last.shares,
        }
    )
