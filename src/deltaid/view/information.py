"""What the data determines: base parameters, their intervals, condition and correlations."""

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float
from scipy.linalg import solve_triangular

from deltaid.estimation.information import triangle
from deltaid.identification.identify import Identification
from deltaid.view import style
from deltaid.view.model_tables import base_table
from deltaid.view.numbers import number
from deltaid.view.page import Figure, Section, Text


def information_section(result: Identification) -> Section:
    """Base parameters with their intervals, singular values and correlations."""
    base = result.problem.base
    R = _scaled_factor(result)
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


def _scaled_factor(result: Identification) -> Float[np.ndarray, "base base"]:
    """Triangular factor of the weighted base regressor, columns of unit length."""
    information = result.problem.information
    columns = [group.representative for group in result.problem.base.groups]
    Y = information.weighted()[:, np.searchsorted(information.columns, columns)]
    return triangle(Y / np.linalg.norm(Y, axis=0))


def _singular_values(R: Float[np.ndarray, "base base"]) -> Figure:
    values = np.linalg.svd(R, compute_uv=False)
    figure = go.Figure(
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
        figure,
        "Singular values of the base regressor, rows weighted by the drives' largest torques and "
        "columns scaled to unit length. A small one is a combination that the motion hardly "
        f"excites; largest over smallest is {number(values[0] / values[-1], 3)}.",
    )


def _correlations(result: Identification, R: Float[np.ndarray, "base base"]) -> Figure:
    """Correlations (RᵀR)⁻¹ of the estimates, scaled to a unit diagonal."""
    inverse = solve_triangular(R, np.eye(len(R)))
    rows = inverse / np.linalg.norm(inverse, axis=1, keepdims=True)
    base = result.problem.base
    names = [
        style.label(base.layout.parameters[group.representative].label) for group in base.groups
    ]
    figure = go.Figure(
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
    )
    return Figure(
        figure,
        "Correlation of the base parameters' estimates, each named by its first term. Deep colours "
        "off the diagonal are pairs that this motion hardly separates.",
    )
