"""Figures 3 to 6 of the paper for our surrogate, and the sweep over γ."""

from collections.abc import Callable

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from deltaid.identification.demo import mass_reference
from deltaid.reproduce.accuracy import CLAIMS, MotionTerms
from deltaid.reproduce.surrogate_result import Reproduction, SurrogateFit
from deltaid.view import style
from deltaid.view.page import Figure

_NOMINAL, _PAPER = style.MEASURED, style.LIMIT
_COLOR = {"RG1": style.IDENTIFIED, "RG2": style.SERIES[2]}


def identified(prior: str) -> str:
    """The paper's name for what is identified from a regularisation: ID1 from RG1."""
    return prior.replace("RG", "ID")


def parameters_figure(result: Reproduction) -> Figure:
    """Fig. 3: regularisations and identified values of all free parameters, over the true ones."""
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
                name=f"{identified(prior)}{noise}",
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
    figure = make_subplots(
        rows=rows,
        cols=2,
        shared_xaxes=True,
        subplot_titles=[f"M{i + 1}{j + 1}" for i, j in entries],
        horizontal_spacing=0.12,
        vertical_spacing=0.2 / rows,
    )
    reference = mass_reference(result.terms.M)
    for k, (i, j) in enumerate(entries):
        for fit in _pictured(result):
            error = 100 * (result.terms.M[:, i, j] - fit.terms.M[:, i, j]) / reference[i, j]
            _line(figure, result, fit, error, k // 2 + 1, k % 2 + 1, first=k == 0)
    figure.update_yaxes(title_text="[%]", col=1)
    figure.update_xaxes(title_text="time [s]", row=rows)
    figure.update_layout(height=170 * rows + 120)
    above_titles(figure)
    return Figure(
        figure,
        "Fig. 4 of the paper for our surrogate: error of each entry of the mass matrix over one "
        "period, nominal minus identified, relative to the entry's mean. Entries between the "
        "fourth drive and the others change sign along the motion, so that their mean says "
        "nothing; they are compared with √(M_ii M_jj). Lines without noise lie on zero.",
    )


def torque_figure(
    result: Reproduction, of: Callable[[MotionTerms], np.ndarray], caption: str
) -> Figure:
    """Figs. 5 and 6: one term of (1) over one period, and its difference to the nominal one."""
    drives = result.nominal.drives
    figure = make_subplots(
        rows=len(drives),
        cols=2,
        shared_xaxes=True,
        horizontal_spacing=0.19,
        vertical_spacing=0.2 / len(drives),
        subplot_titles=["torque [N m]", "difference [N m]"],
    )
    for i, drive in enumerate(drives):
        figure.add_scatter(
            x=result.period.time.astype(np.float32),
            y=of(result.terms)[:, i].astype(np.float32),
            name="nominal",
            legendgroup="nominal",
            showlegend=i == 0,
            mode="lines",
            line={"color": _NOMINAL, "width": 3.5},
            row=i + 1,
            col=1,
        )
        for fit in _pictured(result):
            if fit.noisy:
                _line(figure, result, fit, of(fit.terms)[:, i], i + 1, 1, first=i == 0)
            error = of(result.terms)[:, i] - of(fit.terms)[:, i]
            _line(figure, result, fit, error, i + 1, 2, first=i == 0 and not fit.noisy)
        figure.update_yaxes(title_text=drive, row=i + 1, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(drives))
    figure.update_yaxes(exponentformat="power")
    figure.update_layout(height=210 * len(drives) + 120)
    above_titles(figure)
    return Figure(figure, caption)


def sweep_figure(result: Reproduction) -> Figure:
    """Errors over γ, with the γ of the maximum-a-posteriori rule and the paper's errors."""
    figure = make_subplots(
        rows=len(CLAIMS),
        cols=2,
        shared_xaxes=True,
        subplot_titles=["without noise", "with noise"],
        horizontal_spacing=0.1,
        vertical_spacing=0.025,
    )
    for row, claim in enumerate(CLAIMS, start=1):
        for sweep in result.sweeps:
            place = {"row": row, "col": 2 if sweep.noisy else 1}
            own = {"legendgroup": sweep.prior, "showlegend": row == 1 and not sweep.noisy}
            figure.add_scatter(
                x=[point.gamma for point in sweep.points],
                y=[100 * claim.value_of(point.accuracy) for point in sweep.points],
                name=f"from {sweep.prior}",
                mode="lines+markers",
                line={"color": _COLOR[sweep.prior], "width": 1.6},
                marker={"size": 4},
                **own,
                **place,
            )
            fit = result.fit(sweep.prior, noisy=sweep.noisy)
            figure.add_scatter(
                x=[fit.identification.model.fit.gamma],
                y=[100 * claim.value_of(fit.accuracy)],
                name=f"γ by the rule, {sweep.prior}",
                mode="markers",
                marker={"color": _COLOR[sweep.prior], "size": 12, "symbol": "star"},
                **(own | {"legendgroup": f"rule {sweep.prior}"}),
                **place,
            )
        figure.add_hline(y=100 * claim.share, line={"color": _PAPER, "dash": "dash"}, row=row)
        figure.update_yaxes(title_text=f"{claim.quantity} [%]", row=row, col=1)
    figure.update_xaxes(type="log", exponentformat="power")
    figure.update_yaxes(type="log", exponentformat="power", title_font_size=11)
    figure.update_xaxes(title_text="γ_p/γ_τ", row=len(CLAIMS))
    figure.update_layout(height=210 * len(CLAIMS) + 120)
    above_titles(figure)
    return Figure(
        figure,
        "Largest errors of the global optimum over γ_p/γ_τ. Stars: the γ that maximum a posteriori "
        "chooses from the estimated noise. Dashed: what the paper reports. Without noise the "
        "errors are the regularisation's pull alone and grow with γ; with noise a smaller γ gains "
        "nothing once the noise decides.",
    )


def _pictured(result: Reproduction) -> tuple[SurrogateFit, ...]:
    return tuple(fit for fit in result.fits if fit.certified)


def _line(
    figure: go.Figure,
    result: Reproduction,
    fit: SurrogateFit,
    values: np.ndarray,
    row: int,
    col: int,
    *,
    first: bool,
) -> None:
    """One fit's curve over one period; without noise as dots."""
    name = f"{identified(fit.prior)}{', with noise' if fit.noisy else ', without noise'}"
    figure.add_scatter(
        x=result.period.time.astype(np.float32),
        y=values.astype(np.float32),
        name=name,
        legendgroup=name,
        showlegend=first,
        mode="lines",
        line={
            "color": _COLOR[fit.prior],
            "width": 1.5,
            "dash": "solid" if fit.noisy else "dot",
        },
        row=row,
        col=col,
    )


def above_titles(figure: go.Figure) -> None:
    """Put the legend above the panels' titles."""
    figure.update_annotations(font_size=12)
    legend = {"y": 1.0, "yanchor": "top", "yref": "container"}
    figure.update_layout(legend=legend, margin={"t": 115})
