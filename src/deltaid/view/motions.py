"""Optimised motions."""

from typing import TYPE_CHECKING

import polars as pl

from deltaid.motion.excitation.excite import Excitation
from deltaid.motion.excitation.run import sample_run
from deltaid.view.card import Card
from deltaid.view.excitation_tables import limit_table, prediction_table
from deltaid.view.numbers import number, percent

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from deltaid.view.page import Page


def card(value: Excitation) -> Card:
    """Duration, criterion, fullest limit; folded what it will tell."""
    robot, settings, run = value.exciter.dynamics.robot, value.exciter.settings, value.run
    facts = [
        ("duration", f"{number(run.duration)} s"),
        ("criterion", f"{number(value.criterion_after)} ({settings.criterion}), "
         f"{number(value.criterion_before)} before"),
        ("base parameters", f"{len(value.predictions)} made visible"),
    ]  # fmt: skip
    fullest = max(value.limits, key=lambda limit: limit.share, default=None)
    if fullest is not None:
        facts.append(("fullest limit", f"{percent(fullest.share)} ({fullest.name})"))
    return Card(
        f"Motion of {robot.title or robot.name} from rest to rest, within all limits",
        (),
        "",
        tuple(facts),
        more=(("limits", limit_table(value)), ("what it will tell", prediction_table(value))),
        methods=(".plot()", ".to_frame()", '.save("motion.csv")', '.report("x.html")'),
    )


def frame(value: Excitation) -> pl.DataFrame:
    """The run at the rate of the settings: t, q1…, qd1…, qdd1…, x, y, z; in SI units."""
    kinematics = value.exciter.dynamics.kinematics
    return sample_run(kinematics, value.run, value.exciter.settings.rate)


def figure(value: Excitation) -> "go.Figure":
    """Platform, drives, speeds and torques over time."""
    from deltaid.view.excitation import over_time

    figure = over_time(value.exciter, value).figure
    figure.update_layout(height=640)
    return figure


def page(value: Excitation) -> "Page":
    """The page of `deltaid excite`."""
    from deltaid.view.excitation import excitation_page

    return excitation_page(value.exciter, value)
