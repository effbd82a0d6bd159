"""The page of `deltaid identify`: the model, how well it predicts, and what it rests on."""

from dataclasses import dataclass

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.identification.identify import Identification
from deltaid.identification.torque_error import TorqueError
from deltaid.identification.validation import remarks
from deltaid.model.model import load
from deltaid.model.record import IdentifiedModel
from deltaid.recording.log import Log
from deltaid.recording.recording import Recording
from deltaid.report.animation import animation, recorded_motion
from deltaid.report.bodies import body_section
from deltaid.report.comparison import Comparison, compare
from deltaid.report.friction import friction_section
from deltaid.report.information import information_section
from deltaid.report.model_tables import error_table
from deltaid.report.numbers import number, percent
from deltaid.report.page import Fact, Page, Section
from deltaid.report.parameters import parameter_section
from deltaid.report.provenance import file_names, provenance_section
from deltaid.report.put_right_section import put_right_sections
from deltaid.report.torques import torque_blocks
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class Verification:
    """A recording that the model has not seen, and the model's torque errors on it."""

    recording: Recording
    error: TorqueError


def identification_page(result: Identification, verification: Verification | None = None) -> Page:
    """Everything about an identified model.

    Reads its recordings once more, in constant memory.
    """
    model = result.model
    dynamics = compiled(model.robot)
    recordings = result.recordings
    comparisons = tuple(compare(dynamics, model.p, recording) for recording in recordings)
    sections = [
        torque_section(model.robot, comparison, _title(recording.log, len(recordings)))
        for comparison, recording in zip(comparisons, recordings, strict=True)
    ]
    warnings = list(model.warnings)
    if verification is not None:
        log = verification.recording.log
        unseen = compare(dynamics, model.p, verification.recording)
        sections.append(torque_section(model.robot, unseen, "Verification"))
        texts = remarks(model, log, verification.error)
        warnings += [f"{log.path.name}: {text}" for text in texts]
    errors = error_table(load(model), verification.error if verification else None)
    sections[0] = Section(sections[0].title, (errors, *sections[0].blocks))
    verified = f", verified on {verification.recording.path.name}" if verification else ""
    return Page(
        title=model.robot.title or model.robot.name,
        subtitle=f"Dynamic model identified from {file_names(model)}{verified}",
        facts=(*_error_facts(model, verification), *_fit_facts(model)),
        sections=(
            *put_right_sections(model),
            *sections,
            motion_section(dynamics, recordings[0]),
            parameter_section(model),
            friction_section(model, comparisons),
            body_section(model, dynamics.kinematics),
            information_section(result),
            provenance_section(load(model), "Data and settings"),
        ),
        warnings=tuple(warnings),
    )


def torque_section(robot: RobotDescription, comparison: Comparison, title: str) -> Section:
    """All figures of torques along one recording."""
    return Section(title, torque_blocks(comparison, robot.drive_units))


def motion_section(dynamics: Dynamics, recording: Recording) -> Section:
    """The robot on a recorded motion."""
    figure = animation(
        dynamics.kinematics,
        recorded_motion(dynamics.kinematics, recording),
        f"The robot on the recorded motion of {recording.path.name}, in real time: the liveliest "
        "seconds of its first minute. Drag to turn the view. The distance of the two struts in a "
        "pair is not part of the description and drawn as it looks usual.",
    )
    return Section("Motion", (figure,))


def _title(log: Log, count: int) -> str:
    return "Torques" if count == 1 else f"Torques: {log.path.name}"


def _error_facts(model: IdentifiedModel, verification: Verification | None) -> tuple[Fact, ...]:
    facts = []
    for i, drive in enumerate(model.robot.drives):
        note = f"{number(model.fit.rms[i], 2)} {model.robot.units(drive).force} rms"
        if verification is not None:
            note = f"{note}; verification {percent(float(verification.error.nrmse[i]))}"
        facts.append(
            Fact(
                f"{drive}, {model.robot.units(drive).effort} error",
                percent(model.fit.nrmse[i]),
                note,
            )
        )
    return tuple(facts)


def _fit_facts(model: IdentifiedModel) -> tuple[Fact, ...]:
    fit = model.fit
    gap = fit.duality_gap
    optimum = (
        Fact("optimum", "not certified", "this regulariser is not convex")
        if gap is None
        else Fact("duality gap", f"{gap:.1e}", f"of an objective of {number(fit.objective, 3)}")
    )
    return (
        optimum,
        Fact(
            "base parameters",
            str(fit.base_parameters),
            f"condition {number(fit.base_condition, 3)}",
        ),
        Fact(
            "physical consistency",
            "all bodies" if model.consistent else "violated",
            f"{len(model.consistency)} bodies, friction positive",
        ),
    )
