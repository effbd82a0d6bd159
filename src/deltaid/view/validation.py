"""The page of `deltaid validate`: a model's torques on a recording it has not seen."""

from dataclasses import replace

from deltaid.identification.sources import left_out
from deltaid.identification.torque_error import TorqueError
from deltaid.identification.validation import remarks
from deltaid.model.model import ModelLike, load
from deltaid.model.record import IdentifiedModel
from deltaid.recording.recording import Recording
from deltaid.view.comparison import compare
from deltaid.view.corrections import left_out_table, put_right_sections
from deltaid.view.drawing import drawing
from deltaid.view.friction import friction_section
from deltaid.view.identification import motion_section, torque_section
from deltaid.view.model_tables import base_table, error_table
from deltaid.view.numbers import measured, percent
from deltaid.view.page import Fact, Page, Section
from deltaid.view.parameters import parameter_section
from deltaid.view.provenance import provenance_section
from deltaid.view.summary import summary, without_doubts
from deltaid.view.torques import over_time


def validation_page(model: ModelLike, recording: Recording, error: TorqueError) -> Page:
    """How well a model predicts a recording, and where the model comes from."""
    model = load(model)
    dynamics, known, log = model.dynamics, model.identified, recording.log
    comparison = compare(dynamics, model.p, recording)
    torques = torque_section(model.robot, comparison, "Torques", front=True)
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
            *(_parameters(known) if known else ()),
            *put_right_sections(model.identified),
            provenance_section(model, "The model"),
        ),
        warnings=(
            *(f"{log.path.name}: {text}" for text in remarks(model, log, error)),
            *(known.warnings if known else ()),
        ),
    )


def _parameters(model: IdentifiedModel) -> tuple[Section, ...]:
    """All parameters, and the base parameters, which models of earlier versions do not hold."""
    parameters = parameter_section(model)
    if not model.base_parameters:
        return (parameters,)
    about = "combinations that the torques determine"
    return parameters, Section("Base parameters", (base_table(model.base_parameters),), about)
