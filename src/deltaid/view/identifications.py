"""The result of an identification."""

from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from deltaid.identification.identify import Identification
from deltaid.model.verdict import Grade
from deltaid.view import models
from deltaid.view.card import Card
from deltaid.view.check_tables import page_table
from deltaid.view.summary import summary

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from deltaid.identification.validation import Validation
    from deltaid.view.page import Page


def card(value: Identification) -> Card:
    """That of its model, with the verdict on fit and checks."""
    of_model, found = models.card(value.model), summary(value)
    robot = value.model.robot
    logs = ", ".join(one.path.name for one in value.recordings)
    poor = [one for one in getattr(value, "verdicts", ()) if one.grade is not Grade.GOOD]
    checks = (("checks that are not good", page_table(poor)),) if poor else ()
    return replace(
        of_model,
        title=f"Identification of {robot.title or robot.name} from {logs}",
        lines=(found.sentence, *found.lines[:2]),
        grade=found.grade,
        more=(*checks, *of_model.more),
        methods=(".model", ".verdicts", ".plot()", ".to_frame()", '.report("x.html")',
                 '.save("model.yaml")'),
    )  # fmt: skip


def frame(value: Identification) -> pl.DataFrame:
    """Its model's parameters."""
    return models.frame(value.model)


def figure(value: Identification) -> "go.Figure":
    """Torques of its first recording, measured and predicted."""
    from deltaid.view.torque_errors import torques

    return torques(value.model, value.recordings[0])


def page(value: Identification, verification: "Validation | None" = None) -> "Page":
    """The page of `deltaid identify`."""
    from deltaid.identification.sources import model_filtered
    from deltaid.view.identification import Verification, identification_page

    if verification is None:
        return identification_page(value)
    unseen = model_filtered(verification.model, verification.log)
    return identification_page(value, Verification(unseen, verification.error))
