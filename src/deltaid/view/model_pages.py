"""Pages of a model: as it was identified, compared with a recording, and by itself."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.identification.identify import Identification
from deltaid.identification.prediction import Validation
from deltaid.identification.sources import left_out, model_filtered
from deltaid.model.model import Model, load
from deltaid.model.record import IdentifiedModel
from deltaid.model.verdict import Grade, Verdict, worst
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.description import RobotDescription
from deltaid.view.animation import animation, body_section, recorded_motion
from deltaid.view.check import page_table, short_table, tally
from deltaid.view.comparison import TorqueComparison, compare
from deltaid.view.corrections import left_out_table, put_right_sections
from deltaid.view.drawing import drawing
from deltaid.view.model_tables import base_table, error_table
from deltaid.view.models import fit_errors
from deltaid.view.numbers import measured, percent
from deltaid.view.page import Fact, Page, Section
from deltaid.view.parameters import information_section, parameter_chart, parameter_section
from deltaid.view.robots import robot_figure, robot_page
from deltaid.view.summary import (
    certificate,
    file_names,
    provenance_section,
    summary,
    without_doubts,
)
from deltaid.view.torques import friction_section, over_time, residual_blocks, torque_blocks

# Height of one drive's two plots in a notebook, and of what is around all of them [px].
_DRIVE, _AROUND = 170, 90


def identification_page(result: Identification, verification: Validation | None = None) -> Page:
    """The page of `deltaid identify`: everything about an identified model.

    Reads its recordings once more, in constant memory.

    Args:
        verification: the model compared with a recording that it has not seen.
    """
    model, verdicts = result.model, getattr(result, "verdicts", ())
    dynamics, drives = compiled(model.robot), model.robot.drive_units
    recordings = result.recordings
    comparisons = tuple(compare(dynamics, model.p, recording) for recording in recordings)
    # What the checks say stands in their table, beneath the verdict.
    sentences = {verdict.sentence for verdict in verdicts}
    warnings = [text for text in model.warnings if text not in sentences]
    log, error, unseen = None, None, None
    if verification is not None:
        error, log = verification
        unseen = compare(dynamics, model.p, model_filtered(model, log))
        warnings += [f"{log.path.name}: {text}" for text in verification.remarks]
    seen = unseen or comparisons[0]
    sections = [
        torque_section(
            model.robot,
            comparison,
            "Torques" if len(recordings) == 1 else f"Torques: {recording.path.name}",
            front=comparison is seen,
        )
        for comparison, recording in zip(comparisons, recordings, strict=True)
    ]
    if unseen is not None:
        sections.append(torque_section(model.robot, unseen, "Verification", front=True))
    verified = f", verified on {log.path.name}" if log else ""
    return Page(
        title=model.robot.title or model.robot.name,
        subtitle=f"Dynamic model identified from {file_names(model)}{verified}",
        verdict=without_doubts(summary(result, error, log)),
        drawing=drawing(model.robot, dynamics.kinematics),
        facts=(*_error_facts(model, verification), *_check_facts(verdicts), *_fit_facts(model)),
        front=(
            *((short_table(verdicts),) if verdicts else ()),
            error_table(load(model), error),
            over_time(seen, drives),
        ),
        sections=(
            *put_right_sections(model),
            *sections,
            motion_section(dynamics, recordings[0]),
            parameter_section(model),
            friction_section(model, comparisons),
            body_section(model, dynamics.kinematics),
            information_section(result),
            *check_sections(verdicts),
            provenance_section(load(model), "Data and settings"),
        ),
        warnings=tuple(warnings),
    )


def check_sections(verdicts: Sequence[Verdict]) -> tuple[Section, ...]:
    """All verdicts of the checks; nothing where none were asked."""
    chapter = Section("Checks", (page_table(verdicts),), f"all verdicts: {tally(verdicts)}")
    return (chapter,) if verdicts else ()


def torque_section(
    robot: RobotDescription, comparison: TorqueComparison, title: str, *, front: bool
) -> Section:
    """All figures of torques along one recording; without that which the page's front shows."""
    blocks, about = residual_blocks, "the residual over speed, in size and in frequency"
    if not front:
        blocks, about = torque_blocks, "measured and predicted over time, and the residual"
    return Section(title, blocks(comparison, robot.drive_units), about)


def motion_section(dynamics: Dynamics, recording: PreparedRecording) -> Section:
    """The robot on a recorded motion."""
    figure = animation(
        dynamics.kinematics,
        recorded_motion(dynamics.kinematics, recording),
        f"The robot on the recorded motion of {recording.path.name}, in real time: the liveliest "
        "seconds of its first minute. Drag to turn the view. The distance of the two struts in a "
        "pair is not part of the description and drawn as it looks usual.",
    )
    return Section("Motion", (figure,), "the robot moving as it was recorded")


def _error_facts(model: IdentifiedModel, verification: Validation | None) -> Iterator[Fact]:
    errors = {"error on its own recording": model.fit.nrmse}
    if verification is not None:
        errors = {"error on the unseen motion": verification.error.nrmse.tolist()} | errors
    for label, shares in errors.items():
        worst_drive = int(np.argmax(shares))
        note = f"rms of {model.robot.drives[worst_drive]}, the worst drive"
        yield Fact(label, percent(shares[worst_drive]), note)


def _check_facts(verdicts: Sequence[Verdict]) -> tuple[Fact, ...]:
    if not verdicts:
        return ()
    grade = worst(list(verdicts))
    poor = dict.fromkeys(verdict.key for verdict in verdicts if verdict.grade is grade)
    value = "all good" if grade is Grade.GOOD else f"{len(poor)} {grade}"
    return (Fact("checks", value, tally(verdicts) if grade is Grade.GOOD else ", ".join(poor)),)


def _fit_facts(model: IdentifiedModel) -> tuple[Fact, ...]:
    certified = "not certified", "this regulariser is not convex"
    if model.fit.duality_gap is not None:
        certified = certificate(model.fit)
    return (
        Fact("optimum", *certified),
        Fact(
            "physical consistency",
            "all bodies" if model.consistent else "violated",
            f"{len(model.consistency)} bodies, friction positive",
        ),
    )


def validation_page(value: Validation) -> Page:
    """The page of `deltaid validate`: how well a model predicts a recording, and its origin."""
    model, (error, log) = value.model, value
    dynamics, known, recording = model.dynamics, model.identified, model_filtered(model, log)
    comparison = compare(dynamics, model.p, recording)
    torques = torque_section(model.robot, comparison, "Torques", front=True)
    base = ()
    if known and known.base_parameters:  # which models of earlier versions do not hold
        tables = (base_table(known.base_parameters),)
        base = (Section("Base parameters", tables, "combinations that the torques determine"),)
    missing = left_out_table([(log.path.name, left_out(log, model.robot.drives, error))])
    return Page(
        title=model.robot.title or model.robot.name,
        subtitle=f"Parameters: {model.origin}; compared with {log.path.name}",
        verdict=without_doubts(summary(model, error, log)),
        drawing=drawing(model.robot, dynamics.kinematics),
        front=(error_table(model, error), over_time(comparison, model.robot.drive_units)),
        facts=tuple(
            Fact(
                f"{drive}, {model.robot.units(drive).effort} error",
                percent(float(error.nrmse[i])),
                f"{measured(float(error.rms[i]), 2)} {model.robot.units(drive).force} rms"
                + (f"; identification {percent(known.fit.nrmse[i])}" if known else ""),
            )
            for i, drive in enumerate(model.robot.drives)
        ),
        sections=(
            replace(torques, blocks=(*((missing,) if missing else ()), *torques.blocks)),
            motion_section(dynamics, recording),
            friction_section(model, (comparison,)),
            *((parameter_section(known),) if known else ()),
            *base,
            *put_right_sections(model.identified),
            provenance_section(model, "The model"),
        ),
        warnings=(
            *(f"{log.path.name}: {text}" for text in value.remarks),
            *(known.warnings if known else ()),
        ),
    )


def model_page(value: Model | IdentifiedModel) -> Page:
    """What a model is by itself, without the recordings that it comes from."""
    model = load(value)
    known = model.identified
    if known is None:
        return robot_page(model.robot)
    return Page(
        title=model.robot.title or model.robot.name,
        subtitle=f"Dynamic model, {model.origin}",
        verdict=without_doubts(summary(model)),
        drawing=drawing(model.robot, model.dynamics.kinematics),
        front=(error_table(model, None),),
        facts=tuple(Fact(name, share) for name, share in fit_errors(known)),
        sections=(
            parameter_section(known),
            body_section(known, model.dynamics.kinematics),
            *put_right_sections(known),
            provenance_section(model, "The model"),
        ),
        warnings=known.warnings,
    )


def model_figure(value: Model | IdentifiedModel) -> go.Figure:
    """Parameters beside their prior, with intervals; of a robot at its prior the robot."""
    model = load(value)
    if model.identified is None:
        return robot_figure(model.robot)
    return parameter_chart(model.identified).figure


def identification_figure(value: Identification) -> go.Figure:
    """Torques of its first recording, measured and predicted."""
    return _torques(load(value.model), value.recordings[0])


def validation_figure(value: Validation) -> go.Figure:
    """Torques of a recording, measured and predicted."""
    return _torques(value.model, model_filtered(value.model, value.log))


def _torques(model: Model, recording: PreparedRecording) -> go.Figure:
    compared, drives = compare(model.dynamics, model.p, recording), model.robot.drive_units
    return over_time(compared, drives).figure.update_layout(height=_DRIVE * len(drives) + _AROUND)
