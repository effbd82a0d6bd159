"""Pages of a model: its identification, its comparison with a recording, and the model alone."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.identification.identify import Identification
from deltaid.identification.loads import as_identified
from deltaid.identification.prediction import Validation
from deltaid.identification.sources import left_out
from deltaid.identification.torque_error import TorqueError
from deltaid.model.model import Model, load
from deltaid.model.record import IdentifiedModel
from deltaid.model.verdict import Grade, Verdict, worst
from deltaid.recording.recording import PreparedRecording
from deltaid.view import animation, corrections, drawing, model_tables, models, parameters, robots
from deltaid.view.check import page_table, short_table, tally
from deltaid.view.comparison import TorqueComparison, compare
from deltaid.view.friction_laws import friction_section
from deltaid.view.numbers import measured, percent
from deltaid.view.page import Fact, Page, Section
from deltaid.view.summary import (
    certificate,
    provenance_section,
    summary,
    without_doubts,
)
from deltaid.view.torques import over_time, residual_blocks


def identification_page(result: Identification, verification: Validation | None = None) -> Page:
    """The page of `deltaid identify`.

    Its recordings are read once more, in constant memory.

    Args:
        verification: comparison of the model with another recording.
    """
    model, verdicts = result.model, getattr(result, "verdicts", ())
    dynamics, recordings = compiled(model.robot), result.recordings
    comparisons = tuple(compare(dynamics, model.p, recording) for recording in recordings)
    # The table of checks below the verdict shows these sentences already.
    sentences = {verdict.sentence for verdict in verdicts}
    warnings = [text for text in model.warnings if text not in sentences]
    log, error, main, verified = None, None, comparisons[0], ""
    if verification is not None:
        error, log = verification
        main = compare(dynamics, model.p, as_identified(load(model), log))
        verified = log.path.name
        warnings += [f"{verified}: {text}" for text in verification.remarks]
    titles = [f"Torques: {x.path.name}" for x in recordings] if recordings[1:] else ["Torques"]
    shown = [
        *zip(comparisons, titles, strict=True),
        *([(main, "Verification")] if verified else []),
    ]
    checks = Section("Checks", (page_table(verdicts),), f"all verdicts: {tally(verdicts)}")
    logs = ", ".join(source.log for source in model.sources)
    whence = f"identified from {logs}{f', verified on {verified}' if verified else ''}"
    return Page(
        title=model.robot.label,
        subtitle=f"Dynamic model {whence}",
        verdict=without_doubts(summary(result, error, log)),
        drawing=drawing.drawing(model.robot, dynamics.kinematics),
        facts=_facts(model, error, verdicts),
        front=(
            *((short_table(verdicts),) if verdicts else ()),
            model_tables.error_table(load(model), error),
            over_time(main),
        ),
        sections=(
            corrections.correction_section(model),
            *(_torque_section(x, title, front=x is main) for x, title in shown),
            _motion_section(dynamics, recordings[0]),
            parameters.parameter_section(model),
            friction_section(model, comparisons),
            animation.body_section(model, dynamics.kinematics),
            parameters.information_section(result),
            checks,
            provenance_section(load(model), "Data and settings"),
        ),
        warnings=tuple(warnings),
    )


def _torque_section(comparison: TorqueComparison, title: str, *, front: bool) -> Section:
    """Figures of torques along one recording, without the one at the page's front."""
    first, about = (), "the residual over speed, in size and in frequency"
    if not front:
        first = (over_time(comparison),)
        about = "measured and predicted over time, and the residual"
    return Section(title, (*first, *residual_blocks(comparison)), about)


def _motion_section(dynamics: Dynamics, recording: PreparedRecording) -> Section:
    figure = animation.animation(
        dynamics.kinematics,
        *animation.recorded_motion(dynamics.kinematics, recording),
        f"The robot on the recorded motion of {recording.path.name}, in real time: the liveliest "
        "seconds of its first minute. Drag to turn the view. The distance of the two struts in a "
        "pair is not part of the description and drawn as it looks usual.",
    )
    return Section("Motion", (figure,), "the robot moving as it was recorded")


def _facts(
    model: IdentifiedModel, error: TorqueError | None, verdicts: Sequence[Verdict]
) -> tuple[Fact, ...]:
    facts, errors = list[Fact](), {"error on its own recording": model.fit.nrmse}
    if error is not None:
        errors = {"error on the unseen motion": error.nrmse.tolist()} | errors
    for label, shares in errors.items():
        drive = int(np.argmax(shares))
        note = f"rms of {model.robot.drives[drive]}, the worst drive"
        facts.append(Fact(label, percent(shares[drive]), note))
    if verdicts:
        grade = worst(list(verdicts))
        poor = dict.fromkeys(verdict.key for verdict in verdicts if verdict.grade is grade)
        value, note = f"{len(poor)} {grade}", ", ".join(poor)
        if grade is Grade.GOOD:
            value, note = "all good", tally(verdicts)
        facts.append(Fact("checks", value, note))
    bodies = "all bodies" if model.consistent else "violated"
    count = len(model.consistency)
    note = f"{count} {'body' if count == 1 else 'bodies'}, friction positive"
    optimum = Fact("optimum", *certificate(model.fit))
    return (*facts, optimum, Fact("physical consistency", bodies, note))


def validation_page(value: Validation) -> Page:
    """The page of `deltaid validate`: a model's errors on a recording, and its origin."""
    model, (error, log) = value.model, value
    dynamics, known, recording = model.dynamics, model.identified, as_identified(model, log)
    comparison = compare(dynamics, model.p, recording)
    base = model_tables.base_table(known.base_parameters if known else ())
    missing = corrections.left_out_table(
        [(log.path.name, left_out(log, model.robot.drives, error))]
    )
    torques = _torque_section(comparison, "Torques", front=True)
    return Page(
        title=model.robot.label,
        subtitle=f"Parameters: {model.origin}; compared with {log.path.name}",
        verdict=without_doubts(summary(model, error, log)),
        drawing=drawing.drawing(model.robot, dynamics.kinematics),
        front=(
            model_tables.error_table(model, error),
            over_time(comparison),
        ),
        facts=tuple(
            Fact(
                f"{drive}, {units.effort} error",
                percent(float(error.nrmse[i])),
                f"{measured(float(error.rms[i]), 2)} {units.force} rms"
                + (f"; identification {percent(known.fit.nrmse[i])}" if known else ""),
            )
            for i, (drive, units) in enumerate(model.robot.drive_units.items())
        ),
        sections=(
            replace(torques, blocks=(missing, *torques.blocks)),
            _motion_section(dynamics, recording),
            friction_section(model, (comparison,)),
            *([parameters.parameter_section(known)] if known else []),
            Section("Base parameters", (base,), "combinations that the torques determine"),
            corrections.correction_section(model.identified),
            provenance_section(model, "The model"),
        ),
        warnings=(
            *(f"{log.path.name}: {text}" for text in value.remarks),
            *(known.warnings if known else ()),
        ),
    )


def model_page(value: Model | IdentifiedModel) -> Page:
    """The page of a model without its recordings."""
    model = load(value)
    known = model.identified
    if known is None:
        return robots.robot_page(model.robot)
    return Page(
        title=model.robot.label,
        subtitle=f"Dynamic model, {model.origin}",
        verdict=without_doubts(summary(model)),
        drawing=drawing.drawing(model.robot, model.dynamics.kinematics),
        front=(model_tables.error_table(model, None),),
        facts=tuple(
            Fact(name, share) for name, share in models.drive_errors(model.robot, known.fit.nrmse)
        ),
        sections=(
            parameters.parameter_section(known),
            animation.body_section(known, model.dynamics.kinematics),
            corrections.correction_section(known),
            provenance_section(model, "The model"),
        ),
        warnings=known.warnings,
    )


def model_figure(value: Model | IdentifiedModel) -> go.Figure:
    """Parameters compared with their prior, with intervals; for a prior, the robot."""
    model = load(value)
    if model.identified is None:
        return robots.robot_figure(model.robot)
    return parameters.parameter_chart(model.identified).figure


def identification_figure(value: Identification) -> go.Figure:
    """Measured and predicted torques of the first recording."""
    return _torques(load(value.model), value.recordings[0])


def validation_figure(value: Validation) -> go.Figure:
    return _torques(value.model, as_identified(value.model, value.log))


def _torques(model: Model, recording: PreparedRecording) -> go.Figure:
    figure = over_time(compare(model.dynamics, model.p, recording)).figure
    return figure.update_layout(height=170 * len(model.robot.drives) + 90)
