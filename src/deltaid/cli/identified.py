"""What `deltaid identify` shows of its result: tables and sentences, JSON, a page."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deltaid.identification.identify import Identification
    from deltaid.identification.torque_error import TorqueError
    from deltaid.identification.validation import Compared
    from deltaid.model.sources import Source
    from deltaid.recording.log import Log

# Events that the terminal lists.
_EVENTS = 20


def write_report(
    result: "Identification", log: "Log | None", error: "TorqueError | None", path: Path
) -> None:
    """The page of a result, with a recording that it has been verified on."""
    from deltaid.identification.validation import Validation
    from deltaid.model.model import load
    from deltaid.view.html import write_page
    from deltaid.view.model_pages import identification_page

    verification = None
    if log is not None and error is not None:
        verification = Validation(error, log, load(result.model))
    write_page(identification_page(result, verification), path)


def as_dictionary(
    result: "Identification", verification: "TorqueError | None", log: "Compared | None" = None
) -> dict[str, Any]:
    """The result as one JSON object; `log` is the recording of the verification."""
    from deltaid.cli.validate import error_dictionary
    from deltaid.view.summary import summary as verdict

    model, layout = result.model, result.model.layout
    value = {
        "robot": model.robot.name,
        "summary": asdict(verdict(result, verification, log)),
        "method": model.settings.method,
        "regularizer": model.settings.regularizer,
        "intervals": model.settings.intervals,
        **model.fit.model_dump(),
        "samples": round(result.problem.information.mean_samples),
        "cutoff_hz": [source.cutoff_hz for source in model.sources],
        "corrections": [one.model_dump() for one in model.corrections],
        "loads": [one.model_dump() for one in model.loads],
        "sensors": [one.model_dump() for one in model.sensors],
        "left_out": [
            {"log": source.log, **one.model_dump()}
            for source in model.sources
            for one in source.left_out
        ],
        "events": [
            {"log": source.log, **one.model_dump()}
            for source in model.sources
            for one in source.events
        ],
        "clock": [{"log": one.path.name, **asdict(one.clock)} for one in result.recordings],
        "friction": {
            "joints": list(model.robot.friction_joints),
            "viscous": model.p[layout.viscous].tolist(),
            "coulomb": model.p[layout.coulomb].tolist(),
            "laws": {
                joint: law.model_dump(exclude_none=True)
                for joint, law in model.robot.friction.items()
            },
            "choice": model.friction_choice and model.friction_choice.model_dump(),
            "curves": [one.model_dump() for one in model.friction_curves],
        },
        "consistent": model.consistent,
        "parameters": [parameter.model_dump() for parameter in model.parameters],
        "base_values": [parameter.model_dump() for parameter in model.base_parameters],
        "warnings": list(model.warnings),
    }
    if verification is not None:
        value["verify"] = error_dictionary(verification)
    return value


def print_result(
    result: "Identification",
    verification: "TorqueError | None",
    output: Path | None,
    log: "Compared | None" = None,
) -> None:
    """The result as tables, and the verdict at their end; `log` was verified on."""
    from deltaid.cli.output import console, print_verdict, shown
    from deltaid.model.model import load
    from deltaid.view.corrections import put_right_tables
    from deltaid.view.model_tables import (
        choice_sentence,
        choice_table,
        error_table,
        parameter_table,
    )
    from deltaid.view.summary import summary as verdict

    model = result.model
    console.print(shown(parameter_table(model)))
    console.print()
    console.print(shown(error_table(load(model), verification)))
    console.print()
    if model.friction_choice is not None and model.friction_choice.steps:
        console.print(shown(choice_table(model.friction_choice, model.robot)))
        console.print(choice_sentence(model.friction_choice))
        console.print()
    for table in put_right_tables(model, _EVENTS):
        console.print(shown(table))
        console.print()
    for line in summary(result):
        console.print(line)
    print_verdict(verdict(result, verification, log).text)
    if output is not None:
        console.print(f"saved {output}")


def _of_positions(source: "Source") -> str:
    """Their cut-off, where it is another one."""
    if source.motion_cutoff_hz is None or source.motion_cutoff_hz == source.cutoff_hz:
        return ""
    return f", positions at {source.motion_cutoff_hz:.3g} Hz"


def summary(result: "Identification") -> list[str]:
    """Sentences about the fit: filter, optimum, rank, consistency."""
    from deltaid.estimation.posing import SOLVERS
    from deltaid.recording.repairs import WHY_REPAIRED
    from deltaid.view.corrections import reversals
    from deltaid.view.parameters import shares_sentence

    fit, model = result.model.fit, result.model
    lines = []
    for source in model.sources:
        filtered = (
            f"zero-phase low-pass at {source.cutoff_hz:.3g} Hz{_of_positions(source)}, thinned to "
            f"{source.used_samples}"
            if source.cutoff_hz
            else "not filtered"
        )
        lines.append(
            f"{source.log}: {source.samples} samples at {source.rate_hz:.6g} Hz, {filtered}"
            f"{reversals(source.left_out)}"
        )
    if fit.duality_gap is None:
        certificate = "no certificate: this regulariser is not convex"
    elif SOLVERS[model.settings.method].certifies:
        certificate = f"global optimum, duality gap {fit.duality_gap:.1e}"
    else:
        share = fit.duality_gap / fit.objective
        certificate = f"{fit.duality_gap:.1e} ({100 * share:.2g} %) above the certified optimum"
    if any(one.reason in WHY_REPAIRED for source in model.sources for one in source.left_out):
        certificate += ", of the rows that events have left"
    lines += [
        f"objective {fit.objective:.4e}, {certificate}; γ = {fit.gamma:.2e}",
        f"{fit.optimization_variables} free parameters, {fit.base_parameters} base parameters, "
        f"condition {fit.base_condition:.0f}; torque noise {100 * fit.noise_level:.2g} % of the "
        "largest torque",
        shares_sentence(model),
        "all bodies physically consistent",
    ]
    return [line for line in lines if line]
