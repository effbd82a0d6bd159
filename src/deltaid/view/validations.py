"""How well a model predicts a recording."""

from typing import TYPE_CHECKING

import polars as pl

from deltaid.identification.validation import Validation
from deltaid.view.card import Card
from deltaid.view.model_tables import error_table
from deltaid.view.models import warned
from deltaid.view.numbers import percent
from deltaid.view.summary import summary

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from deltaid.view.page import Page


def card(value: Validation) -> Card:
    """The verdict and the torque errors."""
    model, found = value.model, summary(value.model, value.error, value.log)
    shares = zip(model.robot.drives, value.error.nrmse, strict=True)
    return Card(
        f"{model.robot.title or model.robot.name} compared with {value.log.path.name}",
        (found.sentence,),
        found.grade,
        tuple((f"{drive} error", percent(float(share))) for drive, share in shares),
        error_table(model, value.error),
        warned(value.remarks),
        (".error", ".log", ".plot()", ".to_frame()", '.report("x.html")'),
    )


def frame(value: Validation) -> pl.DataFrame:
    """Torque errors, a row a drive."""
    units = value.model.robot.drive_units
    return pl.DataFrame(
        {
            "drive": list(units),
            "rms": value.error.rms,
            "nrmse": value.error.nrmse,
            "rms_unfiltered": value.error.rms_unfiltered,
            "unit": [one.force for one in units.values()],
        }
    )


def figure(value: Validation) -> "go.Figure":
    """Torques, measured and predicted."""
    from deltaid.identification.sources import model_filtered
    from deltaid.view.torque_errors import torques

    return torques(value.model, model_filtered(value.model, value.log))


def page(value: Validation) -> "Page":
    """The page of `deltaid validate`."""
    from deltaid.identification.sources import model_filtered
    from deltaid.view.validation import validation_page

    recording = model_filtered(value.model, value.log)
    return validation_page(value.model, recording, value.error)
