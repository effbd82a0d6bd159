"""Models drawn from a posterior: a table, a sentence, a card."""

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from deltaid.model.samples import Samples
from deltaid.view.card import Card
from deltaid.view.numbers import number, percent
from deltaid.view.page import Table

if TYPE_CHECKING:
    import plotly.graph_objects as go


def sample_table(drawn: Samples) -> Table:
    """What was identified beside mean and spread of the models, of all parameters that vary."""
    fitted = dict(zip(drawn.model.layout.names, drawn.model.p.tolist(), strict=True))
    low, high = np.quantile(drawn.p, [0.025, 0.975], axis=0)
    rows = tuple(
        (
            name,
            number(fitted[name]) if name in fitted else "",
            number(float(drawn.p[:, i].mean())),
            number(float(drawn.p[:, i].std())),
            f"{number(float(low[i]))} … {number(float(high[i]))}",
            drawn.units[i],
        )
        for i, name in enumerate(drawn.names)
        if high[i] > low[i]
    )
    return Table(
        ("parameter", "identified", "mean", "std", "95 % of models", "unit"),
        rows,
        "",
        title=f"{len(drawn)} models of {drawn.robot.title or drawn.robot.name}",
    )


def sample_sentence(drawn: Samples) -> str:
    """Number, effective number, agreement of chains."""
    scatter = ""
    if drawn.limb_tolerance:
        scatter = f", limbs apart by {percent(drawn.limb_tolerance)} (one standard deviation)"
    return (
        f"{len(drawn)} models, all consistent, worth {drawn.ess.min():.0f} independent ones or "
        f"more; chains agree (R̂ at most {drawn.rhat.max():.3f}){scatter}"
    )


def samples_card(value: Samples) -> Card:
    """How many, what they are worth; folded their spread."""
    table = sample_table(value)
    return Card(
        f"{len(value)} models of {value.robot.title or value.robot.name}",
        (sample_sentence(value),),
        "",
        (("parameters that vary", str(len(table.rows))),),
        more=(("spread", table),),
        methods=('["P.m"]', ".models()", ".plot()", ".to_frame()", '.save("models.npz")'),
    )


def samples_frame(value: Samples) -> pl.DataFrame:
    """Parameters, a row a model."""
    return pl.DataFrame(value.p, schema=list(value.names))


def samples_figure(value: Samples) -> "go.Figure":
    """Median and the middle 50 and 95 % of every parameter that varies, beside what was fitted."""
    import plotly.graph_objects as go

    from deltaid.view import style

    fitted = dict(zip(value.model.layout.names, value.model.p.tolist(), strict=True))
    low, first, middle, last, high = np.quantile(value.p, [0.025, 0.25, 0.5, 0.75, 0.975], axis=0)
    at = [i for i, n in enumerate(value.names) if high[i] > low[i] and fitted.get(n)]
    names = [style.label(value.names[i]) for i in at]
    size = np.array([abs(fitted[value.names[i]]) for i in at])
    centre = np.array([fitted[value.names[i]] for i in at])

    def share(x: np.ndarray) -> np.ndarray:
        return 100 * (x[at] - centre) / size

    figure = go.Figure()
    for title, a, b, width in (("95 %", low, high, 2), ("50 %", first, last, 6)):
        x = np.column_stack([share(a), share(b), np.full(len(at), np.nan)]).ravel()
        y = [end for name in names for end in (name, name, None)]
        line = {"color": style.IDENTIFIED, "width": width}
        figure.add_scatter(x=x, y=y, name=f"{title} of models", mode="lines", line=line)
    marker = {"color": style.MEASURED, "size": 6}
    figure.add_scatter(x=share(middle), y=names, name="median", mode="markers", marker=marker)
    figure.update_yaxes(autorange="reversed", tickmode="linear", dtick=1)
    figure.update_xaxes(title_text="away from what was identified [% of it]")
    figure.update_layout(height=20 * len(at) + 130)
    return figure
