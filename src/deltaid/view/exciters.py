"""Robots that are prepared for excitation."""

from typing import TYPE_CHECKING

from deltaid.motion.excitation.excite import Exciter
from deltaid.view.card import Card
from deltaid.view.robots import drawn

if TYPE_CHECKING:
    import plotly.graph_objects as go


def card(value: Exciter) -> Card:
    """What is to be optimised."""
    robot, settings = value.dynamics.robot, value.settings
    facts = (
        ("criterion", settings.criterion),
        ("starts", str(settings.starts)),
        ("harmonics", str(settings.harmonics)),
        ("longest period", f"{settings.duration:.4g} s"),
        ("base parameters", str(len(value.base.groups))),
    )
    title = f"Exciter of {robot.title or robot.name}"
    return Card(title, (), "", facts, methods=(".optimise()", ".plot()"))


def figure(value: Exciter) -> "go.Figure":
    """The robot with the workspace that motions stay in."""
    return drawn(value.dynamics.robot)
