"""Parameters of a model: prior, value, interval, and the origin of each."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float
from scipy.linalg import solve_triangular

from deltaid.estimation.information import triangle
from deltaid.estimation.scatter import NORMAL
from deltaid.identification.identify import Identification
from deltaid.model.parameter_record import Parameter, Share
from deltaid.model.record import IdentifiedModel
from deltaid.view import style
from deltaid.view.model_tables import BY_ITSELF, MEASURED, base_table, parameter_table
from deltaid.view.numbers import number
from deltaid.view.page import Figure, Section, Table, Text

_FAR = 300.0  # largest shown difference from the prior [%]; larger ones would flatten all others
_SOURCES = {
    "noise": "torques",
    "sensors": "sensors",
    "measured": "measured values",
    "prior": "prior",
    "geometry": "geometry and effects",
    "unseen": "not shown",
}
# Sources that are shown only for models that have them.
_OPTIONAL = ("sensors", "measured")


def parameter_section(model: IdentifiedModel) -> Section:
    """Parameters that are not zero by structure, as a table and relative to their prior."""
    return Section(
        "Parameters",
        (
            Text(
                "The data decides a parameter when it knows it, without any prior, to less than "
                "half of the prior's spread. Where it takes the priors of others to get there, "
                "torques show only a sum; such a parameter is marked “sum”, and its interval is "
                "all that recording and physical consistency leave open, whatever these priors. "
                "“Limit” is what would be smaller if that were possible. All others are "
                "marked “prior”, with how far that may be off: their value is mostly what the "
                "description said, and the data supports no interval for them. What the data "
                "does determine about them are combinations, which the base parameters below show."
            ),
            parameter_chart(model),
            parameter_table(model),
            share_table(model),
        ),
        "all numbers with their intervals, and what each comes from",
    )


def parameter_chart(model: IdentifiedModel) -> Figure:
    """Parameters as their difference from the prior, with intervals."""
    parameters = [p for p in model.parameters if p.determined_by != "structure"]
    shown = [p for p in parameters if p.prior != 0]
    far = [p for p in shown if abs(_change(p)) > _FAR]
    names = [style.label(p.name) for p in shown]
    near = [abs(_change(p)) + max(_reach(p)) for p in shown if p not in far]
    edge = 1.1 * min(max([*near, 20.0]), _FAR)
    figure = go.Figure(
        layout={
            "yaxis": style.DOWNWARDS | {"categoryorder": "array", "categoryarray": names},
            "xaxis": {
                "title": "difference from the prior [% of the prior]",
                "range": [-edge, edge] if far else None,
            },
            "height": 19 * len(names) + 130,
        }
    )
    for kind, name, color, symbol in (
        ("data", "identified, 95 % interval", style.IDENTIFIED, "circle"),
        ("measured", "from measured values", style.IDENTIFIED, "square"),
        ("sum", "identified as a sum, 95 % interval", style.IDENTIFIED, "circle-open"),
        ("limit", "as small as physics allows", style.IDENTIFIED, "triangle-left-open"),
        ("prior", "from the prior, no interval", style.PRIOR, "circle-open"),
        ("fixed", "held by the description", style.PRIOR, "line-ns-open"),
        ("consistency", "lower bound", style.PRIOR, "triangle-right-open"),
    ):
        of_kind = [p for p in shown if p.determined_by == kind]
        if not of_kind:
            continue
        down, up = zip(*(_reach(p) for p in of_kind), strict=True)
        bars = {"array": up, "arrayminus": down, "thickness": 1.6, "width": 3}
        figure.add_scatter(
            x=[_change(p) for p in of_kind],
            y=[style.label(p.name) for p in of_kind],
            error_x=bars if kind in MEASURED else None,
            name=name,
            mode="markers",
            marker={"color": color, "symbol": symbol, "size": 8},
            hovertemplate="%{y}: %{x:+.3g} % of the prior<extra></extra>",
        )
    return Figure(figure, _caption(len(parameters) - len(shown), far))


def _caption(left_out: int, far: list[Parameter]) -> str:
    text = (
        "Difference between identified value and prior as a share of the prior; zero is the prior."
    )
    if left_out:
        text += f" {left_out} with a prior of zero are in the table only."
    if far:
        names = ", ".join(f"{p.name} at {_change(p):+.0f} %" for p in far)
        text += f" Beyond the edge: {names}; a double click shows everything."
    return text


def _change(parameter: Parameter) -> float:
    return 100 * (parameter.value - parameter.prior) / abs(parameter.prior)


def _reach(parameter: Parameter) -> tuple[float, float]:
    """Extent of the interval down and up [% of the prior]; zero unless data determines it."""
    if parameter.determined_by not in MEASURED:
        return 0.0, 0.0
    half, share = NORMAL * parameter.std, 100 / abs(parameter.prior)
    # Models of earlier versions have only a standard deviation.
    if parameter.low is None or parameter.high is None:
        return share * half, share * half
    return share * (parameter.value - parameter.low), share * (parameter.high - parameter.value)


def share_table(model: IdentifiedModel) -> Table:
    """Sources of the intervals of parameters that data determines, and of base parameters.

    Without rows for a model of an earlier version, which lacks them.
    """
    shown = [(p.name, p.share) for p in _decided(model.parameters)]
    shown += [(f"base: {group.representative}", group.share) for group in model.base_parameters]
    known = [(name, share) for name, share in shown if share is not None]
    keys = _keys([share for _, share in known])
    optional = [_SOURCES[key] for key in keys if key in _OPTIONAL]
    more = f", of {' and of '.join(optional)}" if optional else ""
    return Table(
        ("what decided", *(_SOURCES[key] for key in keys)),
        tuple((name, *(_percent(getattr(share, key)) for key in keys)) for name, share in known),
        f"Sources of each interval, by its squared width: noise of torques{more}, the prior, "
        "tolerances of the geometry with effects that rows do not decide, and what nothing shows. "
        "The last ends where a body would no longer be possible. Of several sources with noise, "
        "each has the share that it has in the value too. Longer recordings "
        "shrink the noise of torques and sensors only. Base parameters have no prior; each is "
        "named by its first term.",
    )


def shares_sentence(model: IdentifiedModel) -> str:
    """The sources in one sentence; empty for a model of an earlier version."""
    parts = [(p.name, p.share) for p in _decided(model.parameters) if p.share is not None]
    if not parts:
        return ""
    means = ", ".join(
        f"{100 * np.mean([getattr(share, key) for _, share in parts]):.0f} % {_SOURCES[key]}"
        for key in _keys([share for _, share in parts])
    )
    main = {name: max(_SOURCES, key=partial(getattr, share)) for name, share in parts}
    most = ", ".join(name for name, source in main.items() if source == "geometry")
    rest = f"; mostly geometry and effects: {most}" if most else ""
    return f"sources of the intervals, mean: {means}{rest}"


def _decided(parameters: Sequence[Parameter]) -> list[Parameter]:
    return [p for p in parameters if p.determined_by in BY_ITSELF and p.share]


def _keys(shares: Sequence[Share]) -> list[str]:
    return [
        key
        for key in _SOURCES
        if key not in _OPTIONAL or any(getattr(share, key) for share in shares)
    ]


def _percent(share: float) -> str:
    """A share in whole per cent, or '< 1 %'."""
    return f"{100 * share:.0f} %" if share >= 0.005 or share == 0 else "< 1 %"


def information_section(result: Identification) -> Section:
    """Base parameters with their intervals, singular values and correlations."""
    base = result.problem.base
    information = result.problem.information
    columns = [group.representative for group in base.groups]
    Y = information.weighted()[:, np.searchsorted(information.columns, columns)]
    # Triangular factor of the weighted base regressor with columns of unit length.
    R = triangle(Y / np.linalg.norm(Y, axis=0))
    visible = len(base.layout.names) - len(base.invisible)
    return Section(
        "Base parameters",
        (
            Text(
                f"Of {len(base.layout.names)} parameters {visible} show in torques at all, and of "
                f"these the motion determines {base.rank} combinations, the base parameters. "
                "Their values here come from weighted least squares alone, without prior and "
                "without physical consistency. The condition number of the base regressor, its "
                f"columns scaled to unit length, is {number(base.condition, 3)}."
            ),
            base_table(result.model.base_parameters),
            _singular_values(R),
            _correlations(result, R),
        ),
        "combinations that the torques determine, and how well",
    )


def _singular_values(R: Float[np.ndarray, "base base"]) -> Figure:
    values = np.linalg.svd(R, compute_uv=False)
    spectrum = go.Figure(
        go.Scatter(
            x=np.arange(1, len(values) + 1),
            y=values,
            mode="lines+markers",
            line={"color": style.SERIES[0], "width": 1},
            marker={"size": 6},
            hovertemplate="singular value %{x}: %{y:.3g}<extra></extra>",
        ),
        {
            "yaxis": {"type": "log", "dtick": 1, "exponentformat": "power",
                      "title": "singular value"},
            "xaxis": {"title": "number"},
            "height": 330,
            "margin": {"t": 20},
        },
    )  # fmt: skip
    return Figure(
        spectrum,
        "Singular values of the base regressor, rows weighted by the drives' largest "
        "torques and columns scaled to unit length. A small one is a combination that the "
        f"motion hardly excites; largest over smallest is "
        f"{number(values[0] / values[-1], 3)}.",
    )


def _correlations(result: Identification, R: Float[np.ndarray, "base base"]) -> Figure:
    """Correlations (RᵀR)⁻¹ of the estimates, scaled to a unit diagonal."""
    inverse = solve_triangular(R, np.eye(len(R)))
    rows = inverse / np.linalg.norm(inverse, axis=1, keepdims=True)
    base = result.problem.base
    names = [
        style.label(base.layout.parameters[group.representative].label) for group in base.groups
    ]
    return Figure(
        go.Figure(
            go.Heatmap(
                z=(rows @ rows.T).astype(np.float32),
                x=names,
                y=names,
                zmin=-1,
                zmax=1,
                colorscale="RdBu",
                colorbar={"thickness": 10, "len": 0.9, "outlinewidth": 0},
                hovertemplate="%{y} and %{x}: %{z:.2f}<extra></extra>",
            ),
            {
                "yaxis": style.DOWNWARDS | {"tickfont": {"size": 9}},
                "xaxis": {"tickangle": -90, "tickfont": {"size": 9}},
                "height": 16 * len(names) + 150,
                "margin": {"t": 10},
            },
        ),
        "Correlation of the base parameters' estimates, each named by its first term. Deep colours "
        "off the diagonal are pairs that this motion hardly separates.",
    )
