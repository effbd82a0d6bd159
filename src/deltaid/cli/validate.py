"""`deltaid validate`: how well a model predicts a recording."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import deltaid
from deltaid.cli.gather import are_factor_files, compared, require_open
from deltaid.cli.options import AsJson, Columns, Full, KeepAll, ModelOrRobot, Report
from deltaid.cli.output import print_found, print_json, print_origin, print_warnings, progress
from deltaid.cli.output_files import print_written, require_outputs, write_files

if TYPE_CHECKING:
    from deltaid.identification.torque_error import TorqueError


def validate(
    model: ModelOrRobot,
    log: Annotated[Path, typer.Argument(help="A recording, in any kind of file; or its factors.")],
    columns: Columns = None,
    report: Report = None,
    keep_all: KeepAll = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Compare a model's torques with a recording."""
    from deltaid.identification.prediction import remarks
    from deltaid.identification.sources import left_out, model_filtered
    from deltaid.view.corrections import left_out_table
    from deltaid.view.model_tables import error_table
    from deltaid.view.summary import summary

    require_outputs((model, log, columns), {"--report": report})
    if are_factor_files([log]):
        require_open({"--columns": columns is not None, "--keep-all": keep_all}, report)
    known = deltaid.load(model)
    with progress(as_json) as say:
        say(f"comparing with {log}")
        comparison = compared(known, log, columns, keep_all)
        error, seen = comparison
        if isinstance(comparison, deltaid.Validation):
            about: dict[str, Any] = {"log": log.name, "sha256": comparison.log.sha256}
            about["clock"] = asdict(model_filtered(known, comparison.log).clock)
            missing = left_out(comparison.log, known.robot.drives, error)
            write_files((report, comparison.report))
        else:
            _, record = comparison
            about = {"log": record.log, "sha256": record.sha256}
            missing = record.model.sources[0].left_out
    print_origin(known)
    print_warnings([f"{log}: {text}" for text in remarks(known, seen, error)])
    if as_json:
        spans = [span.model_dump() for span in missing]
        print_json(about | error_dictionary(error) | {"left_out": spans})
    else:
        said, excluded = summary(known, error, seen), left_out_table([(log.name, missing)])
        print_found(
            [said.sentence, *said.lines],
            [error_table(known, error)],
            [excluded] if excluded is not None else [],
            full=full,
        )
        print_written(report)


def error_dictionary(error: "TorqueError") -> dict[str, Any]:
    """Torque errors for JSON."""
    return {
        "rms": error.rms.tolist(),
        "nrmse": error.nrmse.tolist(),
        "rms_unfiltered": error.rms_unfiltered.tolist(),
        "cutoff_hz": error.cutoff,
    }
