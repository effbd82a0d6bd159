"""Cards, tables and figures of models, identifications and comparisons with recordings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import polars as pl

from deltaid.errors import counted
from deltaid.identification.identify import Identification
from deltaid.identification.prediction import FeedForward, Validation
from deltaid.model.model import Model, ModelLike, load
from deltaid.model.record import IdentifiedModel
from deltaid.model.samples import Samples
from deltaid.model.verdict import Grade
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.check import page_table
from deltaid.view.model_tables import error_table, parameter_table
from deltaid.view.numbers import number, percent, span
from deltaid.view.page import Table
from deltaid.view.show import Card
from deltaid.view.summary import summary

_NEXT = ('["P.m"]', ".dynamics", ".plot()", ".to_frame()", '.report("x.html")')


def model_card(value: Model | IdentifiedModel) -> Card:
    model = load(value)
    verdict, known = summary(model), model.identified
    title = f"Model of {model.robot.label}, {model.origin}"
    if known is None:
        facts = (("parameters", str(len(model.p))), ("drives", str(len(model.robot.drives))))
        return Card(title, (verdict.sentence, *verdict.lines), verdict.grade, facts, methods=_NEXT)
    return Card(
        title,
        (verdict.sentence, *verdict.lines[:2]),
        verdict.grade,
        drive_errors(model.robot, known.fit.nrmse),
        error_table(model, None),
        (("parameters", parameter_table(known)), *warned(known.warnings)),
        (*_NEXT, ".sample(100)", *(('.save("model.yaml")',) * isinstance(value, IdentifiedModel))),
    )


def drive_errors(robot: RobotDescription, nrmse: Sequence[float]) -> tuple[tuple[str, str], ...]:
    return tuple(
        (f"{drive} error", percent(x)) for drive, x in zip(robot.drives, nrmse, strict=True)
    )


def warned(warnings: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    title = counted(len(warnings), "warning")
    return ((title, "\n".join(warnings)),) if warnings else ()


def model_frame(value: ModelLike) -> pl.DataFrame:
    """Parameters, one per row; for a prior without intervals."""
    model = load(value)
    if model.identified is None:
        layout = model.layout
        return pl.DataFrame({"name": layout.names, "value": model.p, "unit": layout.units})
    numbers, texts = ("value", "std", "low", "high", "prior"), ("name", "unit", "determined_by")
    columns = ("name", "value", "std", "low", "high", "unit", "prior", "determined_by", "rests_on")
    kinds = dict.fromkeys((*texts, "rests_on"), pl.String) | dict.fromkeys(numbers, pl.Float64)
    rows = [
        {name: getattr(p, name) for name in columns} | {"rests_on": ", ".join(p.rests_on)}
        for p in model.identified.parameters
    ]
    return pl.DataFrame(rows, schema={name: kinds[name] for name in columns})


identification_frame = model_frame


def identification_card(value: Identification) -> Card:
    of_model, verdict = model_card(value.model), summary(value)
    robot = value.model.robot
    logs = ", ".join(recording.path.name for recording in value.recordings)
    poor = [v for v in getattr(value, "verdicts", ()) if v.grade is not Grade.GOOD]
    return replace(
        of_model,
        title=f"Identification of {robot.label} from {logs}",
        lines=(verdict.sentence, *verdict.lines[:2]),
        grade=verdict.grade,
        more=(*((("checks that are not good", page_table(poor)),) if poor else ()), *of_model.more),
        methods=(".model", ".verdicts", ".plot()", ".to_frame()", '.report("x.html")',
                 '.save("model.yaml")'),
    )  # fmt: skip


def validation_card(value: Validation) -> Card:
    model, verdict = value.model, summary(value.model, value.error, value.log)
    return Card(
        f"{model.robot.label} compared with {value.log.path.name}",
        (verdict.sentence,),
        verdict.grade,
        drive_errors(model.robot, value.error.nrmse.tolist()),
        error_table(model, value.error),
        warned(value.remarks),
        (".error", ".log", ".plot()", ".to_frame()", '.report("x.html")'),
    )


def validation_frame(value: Validation) -> pl.DataFrame:
    units = value.model.robot.drive_units
    return pl.DataFrame(
        {
            "drive": list(units),
            "rms": value.error.rms,
            "nrmse": value.error.nrmse,
            "rms_unfiltered": value.error.rms_unfiltered,
            "unit": [unit.force for unit in units.values()],
        }
    )


def feed_forward_card(value: FeedForward) -> Card:
    robot, recording, warnings = value.model.robot, value.recording, warned(value.warnings)
    cutoff = recording.motion_cutoff
    low_passed = f", positions are low-passed at {cutoff:.3g} Hz" if cutoff else ""
    return Card(
        f"Torques of {robot.label} along {recording.path.name}",
        (f"{value.rows} of {value.samples} rows have torques{low_passed}",),
        more=warnings,
        prompt_lines=tuple(title for title, _ in warnings),
        methods=(".warnings", ".to_frame()", '.save("torque.csv")'),
    )


def sample_table(drawn: Samples) -> Table:
    """Identified values with mean and spread of the drawn models, for parameters that vary."""
    fitted = drawn.model.layout.named(drawn.model.p)
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
        title=f"{len(drawn)} models of {drawn.robot.label}",
    )


def sample_sentence(drawn: Samples) -> str:
    """Number and effective number of models, and agreement of chains."""
    apart = percent(drawn.limb_tolerance)
    scatter = f", limbs apart by {apart} (one standard deviation)" if drawn.limb_tolerance else ""
    return (
        f"{len(drawn)} models, all consistent, worth {drawn.ess.min():.0f} independent ones or "
        f"more; chains agree (R̂ at most {drawn.rhat.max():.3f}){scatter}"
    )


def samples_card(value: Samples) -> Card:
    table = sample_table(value)
    return Card(
        f"{len(value)} models of {value.robot.label}",
        (sample_sentence(value),),
        "",
        (("parameters that vary", str(len(table.rows))),),
        more=(("spread", table),),
        methods=('["P.m"]', ".models()", ".plot()", ".to_frame()", '.save("models.npz")'),
    )


def samples_frame(value: Samples) -> pl.DataFrame:
    return pl.DataFrame(value.p, schema=list(value.names))


def samples_figure(value: Samples) -> go.Figure:
    """Median and middle 50 and 95 % of every parameter that varies, relative to the fitted
    value."""
    fitted = value.model.layout.named(value.model.p)
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
