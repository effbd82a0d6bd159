"""Figures of `reproduce irb360`: Figs. 7 and 8, and friction of drive 4 over its speed."""

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from deltaid.reproduce.irb360_result import BASE, CHOSEN, GEOM, RETUNED_4, Candidate, Irb360
from deltaid.view import style
from deltaid.view.friction import law
from deltaid.view.page import Figure

_COLORS = {
    BASE: style.SERIES[5],
    GEOM: style.IDENTIFIED,
    RETUNED_4: style.LIMIT,
    CHOSEN: style.RESIDUAL,
}


def figure_7(result: Irb360) -> Figure:
    """Fig. 7: measured torques of the slow motion, base parameters and the consistent fit."""
    drives = result.dynamics.robot.drives
    figure = make_subplots(rows=len(drives), cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for i, drive in enumerate(drives):
        _traces(figure, result, "slow", (BASE, GEOM), drive=i, row=i + 1)
        figure.update_yaxes(title_text=f"{drive} [N m]", row=i + 1, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(drives), col=1)
    figure.update_layout(height=180 * len(drives) + 100, hovermode="closest")
    return Figure(
        figure,
        "Fig. 7 with the stand-in: torques on the slow verification motion, measured and predicted "
        "by base parameters and by the consistent fit. Three drives fit; drive 4 does not, for "
        "either method.",
    )


def figure_8(result: Irb360) -> Figure:
    """Fig. 8: drive 4 retuned by hand, and with the law that cross-validation chose."""
    figure = make_subplots(
        rows=2,
        cols=1,
        vertical_spacing=0.16,
        subplot_titles=("slow verification motion", "fast verification motion"),
    )
    for row, motion in enumerate(("slow", "fast"), start=1):
        _traces(figure, result, motion, (GEOM, RETUNED_4, CHOSEN), drive=3, row=row)
        figure.update_yaxes(title_text="drive 4 [N m]", row=row, col=1)
        figure.update_xaxes(title_text="time [s]", row=row, col=1)
    figure.update_layout(height=620, hovermode="closest", legend={"y": 1.06})
    return Figure(
        figure,
        "Fig. 8 and beyond: torque of drive 4. Retuned by hand for the slow motion as in the "
        "paper, the model fails on the fast one. The law chosen from the fast identification "
        "recording fits both; the slow motion was not part of the fit.",
    )


def friction_curve(result: Irb360) -> Figure:
    """Friction of drive 4 over its speed: true, and as each model has it."""
    speed = np.geomspace(0.03, np.abs(result.tracks["fast"].speed[:, 3]).max(), 200)
    figure = go.Figure()
    figure.add_scatter(
        x=speed,
        y=result.friction.torque(speed),
        name="stand-in (truth)",
        mode="lines",
        line={"color": style.MEASURED, "width": 5},
    )
    for name in (GEOM, RETUNED_4, CHOSEN):
        figure.add_scatter(
            x=speed,
            y=curve(result.candidates[name], speed),
            name=name,
            mode="lines",
            line={"color": _COLORS[name], "width": 2},
        )
    slow = result.tracks["slow"].speed_max
    figure.add_vline(x=slow, line={"color": style.PRIOR, "dash": "dot"})
    figure.add_annotation(
        x=np.log10(slow), y=0.02, yref="paper", text="largest speed of the slow motion",
        showarrow=False, xanchor="right", xshift=-6,
    )  # fmt: skip
    figure.update_xaxes(title_text="speed of drive 4 [rad/s]", type="log")
    figure.update_yaxes(title_text="friction [N m]", rangemode="tozero")
    figure.update_layout(height=400)
    return Figure(
        figure,
        "Friction of drive 4 over its speed. Viscous and Coulomb friction fit the fast motion on "
        "average and no single speed; no choice of the two coefficients fits all speeds.",
    )


def curve(candidate: Candidate, speed: np.ndarray) -> np.ndarray:
    """Friction of drive 4 at positive speeds [N m]."""
    return law(candidate.robot, "drive4", speed, candidate.p)


def _traces(
    figure: go.Figure, result: Irb360, motion: str, names: tuple[str, ...], *, drive: int, row: int
) -> None:
    track = result.tracks[motion]
    time = track.time.astype(np.float32)
    lines = [("measured", track.measured, style.MEASURED, 3.0)]
    lines += [(n, result.verified[n, motion].predicted, _COLORS[n], 1.3) for n in names]
    for name, values, color, width in lines:
        figure.add_scatter(
            x=time,
            y=values[:, drive].astype(np.float32),
            name=name,
            legendgroup=name,
            showlegend=row == 1,
            mode="lines",
            line={"color": color, "width": width},
            row=row,
            col=1,
        )
