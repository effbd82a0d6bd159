"""`deltaid validate`: how well a model predicts a recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from deltaid.identification.model import IdentifiedModel
    from deltaid.identification.torque_error import TorqueError
    from deltaid.recording.log import Log


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("validate")(validate)


def validate(
    model: Annotated[Path, typer.Argument(help="A model saved by `deltaid identify`.")],
    log: Annotated[Path, typer.Argument(help="A recording, CSV or Parquet.")],
    columns: Annotated[
        Path | None, typer.Option(help="Which column is what, and its unit (YAML).")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="HTML page with figures of the comparison, works offline.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare a model's torques with a recording, drive by drive."""
    from deltaid.cli.output import console, print_json, print_warnings, progress, require_report
    from deltaid.identification.model import IdentifiedModel
    from deltaid.identification.validation import misfit
    from deltaid.identification.validation import validate as run
    from deltaid.recording.columns import load_mapping

    if report is not None:
        require_report(report, [model, log, *([columns] if columns else [])])
    mapping = load_mapping(columns) if columns else None
    identified = IdentifiedModel.load(model)
    with progress(as_json) as say:
        say(f"comparing with {log}")
        error, surveyed = run(identified, log, columns=mapping)
        if report is not None:
            say(f"writing {report}")
            write_report(identified, surveyed, error, report)
    texts = (*surveyed.warnings, *misfit(identified, error))
    print_warnings([f"{log}: {text}" for text in texts])
    if as_json:
        print_json({"log": log.name, "sha256": surveyed.sha256} | error_dictionary(error))
    else:
        console.print(error_table(identified, error))
        if report is not None:
            console.print(f"wrote {report}")


def write_report(model: "IdentifiedModel", log: "Log", error: "TorqueError", path: Path) -> None:
    """The page of a comparison."""
    from deltaid.identification.validation import model_filter
    from deltaid.report.page import write_page
    from deltaid.report.validation import validation_page

    write_page(validation_page(model, log, model_filter(model, log), error), path)


def error_dictionary(error: "TorqueError") -> dict:
    """Torque errors for JSON."""
    return {
        "rms": error.rms.tolist(),
        "nrmse": error.nrmse.tolist(),
        "rms_unfiltered": error.rms_unfiltered.tolist(),
        "cutoff_hz": error.cutoff,
    }


def error_table(model: "IdentifiedModel", verification: "TorqueError | None") -> object:
    """Torque errors per drive, on the identification's recordings and on another one."""
    from deltaid.cli.output import number, percent, table

    fit, rows, units = model.fit, [], model.robot.drive_units
    alike, first = len(set(units.values())) == 1, next(iter(units.values()))
    heading = [f"{first.effort} error, {first.force}"] if alike else ["error of drive", "unit"]
    for i, drive in enumerate(model.robot.drives):
        row = [
            drive,
            *([] if alike else [units[drive].force]),
            number(fit.rms[i], 3),
            percent(fit.nrmse[i]),
            number(fit.rms_unfiltered[i], 3),
        ]
        if verification is not None:
            row += [
                number(verification.rms[i], 3),
                percent(verification.nrmse[i]),
                number(verification.rms_unfiltered[i], 3),
            ]
        rows.append(row)
    columns = [*heading, "rms", "share", "unfiltered"]
    if verification is not None:
        columns += ["verify rms", "share", "unfiltered"]
    return table("", columns, rows)
