"""`deltaid validate`: how well a model predicts a recording."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import KeepAll, output_file

if TYPE_CHECKING:
    from deltaid.identification.torque_error import TorqueError
    from deltaid.model.model import Model
    from deltaid.recording.log import Log


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("validate")(validate)


def validate(
    model: Annotated[
        str, typer.Argument(help="A saved model; or a robot, by name or file, for its prior.")
    ],
    log: Annotated[Path, typer.Argument(help="A recording, in any kind of file; or its factors.")],
    columns: Annotated[
        Path | None, typer.Option(help="Which column is what, and its unit (YAML).")
    ] = None,
    report: Annotated[
        Path | None, output_file(help="HTML page with figures of the comparison, works offline.")
    ] = None,
    keep_all: KeepAll = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare a model's torques with a recording, drive by drive."""
    from deltaid.cli.gathered import are_factor_files, require_open, validated
    from deltaid.cli.output import (
        console,
        print_json,
        print_origin,
        print_verdict,
        print_warnings,
        progress,
        require_report,
        shown,
    )
    from deltaid.identification.sources import left_out, model_filtered
    from deltaid.identification.validation import remarks
    from deltaid.identification.validation import validate as run
    from deltaid.model.model import load
    from deltaid.recording.mapping import load_mapping
    from deltaid.view.corrections import left_out_table
    from deltaid.view.model_tables import error_table
    from deltaid.view.summary import summary

    if report is not None:
        require_report(report, [Path(model), log, *([columns] if columns else [])])
    from_factors = are_factor_files([log])
    if from_factors:
        require_open({"--columns": columns is not None, "--keep-all": keep_all}, report)
    mapping = load_mapping(columns) if columns else None
    known = load(model)
    print_origin(known)
    with progress(as_json) as say:
        say(f"comparing with {log}")
        if from_factors:
            error, seen = validated(known, log)
            about: dict[str, Any] = {"log": seen.log, "sha256": seen.sha256}
            missing = seen.model.sources[0].left_out
        else:
            error, seen = run(known, log, columns=mapping, keep_all=keep_all)
            clock = asdict(model_filtered(known, seen).clock)
            about = {"log": log.name, "sha256": seen.sha256, "clock": clock}
            missing = left_out(seen, known.robot.drives, error)
            if report is not None:
                say(f"writing {report}")
                write_report(known, seen, error, report)
    print_warnings([f"{log}: {text}" for text in remarks(known, seen, error)])
    if as_json:
        told = {"left_out": [one.model_dump() for one in missing]}
        print_json(about | error_dictionary(error) | told)
    else:
        console.print(shown(error_table(known, error)))
        if (table := left_out_table([(log.name, missing)])) is not None:
            console.print(shown(table))
        print_verdict(summary(known, error, seen).text)
        if report is not None:
            console.print(f"wrote {report}")


def write_report(model: "Model", log: "Log", error: "TorqueError", path: Path) -> None:
    """The page of a comparison."""
    from deltaid.identification.validation import Validation
    from deltaid.view.html import write_page
    from deltaid.view.model_pages import validation_page

    write_page(validation_page(Validation(error, log, model)), path)


def error_dictionary(error: "TorqueError") -> dict[str, Any]:
    """Torque errors for JSON."""
    return {
        "rms": error.rms.tolist(),
        "nrmse": error.nrmse.tolist(),
        "rms_unfiltered": error.rms_unfiltered.tolist(),
        "cutoff_hz": error.cutoff,
    }
