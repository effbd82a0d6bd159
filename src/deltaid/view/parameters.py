"""Parameters of a model: prior, value, interval, and which of data and prior decided."""

import plotly.graph_objects as go

from deltaid.model.parameter_record import Parameter
from deltaid.model.record import IdentifiedModel
from deltaid.view import style
from deltaid.view.model_tables import MEASURED, parameter_table
from deltaid.view.numbers import WIDTH
from deltaid.view.page import Figure, Section, Text
from deltaid.view.shares import share_table

_FAR = 300.0  # % of the prior, beyond which a parameter would flatten all others


def parameter_section(model: IdentifiedModel) -> Section:
    """Every parameter that is not zero by structure, as a table and beside its prior."""
    parameters = tuple(p for p in model.parameters if p.determined_by != "structure")
    shares = share_table(model)
    return Section(
        "Parameters",
        (
            Text(
                "The data decides a parameter when it knows it, without any prior, to less than "
                "half of the prior's spread. Where it takes the priors of others to get there, "
                "torques show only a sum; such a parameter is marked with the priors that its "
                "value rests on, and its interval is all that recording and physical consistency "
                "leave open, whatever these priors. “At the limit of consistency” is what would be "
                "smaller if that were possible. All others are marked “prior”, with how far that "
                "may be off: their value is mostly what the description said, and the data "
                "supports no interval for them. What the data does determine about them are "
                "combinations, which the base parameters below show."
            ),
            _chart(parameters),
            parameter_table(model),
            *((shares,) if shares is not None else ()),
        ),
        "all numbers with their intervals, and what each comes from",
    )


def _interval(parameter: Parameter) -> tuple[float, float]:
    """The 95 % interval; models of earlier versions have only a standard deviation."""
    if parameter.low is not None and parameter.high is not None:
        return parameter.low, parameter.high
    half = WIDTH * parameter.std
    return parameter.value - half, parameter.value + half


def _chart(parameters: tuple[Parameter, ...]) -> Figure:
    shown = [p for p in parameters if p.prior != 0]
    far = [p for p in shown if abs(_change(p)) > _FAR]
    figure = go.Figure()
    for kind, name, color, symbol in (
        ("data", "identified, with 95 % interval", style.IDENTIFIED, "circle"),
        ("measured", "by measured values", style.IDENTIFIED, "square"),
        ("sum", "with the prior of others", style.IDENTIFIED, "circle-open"),
        ("limit", "at the limit of consistency", style.IDENTIFIED, "triangle-left-open"),
        ("prior", "from the prior, no interval", style.PRIOR, "circle-open"),
        ("fixed", "held by the description", style.PRIOR, "line-ns-open"),
        ("consistency", "lower bound", style.PRIOR, "triangle-right-open"),
    ):
        own = [p for p in shown if p.determined_by == kind]
        if not own:
            continue
        down, up = zip(*(_reach(p) for p in own), strict=True)
        bars = {"array": up, "arrayminus": down, "thickness": 1.6, "width": 3}
        figure.add_scatter(
            x=[_change(p) for p in own],
            y=[style.label(p.name) for p in own],
            error_x=bars if kind in MEASURED else None,
            name=name,
            mode="markers",
            marker={"color": color, "symbol": symbol, "size": 8},
            hovertemplate="%{y}: %{x:+.3g} % of the prior<extra></extra>",
        )
    names = [style.label(p.name) for p in shown]
    figure.update_yaxes(
        categoryorder="array", categoryarray=names, autorange="reversed", tickmode="linear", dtick=1
    )
    near = [abs(_change(p)) + max(_reach(p)) for p in shown if p not in far]
    edge = 1.1 * min(max([*near, 20.0]), _FAR)
    figure.update_xaxes(
        title_text="difference from the prior [% of the prior]",
        range=[-edge, edge] if far else None,
    )
    figure.update_layout(height=19 * len(names) + 130)
    return Figure(figure, " ".join(_caption(len(parameters) - len(shown), far)))


def _caption(left_out: int, far: list[Parameter]) -> list[str]:
    sentences = [
        "Difference between identified value and prior as a share of the prior; zero is the prior."
    ]
    if left_out:
        sentences.append(f"{left_out} with a prior of zero are in the table only.")
    if far:
        names = ", ".join(f"{p.name} at {_change(p):+.0f} %" for p in far)
        sentences.append(f"Beyond the edge: {names}; a double click shows everything.")
    return sentences


def _change(parameter: Parameter) -> float:
    """Difference from the prior in per cent of it."""
    return 100 * (parameter.value - parameter.prior) / abs(parameter.prior)


def _reach(parameter: Parameter) -> tuple[float, float]:
    """How far the interval reaches down and up, in per cent of the prior; nothing where the data
    did not decide."""
    if parameter.determined_by not in MEASURED:
        return 0.0, 0.0
    low, high = _interval(parameter)
    share = 100 / abs(parameter.prior)
    return share * (parameter.value - low), share * (high - parameter.value)
