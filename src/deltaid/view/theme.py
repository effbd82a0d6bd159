"""Figures for notebooks: no background, and grey that is read on light and on dark."""

from collections.abc import Iterable

import plotly.graph_objects as go

from deltaid.view import style
from deltaid.view.page import Figure, Section

# Contrast of 4.5 on white and on the dark pages of notebooks.
_TEXT, _LINE, _GRID = "#768390", "rgba(128,128,128,.5)", "rgba(128,128,128,.2)"


def themed(figure: go.Figure) -> go.Figure:
    """A copy with colours for both; no wider than its cell."""
    template = style.template(False)
    axis = {"gridcolor": _GRID, "linecolor": _LINE, "zerolinecolor": _LINE}
    template.layout.update(
        font={"color": _TEXT},
        xaxis=axis,
        yaxis=axis,
        scene=dict.fromkeys(("xaxis", "yaxis", "zaxis"), axis),
    )
    shown = go.Figure(figure)
    shown.update_layout(template=template, autosize=True)
    return shown


def first_figure(sections: Iterable[Section]) -> go.Figure:
    """The first figure of some sections of a report."""
    blocks = (block for section in sections for block in section.blocks)
    return next(block.figure for block in blocks if isinstance(block, Figure))
