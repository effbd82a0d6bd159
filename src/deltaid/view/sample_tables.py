"""A table of drawn models, and a sentence on how far they can be trusted."""

import numpy as np

from deltaid.model.samples import Samples
from deltaid.view.numbers import number, percent
from deltaid.view.table import Table


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
