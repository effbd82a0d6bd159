"""Torques over time, measured and predicted."""

import plotly.graph_objects as go

from deltaid.model.model import ModelLike, load
from deltaid.recording.recording import Recording
from deltaid.view.comparison import compare
from deltaid.view.torques import over_time

# Height of one drive's two plots, and of what is around all of them [px].
_DRIVE, _AROUND = 170, 90


def torques(model: ModelLike, recording: Recording) -> go.Figure:
    """A model's torques along a recording, and what it leaves."""
    model = load(model)
    compared = compare(model.dynamics, model.p, recording)
    figure = over_time(compared, model.robot.drive_units).figure
    figure.update_layout(height=_DRIVE * len(model.robot.drives) + _AROUND)
    return figure
