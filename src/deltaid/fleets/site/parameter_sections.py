"""Parameters of a robot: over the periods, what decided each, and how far it is from its type."""

import polars as pl

from deltaid.fleets.site.parts import MOST, Panel, between, grid, known, numbers, shown
from deltaid.fleets.site.state import ALL, Robot, Row, last_period
from deltaid.view import style
from deltaid.view.page import Block, Chart, Section, Table, Text

# What says that a value is seen and not taken from elsewhere.
SEEN = ("data", "sum", "measured", "sensors")


def parameter_section(parameters: pl.DataFrame) -> tuple[Section, ...]:
    """Parameters over the periods, and all of the last one and of all recordings together."""
    fitted = parameters.filter(pl.col("decided_by") != "structure")  # nothing to be told of
    if fitted.is_empty():
        return ()
    whole, single = (fitted.filter((pl.col("period") == ALL) == is_) for is_ in (True, False))
    ordered = (single if len(single) else whole).sort("period", maintain_order=True)
    last = last_period(fitted)
    tables = [_values(last, ordered, f"Fitted to the recordings of {last['period'][0]}.")]
    if len(whole) and whole["recordings"][0] != last["recordings"][0]:
        tables.insert(0, _values(whole, ordered, "Fitted to all recordings together."))
    poor = dict(ordered.select("period", "verdicts").unique(maintain_order=True).iter_rows())
    doubts = tuple((period, keys) for period, keys in poor.items() if keys)
    blocks: list[Block] = [*_over_periods(ordered), *tables]
    if doubts:
        blocks.append(Table(("period", "checks that are not good"), doubts))
    many = "by period, one" if len(poor) == 1 else f"by period, {len(poor)} of them"
    return (Section("Parameters", tuple(blocks), f"{many}; what decided each"),)


def _values(fit: pl.DataFrame, ordered: pl.DataFrame, said: str) -> Table:
    """All parameters of one fit."""
    rows = tuple(_parameter(row, ordered) for row in fit.iter_rows(named=True))
    columns = ("parameter", "value", "±", "unit", "95 % interval", "prior", "decided by",
               "periods by data")  # fmt: skip
    seen = fit["decided_by"].is_in(SEEN).to_list()
    grey = frozenset(k for k, is_seen in enumerate(seen) if not is_seen)
    return Table(columns, rows, f"{said} Grey: taken from the prior, not seen.", muted=grey)


def _parameter(row: Row, ordered: pl.DataFrame) -> tuple[str, ...]:
    said, width = known(row["value"], row["std"])
    own = ordered.filter(pl.col("parameter") == row["parameter"])
    seen = own.filter(pl.col("decided_by").is_in(SEEN)).height
    return (
        str(row["parameter"]),
        said,
        width,
        str(row["unit"]),
        between(row["low"], row["high"]),
        shown(row["prior"]),
        str(row["decided_by"]),
        f"{seen} of {len(own)}",
    )


def _over_periods(ordered: pl.DataFrame) -> tuple[Chart, ...]:
    """Those that data shows, over the periods; open where the prior decided."""
    seen = ordered.filter(pl.col("decided_by").is_in(SEEN))
    names = list(dict.fromkeys(seen["parameter"].to_list()))
    if not names or ordered["period"].n_unique() < 2:
        return ()
    panels = [_panel(ordered.filter(pl.col("parameter") == name)) for name in names[:MOST]]
    left = len(names) - len(panels)
    said = (
        "Parameters that data shows, by period, with 95 % intervals; open where the prior decided."
        + f" {left} more are in the table." * (left > 0)
    )
    figure = grid(panels, columns=3, row=130, x={"type": "category", "nticks": 4})
    return (Chart(figure, said),)


def _panel(rows: pl.DataFrame) -> Panel:
    value, decided = rows["value"], rows["decided_by"].to_list()
    trace = {
        "type": "scatter",
        "x": rows["period"].to_list(),
        "y": numbers(value),
        "error_y": {
            "type": "data",
            "array": numbers((rows["high"] - value).fill_null(0.0)),
            "arrayminus": numbers((value - rows["low"]).fill_null(0.0)),
            "width": 0,
            "thickness": 1,
        },
        "text": [style.label(by) for by in decided],
        "hovertemplate": "%{x}: %{y:.4g}, %{text}<extra></extra>",
        "mode": "markers",
        "marker": {
            "color": style.IDENTIFIED,
            "size": 5,
            "symbol": ["circle" if by in SEEN else "circle-open" for by in decided],
        },
    }
    unit = rows["unit"][0]
    return Panel(f"{rows['parameter'][0]} [{unit}]" if unit else rows["parameter"][0], (trace,))


def type_section(robot: Robot, members: pl.DataFrame) -> tuple[Section, ...]:
    """How far it is from its type."""
    if members.is_empty():
        return ()
    ordered = members.with_columns(size=pl.col("spreads").abs()).sort(
        "size", descending=True, nulls_last=True
    )
    rows = tuple(
        (
            row["parameter"],
            shown(row["deviation"], 3),
            row["unit"],
            shown(row["spreads"], 2),
            *known(row["value"], row["std"]),
            between(row["low"], row["high"]),
            shown(row["alone_std"], 2),
        )
        for row in ordered.iter_rows(named=True)
    )
    columns = ("parameter", "deviation", "unit", "in spreads", "value", "±", "95 % interval",
               "± alone")  # fmt: skip
    foreign = robot.belongs is False
    table = Table(
        columns,
        rows,
        "Deviation from the mean of its type. "
        + ("Values by its own recordings, " if foreign else "Values with what the type tells, ")
        + "± alone is by its own recordings. A spread is the standard deviation between robots.",
    )
    reasons = dict.fromkeys(reason for reason in members["reason"].to_list() if reason)
    said = "It does not belong to its type: " if foreign else "It belongs to its type, but: "
    words = (Text(f"{said}{'; '.join(reasons)}."),) if reasons else ()
    return (
        Section("Beside its type", (*words, table), "how far it is from others of its type",
                unfolded=foreign),
    )  # fmt: skip
