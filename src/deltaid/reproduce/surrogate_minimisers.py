"""Why the paper's minimisation stops where it does: the page's section on the ways down J."""

import numpy as np
from plotly.subplots import make_subplots

from deltaid.reproduce.accuracy import Accuracy
from deltaid.reproduce.descent import Descents, Way
from deltaid.reproduce.surrogate_figures import above_titles
from deltaid.reproduce.surrogate_result import Reproduction
from deltaid.view import style
from deltaid.view.numbers import number, percent
from deltaid.view.page import Figure, Section, Table, Text

Rows = tuple[tuple[str, ...], ...]

# An exponential that has shrunk to less than this share of its start has no gradient to speak of.
_DEAD = 1e-3
# Name and colour of each way down.
WAY_LABELS: dict[Way, tuple[str, str]] = {
    "newton": ("Newton from π(p_reg)", style.SERIES[0]),
    "levenberg-marquardt": ("Levenberg–Marquardt from π(p_reg)", style.SERIES[1]),
    "bfgs": ("BFGS from π(p_reg)", style.SERIES[3]),
    "relaxed": ("Newton, γ relaxed (deltaid)", style.SERIES[2]),
}


def minimisers_section(result: Reproduction) -> Section:
    """What happens to the paper's minimisation, as text, figure and tables."""
    died = ", ".join(
        f"{WAY_LABELS[way.way][0]} of {prior} "
        f"({way.smallest_name} at {number(way.smallest, 1)} of its start)"
        for prior, descents in result.descents.items()
        for way in descents.ways
        if way.smallest < _DEAD
    )
    return Section(
        "Why the paper's minimisation stops where it does",
        (
            Text(
                "The paper minimises J(π) from π(p_reg) with the small γ at once (Sec. VIII B). J "
                "is convex in p, and π maps one to one onto the consistent p, so there is no bad "
                "local minimum. But J is badly conditioned in π, and where an exponential e^d has "
                "run towards zero its gradient dies with it. Two things then end the iteration "
                "early: usual tolerances, because J and its gradient are small numbers long before "
                "the parameters are right (crosses in the figure), and tails in which nothing "
                "moves any more.\n\n"
                + (f"An exponential ran towards zero with {died}.\n\n" if died else "")
                + "The paper names Yalmip, which calls other solvers, but neither γ nor "
                "tolerances; this shows what can happen to its problem, not what did. The conic "
                "program solves the same problem with a certificate. The relaxed route starts "
                "with a strong regulariser, near whose minimum it begins, and lowers γ tenfold at "
                "a time."
            ),
            descent_figure(result),
            Table(
                ("from", "method", "steps", "ms", "J", "largest |∂J/∂π|", "smallest exponential"),
                tuple(row for prior, d in result.descents.items() for row in _efforts(prior, d)),
                "Where each method ends. The smallest exponential is the one that shrank most, as "
                "a share of its value at the start.",
            ),
            Table(
                ("from", "method", "M on", "M off", "friction", "M on*", "M off*", "friction*"),
                tuple(
                    (prior, WAY_LABELS[way.way][0], *_judged(way.at_end), *_judged(way.at_usual))
                    for prior, descents in result.descents.items()
                    for way in descents.ways
                ),
                "How far the model is from the truth where each method ends, and (*) where it "
                "would have ended with a gradient tolerance of 1e-6.",
            ),
        ),
    )


def _efforts(prior: str, descents: Descents) -> Rows:
    best, milliseconds = descents.conic, f"{1e3 * descents.conic_seconds:.2g}"
    conic = ("conic", str(best.iterations), milliseconds, number(best.objective), "—", "—")
    ways = (
        (
            WAY_LABELS[way.way][0],
            str(len(way.objective) - 1),
            f"{1e3 * way.seconds[-1]:.0f}",
            number(float(way.objective[-1])),
            number(float(way.gradient[-1]), 2),
            f"{number(way.smallest, 2)} ({way.smallest_name})",
        )
        for way in descents.ways
    )
    return tuple((prior, *row) for row in (conic, *ways))


def _judged(a: Accuracy | None) -> tuple[str, ...]:
    if a is None:
        return ("—",) * 3
    errors = (a.mass_diagonal, a.mass_off_diagonal, a.friction_coefficients)
    return tuple(percent(error) for error in errors)


def descent_figure(result: Reproduction) -> Figure:
    """J over steps and over time for all minimisers, with the certified bound."""
    figure = make_subplots(
        rows=2,
        cols=2,
        subplot_titles=[f"from {prior}" for prior in result.descents] * 2,
        shared_yaxes=True,
        horizontal_spacing=0.06,
        vertical_spacing=0.16,
    )
    for col, descents in enumerate(result.descents.values(), start=1):
        for row in (1, 2):
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
    figure.update_xaxes(type="log", exponentformat="power", dtick=1)
    figure.update_xaxes(title_text="step", row=1)
    figure.update_xaxes(title_text="time [ms]", row=2)
    figure.update_yaxes(type="log", exponentformat="power")
    figure.update_yaxes(title_text="J", col=1)
    figure.update_layout(height=780)
    above_titles(figure)
    return Figure(
        figure,
        f"J of (15) on the recording without noise with γ_p/γ_τ = "
        f"{result.settings.descent_gamma:.0e}, over steps and over time on this machine. A cross "
        "marks where no entry of ∇J exceeds 1e-6, a common default for being done. The conic "
        "program has no steps to draw: its optimum lies on the dashed line.",
    )
