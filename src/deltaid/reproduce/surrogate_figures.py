"""Figures 3 to 6 of the paper for the surrogate here, the minimisers' runs, and the sweep over
γ."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from deltaid.identification.demo import mass_reference
from deltaid.reproduce.accuracy import CLAIMS, MotionTerms
from deltaid.reproduce.descent import Descents, Way
from deltaid.reproduce.surrogate import DESCENT_GAMMA, Reproduction, SurrogateFit
from deltaid.view import style
from deltaid.view.page import Figure

_NOMINAL, _PAPER = style.MEASURED, style.LIMIT
_COLOR = {"RG1": style.IDENTIFIED, "RG2": style.SERIES[2]}
# Name and colour of each minimiser.
WAY_LABELS: dict[Way, tuple[str, str]] = {
    "newton": ("Newton from π(p_reg)", style.SERIES[0]),
    "levenberg-marquardt": ("Levenberg–Marquardt from π(p_reg)", style.SERIES[1]),
    "bfgs": ("BFGS from π(p_reg)", style.SERIES[3]),
    "relaxed": ("Newton, γ relaxed (deltaid)", style.SERIES[2]),
}


def parameters_figure(result: Reproduction) -> Figure:
    """Fig. 3: regularisations and identified values of all free parameters, relative to the
    truth."""
    free = result.free
    names, truth = [result.dynamics.layout.names[i] for i in free], result.truth[free]
    figure = go.Figure()
    for prior, symbol in (("RG1", "triangle-left"), ("RG2", "triangle-right")):
        fits = [result.fit(prior, noisy=noisy) for noisy in (False, True)]
        p_reg = fits[0].identification.problem.reduction.p_reg[free]
        figure.add_scatter(
            x=p_reg / truth,
            y=names,
            name=prior,
            mode="markers",
            marker={"symbol": f"{symbol}-open", "size": 9, "color": _COLOR[prior]},
        )
        for fit in fits:
            noise = ", with noise" if fit.noisy else ""
            figure.add_scatter(
                x=fit.identification.model.p[free] / truth,
                y=names,
                name=f"{fit.name}{noise}",
                mode="markers",
                marker={
                    "symbol": "circle-open" if fit.noisy else "circle",
                    "size": 8 if fit.noisy else 6,
                    "color": _COLOR[prior],
                },
                visible="legendonly" if fit.noisy else True,
            )
    figure.add_vline(x=1, line={"color": _NOMINAL, "width": 2})
    figure.update_xaxes(title_text="value / nominal value", rangemode="tozero")
    figure.update_yaxes(autorange="reversed", dtick=1)
    figure.update_layout(height=20 * len(names) + 140, hovermode="closest")
    return Figure(
        figure,
        "Fig. 3 of the paper for our surrogate: regularisation (RG) and identified value (ID) of "
        "every parameter that the fit may change, divided by the nominal one. Values on the line "
        "have found the truth; others are not determined by torques one by one, and stay where "
        "their combinations allow. Values from the recording with noise appear by a click on the "
        "legend.",
    )


def mass_figure(result: Reproduction) -> Figure:
    """Fig. 4: relative errors of the entries of M over one period."""
    n = result.dynamics.dof
    entries = [(i, i) for i in range(n)] + [(i, j) for i in range(n) for j in range(i + 1, n)]
    rows = -(-len(entries) // 2)
    figure = _panels(
        rows,
        [f"M{i + 1}{j + 1}" for i, j in entries],
        height=170 * rows + 120,
        shared_xaxes=True,
        horizontal_spacing=0.12,
        vertical_spacing=0.2 / rows,
    )
    reference = mass_reference(result.terms.M)
    for k, (i, j) in enumerate(entries):
        for fit in result.certified:
            error = 100 * (result.terms.M[:, i, j] - fit.terms.M[:, i, j]) / reference[i, j]
            _line(figure, result, fit, error, k // 2 + 1, k % 2 + 1)
    figure.update_yaxes(title_text="[%]", col=1)
    figure.update_xaxes(title_text="time [s]", row=rows)
    return Figure(
        style.one_legend(figure),
        "Fig. 4 of the paper for our surrogate: error of each entry of the mass matrix over one "
        "period, nominal minus identified, relative to the entry's mean. Entries between the "
        "fourth drive and the others change sign along the motion, so that their mean says "
        "nothing; they are compared with √(M_ii M_jj). Lines without noise lie on zero.",
    )


def torque_figure(
    result: Reproduction, of: Callable[[MotionTerms], np.ndarray], caption: str
) -> Figure:
    """Figs. 5 and 6: one term of (1) over one period, and its difference from the nominal one."""
    drives = result.dynamics.robot.drives
    figure = _panels(
        len(drives),
        ["torque [N m]", "difference [N m]"],
        height=210 * len(drives) + 120,
        shared_xaxes=True,
        horizontal_spacing=0.19,
        vertical_spacing=0.2 / len(drives),
    )
    for i, drive in enumerate(drives):
        figure.add_scatter(
            x=result.period.time.astype(np.float32),
            y=of(result.terms)[:, i].astype(np.float32),
            name="nominal",
            mode="lines",
            line={"color": _NOMINAL, "width": 3.5},
            row=i + 1,
            col=1,
        )
        for fit in result.certified:
            if fit.noisy:
                _line(figure, result, fit, of(fit.terms)[:, i], i + 1, 1)
            error = of(result.terms)[:, i] - of(fit.terms)[:, i]
            _line(figure, result, fit, error, i + 1, 2)
        figure.update_yaxes(title_text=drive, row=i + 1, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(drives))
    figure.update_yaxes(exponentformat="power")
    return Figure(style.one_legend(figure), caption)


def sweep_figure(result: Reproduction) -> Figure:
    """Errors over γ, with the γ of the maximum-a-posteriori rule and the paper's errors."""
    figure = _panels(
        len(CLAIMS),
        ["without noise", "with noise"],
        height=210 * len(CLAIMS) + 120,
        shared_xaxes=True,
        horizontal_spacing=0.1,
        vertical_spacing=0.025,
    )
    for row, claim in enumerate(CLAIMS, start=1):
        for fit in result.certified:
            place = {"row": row, "col": 2 if fit.noisy else 1}
            figure.add_scatter(
                x=[point.gamma for point in fit.sweep],
                y=[100 * claim.value_of(point.accuracy) for point in fit.sweep],
                name=f"from {fit.prior}",
                mode="lines+markers",
                line={"color": _COLOR[fit.prior], "width": 1.6},
                marker={"size": 4},
                **place,
            )
            figure.add_scatter(
                x=[fit.identification.model.fit.gamma],
                y=[100 * claim.value_of(fit.accuracy)],
                name=f"γ by the rule, {fit.prior}",
                mode="markers",
                marker={"color": _COLOR[fit.prior], "size": 12, "symbol": "star"},
                **place,
            )
        figure.add_hline(y=100 * claim.share, line={"color": _PAPER, "dash": "dash"}, row=row)
        figure.update_yaxes(title_text=f"{claim.quantity} [%]", row=row, col=1)
    figure.update_xaxes(type="log", exponentformat="power")
    figure.update_yaxes(type="log", exponentformat="power", title_font_size=11)
    figure.update_xaxes(title_text="γ_p/γ_τ", row=len(CLAIMS))
    return Figure(
        style.one_legend(figure),
        "Largest errors of the global optimum over γ_p/γ_τ. Stars: the γ that maximum a posteriori "
        "chooses from the estimated noise. Dashed: what the paper reports. Without noise the "
        "errors are the regularisation's pull alone and grow with γ; with noise a smaller γ gains "
        "nothing once the noise decides.",
    )


def descent_figure(result: Reproduction) -> Figure:
    """J over steps and over time for all minimisers, with the certified bound."""
    figure = _panels(
        2,
        [f"from {prior}" for prior in result.descents] * 2,
        height=780,
        shared_yaxes=True,
        horizontal_spacing=0.06,
        vertical_spacing=0.16,
    )
    for col, descents in enumerate(result.descents.values(), start=1):
        for row in (1, 2):
            _add_descents(figure, descents, row, col)
    figure.update_xaxes(type="log", exponentformat="power", dtick=1)
    figure.update_xaxes(title_text="step", row=1)
    figure.update_xaxes(title_text="time [ms]", row=2)
    figure.update_yaxes(type="log", exponentformat="power")
    figure.update_yaxes(title_text="J", col=1)
    return Figure(
        figure,
        f"J of (15) on the recording without noise with γ_p/γ_τ = {DESCENT_GAMMA:.0e}, over steps "
        "and over time on this machine. A cross "
        "marks where no entry of ∇J exceeds 1e-6, a common default for being done. The conic "
        "program has no steps to draw: its optimum lies on the dashed line.",
    )


def _add_descents(figure: go.Figure, descents: Descents, row: int, col: int) -> None:
    """Add J of all minimisers, over steps in the first row and over time in the second."""
    for way in descents.ways:
        label, color = WAY_LABELS[way.way]
        shared = {"legendgroup": label, "row": row, "col": col}
        x = np.arange(len(way.objective)) if row == 1 else 1e3 * way.seconds
        figure.add_scatter(
            x=x[1:],
            y=way.objective[1:],
            name=label,
            showlegend=row == col == 1,
            mode="lines",
            line={"color": color, "width": 1.8},
            **shared,
        )
        if way.usual:
            figure.add_scatter(
                x=x[[way.usual]],
                y=way.objective[[way.usual]],
                name=f"{label}: |∇J| < 1e-6",
                showlegend=False,
                mode="markers",
                marker={"color": color, "size": 10, "symbol": "x"},
                **shared,
            )
    figure.add_scatter(
        x=[1, 1e3 if row == 1 else 1e3 * max(way.seconds[-1] for way in descents.ways)],
        y=[descents.conic.bound] * 2,
        name="certified lower bound (conic)",
        legendgroup="bound",
        showlegend=row == col == 1,
        mode="lines",
        line={"color": style.PRIOR, "dash": "dash"},
        row=row,
        col=col,
    )


def _line(
    figure: go.Figure,
    result: Reproduction,
    fit: SurrogateFit,
    values: np.ndarray,
    row: int,
    col: int,
) -> None:
    figure.add_scatter(
        x=result.period.time.astype(np.float32),
        y=values.astype(np.float32),
        name=f"{fit.name}, {'with' if fit.noisy else 'without'} noise",
        mode="lines",
        line={
            "color": _COLOR[fit.prior],
            "width": 1.5,
            "dash": "solid" if fit.noisy else "dot",
        },
        row=row,
        col=col,
    )


def _panels(rows: int, titles: Sequence[str], height: int, **apart: Any) -> go.Figure:
    """Panels, two per row, with a legend above their titles."""
    figure = make_subplots(rows=rows, cols=2, subplot_titles=titles, **apart)
    figure.update_annotations(font_size=12)
    return figure.update_layout(height=height, legend=style.LEGEND_ON_TOP, margin={"t": 115})
