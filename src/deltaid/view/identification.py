"""The page of `deltaid identify`: the model, how well it predicts, and what it rests on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.identification.identify import Identification
from deltaid.identification.torque_error import TorqueError
from deltaid.identification.validation import remarks
from deltaid.model.model import load
from deltaid.model.record import IdentifiedModel
from deltaid.model.verdict import Grade, Verdict, worst
from deltaid.recording.log import Log
from deltaid.recording.recording import Recording
from deltaid.robot.description import RobotDescription
from deltaid.view.animation import animation, recorded_motion
from deltaid.view.bodies import body_section
from deltaid.view.check_tables import page_table, short_table, tally
from deltaid.view.comparison import Comparison, compare
from deltaid.view.corrections import put_right_sections
from deltaid.view.drawing import drawing
from deltaid.view.friction import friction_section
from deltaid.view.information import information_section
from deltaid.view.model_tables import error_table
from deltaid.view.numbers import percent
from deltaid.view.page import Fact, Page, Section
from deltaid.view.parameters import parameter_section
from deltaid.view.provenance import certificate, file_names, provenance_section
from deltaid.view.summary import summary, without_doubts
from deltaid.view.torques import over_time, residual_blocks, torque_blocks


@dataclass(frozen=True)
class Verification:
    """A recording that the model has not seen, and the model's torque errors on it."""

    recording: Recording
    error: TorqueError


def identification_page(result: Identification, verification: Verification | None = None) -> Page:
    """Everything about an identified model.

    Reads its recordings once more, in constant memory.
    """
    model, verdicts = result.model, getattr(result, "verdicts", ())
    dynamics, drives = compiled(model.robot), model.robot.drive_units
    recordings = result.recordings
    comparisons = tuple(compare(dynamics, model.p, recording) for recording in recordings)
    # What the checks say stands in their table, beneath the verdict.
    told = {one.sentence for one in verdicts}
    warnings = [text for text in model.warnings if text not in told]
    log, error, unseen = None, None, None
    if verification is not None:
        log, error = verification.recording.log, verification.error
        unseen = compare(dynamics, model.p, verification.recording)
        warnings += [f"{log.path.name}: {text}" for text in remarks(model, log, error)]
    seen = unseen or comparisons[0]
    sections = [
        torque_section(model.robot, one, _title(recording.log, len(recordings)), front=one is seen)
        for one, recording in zip(comparisons, recordings, strict=True)
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
    if not verdicts:
        return ()
    return (Section("Checks", (page_table(verdicts),), f"all verdicts: {tally(verdicts)}"),)


def torque_section(
    robot: RobotDescription, comparison: Comparison, title: str, *, front: bool
) -> Section:
    """All figures of torques along one recording; without that which the page's front shows."""
    if front:
        blocks = residual_blocks(comparison, robot.drive_units)
        return Section(title, blocks, "what is left, over speed, in size and in frequency")
    blocks = torque_blocks(comparison, robot.drive_units)
    return Section(title, blocks, "measured and predicted over time, and what is left")


def motion_section(dynamics: Dynamics, recording: Recording) -> Section:
    """The robot on a recorded motion."""
    figure = animation(
        dynamics.kinematics,
        recorded_motion(dynamics.kinematics, recording),
        f"The robot on the recorded motion of {recording.path.name}, in real time: the liveliest "
        "seconds of its first minute. Drag to turn the view. The distance of the two struts in a "
        "pair is not part of the description and drawn as it looks usual.",
    )
    return Section("Motion", (figure,), "the robot moving as it was recorded")


def _title(log: Log, count: int) -> str:
    return "Torques" if count == 1 else f"Torques: {log.path.name}"


def _error_facts(model: IdentifiedModel, verification: Verification | None) -> tuple[Fact, ...]:
    """The worst drive's errors, on the motion that is unseen and on that of the identification."""
    own = _worst(model.robot, "error on its own recording", model.fit.nrmse)
    if verification is None:
        return (own,)
    unseen = verification.error.nrmse.tolist()
    return _worst(model.robot, "error on the unseen motion", unseen), own


def _worst(robot: RobotDescription, label: str, shares: Sequence[float]) -> Fact:
    largest = int(np.argmax(shares))
    drive = robot.drives[largest]
    return Fact(label, percent(shares[largest]), f"rms of {drive}, the worst drive")


def _check_facts(verdicts: Sequence[Verdict]) -> tuple[Fact, ...]:
    """What the checks say in the worst case, and how many say what."""
    if not verdicts:
        return ()
    grade = worst(list(verdicts))
    poor = dict.fromkeys(one.key for one in verdicts if one.grade is grade)
    value = "all good" if grade is Grade.GOOD else f"{len(poor)} {grade}"
    return (Fact("checks", value, tally(verdicts) if grade is Grade.GOOD else ", ".join(poor)),)


def _fit_facts(model: IdentifiedModel) -> tuple[Fact, ...]:
    fit = model.fit
    optimum = (
        Fact("optimum", "not certified", "this regulariser is not convex")
        if fit.duality_gap is None
        else Fact("optimum", *certificate(fit))
    )
    return (
        optimum,
        Fact(
            "physical consistency",
            "all bodies" if model.consistent else "violated",
            f"{len(model.consistency)} bodies, friction positive",
        ),
    )
