"""Results of `deltaid identify`: tables and sentences, JSON, a page."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import deltaid
from deltaid.cli.output import SCREEN, print_found

if TYPE_CHECKING:
    from deltaid.identification.prediction import Compared
    from deltaid.identification.torque_error import TorqueError

# Names of columns that are too wide for a screen.
_WIDE = ("unfiltered", "why")


def as_dictionary(
    result: "deltaid.Identification",
    verification: "TorqueError | None",
    log: "Compared | None" = None,
) -> dict[str, Any]:
    """The result as data for one JSON object; `log` is the recording of the verification."""
    from deltaid.view.summary import summary

    model, layout = result.model, result.model.layout
    value = {
        "robot": model.robot.name,
        "summary": asdict(summary(result, verification, log)),
        "method": model.settings.method,
        "regularizer": model.settings.regularizer,
        "intervals": model.settings.intervals,
        **model.fit.model_dump(),
        "samples": round(result.problem.information.mean_samples),
        "cutoff_hz": [source.cutoff_hz for source in model.sources],
        "corrections": [correction.model_dump() for correction in model.corrections],
        "loads": [load.model_dump() for load in model.loads],
        "sensors": [sensor.model_dump() for sensor in model.sensors],
        "left_out": [
            {"log": source.log, **span.model_dump()}
            for source in model.sources
            for span in source.left_out
        ],
        "events": [
            {"log": source.log, **event.model_dump()}
            for source in model.sources
            for event in source.events
        ],
        "clock": [
            {"log": recording.path.name, **asdict(recording.clock)}
            for recording in result.recordings
        ],
        "friction": {
            "joints": list(model.robot.friction_joints),
            "viscous": model.p[layout.viscous],
            "coulomb": model.p[layout.coulomb],
            "laws": {
                joint: law.model_dump(exclude_none=True)
                for joint, law in model.robot.friction.items()
            },
            "choice": model.friction_choice and model.friction_choice.model_dump(),
            "curves": [curve.model_dump() for curve in model.friction_curves],
        },
        "consistent": model.consistent,
        "parameters": [parameter.model_dump() for parameter in model.parameters],
        "base_values": [parameter.model_dump() for parameter in model.base_parameters],
        "warnings": list(model.warnings),
    }
    if verification is not None:
        value["verify"] = error_dictionary(verification)
    return value


def error_dictionary(error: "TorqueError") -> dict[str, Any]:
    return {
        "rms": error.rms,
        "nrmse": error.nrmse,
        "rms_unfiltered": error.rms_unfiltered,
        "cutoff_hz": error.cutoff,
    }


def print_result(
    result: "deltaid.Identification",
    verification: "TorqueError | None",
    log: "Compared | None" = None,
    *,
    truth: Sequence[float] | None = None,
    against: str = "",
    full: bool,
) -> None:
    """Print the verdict, and as many tables as fit a screen.

    Args:
        verification, log: torque errors on a recording of another motion, and this recording.
        truth, against: parameters of a simulated robot, and a sentence on the distance from them.
        full: whether to print all tables.
    """
    from deltaid.view import corrections, model_tables, parameters
    from deltaid.view.summary import provenance_tables, summary, without_doubts

    model, choice = result.model, result.model.friction_choice
    said = without_doubts(summary(result, verification, log))
    tables = [model_tables.error_table(deltaid.load(model), verification)]
    sources, fit = provenance_tables(model)
    further = [model_tables.parameter_table(model, truth), sources.without("SHA-256"), fit]
    details = [*model_tables.sums(model), *filter(None, [parameters.shares_sentence(model)])]
    if choice is not None and choice.steps:
        further.append(model_tables.choice_table(choice, model.robot))
        details.append(model_tables.choice_sentence(choice))
    corrected = corrections.correction_tables(model, SCREEN)
    if not full and model.corrections:  # their table comes first
        tables, corrected = [*tables, corrected[0]], corrected[1:]
    title = model.robot.label
    print_found(
        [
            f"{title}{', simulated' if against else ''}",
            said.sentence,
            *said.lines,
            *([against] if against else []),
        ],
        tables if full else [table.without(*_WIDE) for table in tables],
        [*further, *corrected],
        details,
        full=full,
    )
