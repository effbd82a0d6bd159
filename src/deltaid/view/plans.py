"""Plans of what to measure."""

from typing import TYPE_CHECKING

import polars as pl

from deltaid.sensors.planning.plan import SensorPlan
from deltaid.view.card import Card
from deltaid.view.numbers import percent
from deltaid.view.sensor_tables import chosen_entries, count_table, step_table

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from deltaid.view.page import Page


def card(value: SensorPlan) -> Card:
    """What is known of the goal now and with all bought, and what to buy first."""
    robot, money = value.model.robot, value.offers.currency
    facts = [("now", percent(value.described.goal))]
    lines = [f"Goal: {value.goal}, as a typical standard deviation; planned for {value.motion}."]
    if value.steps:
        first = value.steps[0][0]
        spent = value.steps[-1][0].spent
        facts.append(("with all bought", f"{percent(value.last.goal)} for {spent:.0f} {money}"))
        facts.append(("buy first", f"{first.use.name}, {first.cost:.0f} {money}"))
    else:
        lines.append("Nothing that is on offer is worth buying.")
    return Card(
        f"What to measure of {robot.title or robot.name}",
        tuple(lines),
        "",
        tuple(facts),
        more=(("what to buy next", step_table(value)), ("what stays open", count_table(value))),
        methods=(".steps", ".plot()", ".to_frame()", '.report("x.html")'),
    )


def frame(value: SensorPlan) -> pl.DataFrame:
    """Entries, a row each: prior, and standard deviations as shares of their size."""
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


def figure(value: SensorPlan) -> "go.Figure":
    """Standard deviations of all entries before and after."""
    from deltaid.view.sensors import sensors_page
    from deltaid.view.theme import first_figure

    return first_figure(sensors_page(value, chosen_entries(value)).sections)


def page(value: SensorPlan) -> "Page":
    """The page of `deltaid sensors`."""
    from deltaid.view.sensors import sensors_page

    return sensors_page(value, chosen_entries(value))
