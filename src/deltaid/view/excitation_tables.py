"""Tables of an optimised motion, for the terminal and for its page."""

from deltaid.motion.excitation.excite import Excitation
from deltaid.view.numbers import number, percent
from deltaid.view.table import Table


def limit_table(result: Excitation) -> Table:
    """Largest use of every limit over the whole run."""
    rows = tuple((limit.name, f"{100 * limit.share:.1f} %") for limit in result.limits)
    return Table(("limit", "in use"), rows)


def prediction_table(result: Excitation) -> Table:
    """What the motion will tell about every base parameter."""
    rows = tuple(
        (
            p.formula,
            number(p.value),
            f"{p.std:.2g}",
            p.unit,
            percent(p.std / abs(p.value)) if abs(p.value) > p.std else "",
        )
        for p in result.predictions
    )
    return Table(
        ("base parameter", "prior", "predicted ±", "unit", "share"),
        rows,
        "Predicted standard deviation of every base parameter; the share is of the prior, and is "
        "left out where the deviation is larger than the value.",
        title="what this motion will tell",
    )


def start_table(result: Excitation) -> Table:
    """What became of each start of the search."""
    accounts = result.optimum.accounts
    judged = any(a.judged is not None for a in accounts)
    rows = tuple(
        (
            str(a.seed),
            number(a.before),
            number(a.after),
            str(a.evaluations),
            f"{a.seconds:.1f}",
            f"{100 * a.use:.1f} %",
            "yes" if a.feasible else "no",
            *([number(a.judged, 5) if a.judged is not None else ""] if judged else []),
        )
        for a in accounts
    )
    columns = (
        "start",
        "as drawn",
        "optimised",
        "evaluations",
        "seconds",
        "fullest limit",
        "feasible",
    )
    caption = "Objective of the search for each start as it was drawn at random, and optimised."
    if judged:
        caption += (
            " Bodies: ½ log det of the covariance of all their entries after torques and sensors, "
            "in nats, by which the motion was chosen."
        )
    return Table((*columns, *(["bodies"] if judged else [])), rows, caption)
