"""`deltaid forces`: what struts, joints and bearings carry along a motion."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import AsJson, Full, ModelOrRobot, Report, UsePoor, output_file
from deltaid.cli.output import (
    print_json,
    print_warnings,
    print_written,
    progress,
    require_outputs,
    used,
)
from deltaid.cli.screen import print_found
from deltaid.files import together

if TYPE_CHECKING:
    from deltaid.joint_forces.forces import ForceFinding, Forces


def forces(
    model: ModelOrRobot,
    motion: Annotated[
        Path, typer.Argument(help="A planned motion or a recording, in any kind of file.")
    ],
    logs: Annotated[
        list[Path] | None,
        typer.Option(help="A recording the model comes from, for ranges; may be repeated."),
    ] = None,
    output: Annotated[
        Path | None, output_file("--output", "-o", help="CSV file with all forces over time.")
    ] = None,
    strut_spacing: Annotated[
        float | None, typer.Option(help="Distance of a limb's struts, m, if not described.")
    ] = None,
    socket_force: Annotated[
        float | None, typer.Option(help="Spring force at each ball, N, if not described.")
    ] = None,
    columns: Annotated[
        Path | None, typer.Option(help="Which column of MOTION is what, and its unit (YAML).")
    ] = None,
    log_columns: Annotated[
        list[Path] | None,
        typer.Option(help="The same for the recordings of --logs; repeated, one each."),
    ] = None,
    report: Report = None,
    force: UsePoor = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Compute joint and strut forces along a motion.

    Worst cases, margins of ball joints, and what is known of them.

    Some forces depend on parameters that no torque shows. With --logs the least and largest value
    that agrees with the recordings is found, else how far the prior leaves a force open.
    """
    from deltaid.joint_forces.forces import forces as run
    from deltaid.model.model import load
    from deltaid.view.forces import tables, verdict, what_is_open

    inputs = (model, motion, *(logs or ()), columns, *(log_columns or ()))
    require_outputs(inputs, {"--output": output, "--report": report})
    with used(load(model), force=force), progress(as_json) as say:
        result = run(
            model, motion, logs=logs or (), strut_spacing=strut_spacing, socket_force=socket_force,
            columns=columns, log_columns=log_columns, progress=say,
        )  # fmt: skip
        with together():
            if output is not None:
                result.save(output)
            if report is not None:
                result.report(report)
    print_warnings(result.warnings)
    if as_json:
        print_json(as_dictionary(result))
        return
    print_found([verdict(result).sentence, what_is_open(result)], tables(result), full=full)
    print_written(output, report)


def as_dictionary(result: "Forces") -> dict[str, Any]:
    """The result as one JSON object."""
    computed, extremes = result.constraint_forces, result.extremes
    return {
        "robot": computed.robot.name,
        "motion": result.recording.path.name,
        "struts": list(computed.struts),
        "note": computed.note or None,
        "socket_force": computed.socket_force,
        "worst": [_finding(finding, computed.socket_force) for finding in result.findings],
        "extremes": {
            channel: {"unit": unit, "least": float(least), "largest": float(largest)}
            for channel, unit, least, largest in zip(
                extremes.names, extremes.units, *extremes.values, strict=True
            )
        },
    }


def _finding(finding: "ForceFinding", socket_force: float | None) -> dict[str, Any]:
    worst, known = finding.worst, finding.range
    margin = worst.value + socket_force if worst.kind == "socket" and socket_force else None
    return {
        "part": worst.part,
        "kind": worst.kind,
        "channel": worst.channel,
        "unit": worst.unit,
        "value": worst.value,
        "margin": margin,
        "time": worst.at.time,
        "z": worst.at.z.tolist(),
        "low": known.low if known else None,
        "high": known.high if known else None,
        "open": finding.openness.half_width,
        "open_entries": list(finding.openness.unknowns),
    }
