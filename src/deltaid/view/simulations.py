"""Simulated tracking of one controller, and of all of them with all models."""

from typing import TYPE_CHECKING

import polars as pl

from deltaid.control.simulate import Comparison, Simulation
from deltaid.view.card import Card
from deltaid.view.style import IDENTIFIED
from deltaid.view.tracking import (
    comparison_page,
    comparison_table,
    drive_table,
    infeasible_lines,
    tracking_page,
)
from deltaid.view.tracking_figures import error_figures

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from deltaid.view.page import Page


def simulation_card(value: Simulation | Comparison) -> Card:
    """The errors, and what is not feasible."""
    robot, title = value.conditions.model.robot, f"Simulated tracking: {_title(value)}"
    if isinstance(value, Comparison):
        return Card(
            title,
            value.remarks,
            table=comparison_table(robot, value.runs),
            told=infeasible_lines(value.problems, value.runs),
            methods=('.report("x.html")',),
        )
    return Card(
        title,
        value.remarks,
        table=drive_table(robot, value.tracking),
        told=tuple(problem.text for problem in value.problems),
        methods=(".error", ".plot()", ".to_frame()", '.report("x.html")'),
    )


def simulation_frame(value: Simulation) -> pl.DataFrame:
    """Motion and torques over time, as a log."""
    return value.table()


def simulation_figure(value: Simulation) -> "go.Figure":
    """Error of the platform over time."""
    return error_figures([(_title(value), IDENTIFIED, value.tracking)])[0].figure


def simulation_page(value: Simulation | Comparison) -> "Page":
    """The page of `deltaid simulate` or of `deltaid compare-controllers`."""
    on = value.conditions
    rest = _title(value), on.drives, on.bandwidth, value.problems, value.remarks
    if isinstance(value, Comparison):
        return comparison_page(on.model.robot, value.runs, *rest)
    return tracking_page(on.plant.model.robot, value.tracking, *rest)


def _title(value: Simulation | Comparison) -> str:
    on = value.conditions
    what = f"{on.model.source} on {on.plant.model.source} along {on.path}"
    return what if isinstance(value, Comparison) else f"{value.controller} with {what}"
