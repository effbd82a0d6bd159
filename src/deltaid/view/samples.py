"""Models drawn from a posterior: a table, a sentence, a card."""

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from deltaid.model.samples import Samples
from deltaid.view.card import Card
from deltaid.view.numbers import number, percent, span
from deltaid.view.page import Table

if TYPE_CHECKING:
    import plotly.graph_objects as go


def sample_table(drawn: Samples) -> Table:
    """What was identified beside mean and spread of the models, of all parameters that vary."""
    fitted = dict(zip(drawn.model.layout.names, drawn.model.p.tolist(), strict=True))
    low, high = np.quantile(drawn.p, [0.025, 0.975], axis=0)
    return Table(
        ("parameter", "identified", "mean", "std", "95 % of models", "unit"),
        tuple(
            (
                name,
                number(fitted[name]) if name in fitted else "",
                number(float(drawn.p[:, i].mean())),
                number(float(drawn.p[:, i].std()), 3),
                span(float(low[i]), float(high[i])),
                drawn.units[i],
            )
            for i, name in enumerate(drawn.names)
            if high[i] > low[i]
        ),
        title=f"{len(drawn)} models of {drawn.robot.title or drawn.robot.name}",
    )


def sample_sentence(drawn: Samples) -> str:
    """Number, effective number, agreement of chains."""
    apart = percent(drawn.limb_tolerance)
    scatter = f", limbs apart by {apart} (one standard deviation)" if drawn.limb_tolerance else ""
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
    ends = np.quantile(value.p, [0.025, 0.25, 0.5, 0.75, 0.975], axis=0)
    shown = [i for i, n in enumerate(value.names) if ends[-1, i] > ends[0, i] and fitted.get(n)]
    names = [style.label(value.names[i]) for i in shown]
    centre = np.array([fitted[value.names[i]] for i in shown])
    low, first, middle, last, high = 100 * (ends[:, shown] - centre) / abs(centre)
    figure = go.Figure(
        layout={
            "yaxis": style.DOWNWARDS,
            "xaxis": {"title": "away from what was identified [% of it]"},
            "height": 20 * len(shown) + 130,
        }
    )
    for title, a, b, width in (("95 %", low, high, 2), ("50 %", first, last, 6)):
        figure.add_scatter(
            x=np.column_stack([a, b, np.full(len(shown), np.nan)]).ravel(),
            y=[end for name in names for end in (name, name, None)],
            name=f"{title} of models",
            mode="lines",
            line={"color": style.IDENTIFIED, "width": width},
        )
    marker = {"color": style.MEASURED, "size": 6}
    return figure.add_scatter(x=middle, y=names, name="median", mode="markers", marker=marker)
