"""Models: identified, or a robot at its prior."""

from typing import TYPE_CHECKING

import polars as pl

from deltaid.model.model import Model, load
from deltaid.model.record import IdentifiedModel
from deltaid.view.card import Card
from deltaid.view.model_tables import error_table, parameter_table
from deltaid.view.numbers import percent
from deltaid.view.summary import summary, without_doubts

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from deltaid.view.page import Page

_NEXT = ('["P.m"]', ".dynamics", ".plot()", ".to_frame()", '.report("x.html")')


def card(value: Model | IdentifiedModel) -> Card:
    """The verdict, the torque errors; folded the parameters and the warnings."""
    model = load(value)
    found, known = summary(model), model.identified
    title = f"Model of {model.robot.title or model.robot.name}, {model.origin}"
    if known is None:
        facts = (("parameters", str(len(model.p))), ("drives", str(len(model.robot.drives))))
        return Card(title, (found.sentence, *found.lines), found.grade, facts, methods=_NEXT)
    return Card(
        title,
        (found.sentence, *found.lines[:2]),
        found.grade,
        errors(known),
        error_table(model, None),
        (("parameters", parameter_table(known)), *warned(known.warnings)),
        (*_NEXT, ".sample(100)", *(('.save("model.yaml")',) * isinstance(value, IdentifiedModel))),
    )


def errors(model: IdentifiedModel) -> tuple[tuple[str, str], ...]:
    """Torque errors of the fit, drive by drive."""
    pairs = zip(model.robot.drives, model.fit.nrmse, strict=True)
    return tuple((f"{drive} error", percent(share)) for drive, share in pairs)


def warned(warnings: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Warnings, folded away."""
    if not warnings:
        return ()
    title = "1 warning" if len(warnings) == 1 else f"{len(warnings)} warnings"
    return ((title, "\n".join(warnings)),)


def frame(value: Model | IdentifiedModel) -> pl.DataFrame:
    """Parameters, a row each; of a robot at its prior without intervals."""
    model = load(value)
    if model.identified is None:
        values = {"name": model.layout.names, "value": model.p, "unit": model.layout.units}
        return pl.DataFrame(values)
    rows = [
        (p.name, p.value, p.std, p.low, p.high, p.unit, p.prior, p.determined_by,
         ", ".join(p.rests_on))
        for p in model.identified.parameters
    ]  # fmt: skip
    numbers = ("value", "std", "low", "high", "prior")
    names = ("name", "value", "std", "low", "high", "unit", "prior", "determined_by", "rests_on")
    schema = {name: pl.Float64 if name in numbers else pl.String for name in names}
    return pl.DataFrame(rows, schema=schema, orient="row")


def figure(value: Model | IdentifiedModel) -> "go.Figure":
    """Parameters beside their prior, with intervals; of a robot at its prior the robot."""
    from deltaid.view.parameters import parameter_section
    from deltaid.view.robots import drawn
    from deltaid.view.theme import first_figure

    model = load(value)
    if model.identified is None:
        return drawn(model.robot)
    return first_figure([parameter_section(model.identified)])


def page(value: Model | IdentifiedModel) -> "Page":
    """What a model is by itself, without the recordings that it comes from."""
    from deltaid.view.bodies import body_section
    from deltaid.view.corrections import put_right_sections
    from deltaid.view.drawing import drawing
    from deltaid.view.page import Fact, Page
    from deltaid.view.parameters import parameter_section
    from deltaid.view.provenance import provenance_section
    from deltaid.view.robots import page as of_robot

    model = load(value)
    known, found = model.identified, summary(model)
    if known is None:
        return of_robot(model.robot)
    return Page(
        title=model.robot.title or model.robot.name,
        subtitle=f"Dynamic model, {model.origin}",
        verdict=without_doubts(found),
        drawing=drawing(model.robot, model.dynamics.kinematics),
        front=(error_table(model, None),),
        facts=tuple(Fact(name, share) for name, share in errors(known)),
        sections=(
            parameter_section(known),
            body_section(known, model.dynamics.kinematics),
            *put_right_sections(known),
            provenance_section(model, "The model"),
        ),
        warnings=known.warnings,
    )
