"""`deltaid forces`: what struts, joints and bearings carry along a motion."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import mappings, output_file

if TYPE_CHECKING:
    from deltaid.joint_forces.constraint_forces import ConstraintForces
    from deltaid.joint_forces.study import Viewer
    from deltaid.model.model import Model


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("forces")(forces)


def forces(
    model: Annotated[
        str, typer.Argument(help="A saved model; or a robot, by name or file, for its prior.")
    ],
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
    report: Annotated[
        Path | None, output_file(help="HTML page with figures and tables, works offline.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Constraint forces along a motion: worst cases, margins of ball joints, and what is known.

    Some forces depend on parameters that no torque shows. With --logs the least and largest value
    that agrees with the recordings is found, else how far the prior leaves a force open.
    """
    from deltaid.cli.output import (
        console,
        print_json,
        print_origin,
        print_warnings,
        progress,
        require_outputs,
    )
    from deltaid.errors import positive
    from deltaid.files import together
    from deltaid.identification.sources import model_filtered
    from deltaid.joint_forces.constraint_forces import ConstraintForces
    from deltaid.joint_forces.ranges import left_aside
    from deltaid.joint_forces.study import study, with_struts
    from deltaid.model.model import load
    from deltaid.recording.mapping import load_mapping
    from deltaid.recording.opening import open_log

    positive("--strut-spacing", strut_spacing, (1e-6, 100.0))
    positive("--socket-force", socket_force, (1e-6, 1e7))
    inputs = [
        path for path in (Path(model), motion, *(logs or ()), columns, *(log_columns or ())) if path
    ]
    require_outputs(inputs, {"--output": output}, report)
    mapping = load_mapping(columns) if columns else None
    known = with_struts(load(model), strut_spacing, socket_force)
    print_origin(known)
    computed = ConstraintForces(known.robot)
    with progress(as_json) as say, together(), ExitStack() as files:
        say(f"checking {motion}")
        surveyed = open_log(motion, computed.kinematics, mapping, need_torque=False)
        viewers = _viewers(computed, surveyed.samples, output, report, files)
        recording = model_filtered(known, surveyed)
        result = study(
            known,
            computed,
            recording,
            recordings=tuple(logs or ()),
            columns=mappings(log_columns),
            viewers=tuple(viewers),
            progress=say,
        )
        if report is not None:
            _write_report(known, computed, motion.name, result, viewers, report)
    print_warnings([f"{motion}: {text}" for text in recording.log.warnings])
    print_warnings([computed.note] if computed.note else [])
    print_warnings(left_aside(known) if logs else ())
    if recording.log.columns.loads:
        print_warnings([f"{motion}: forces are those without the loads that its mapping declares"])
    if as_json:
        print_json(as_dictionary(computed, motion.name, result))
        return
    print_tables(computed, result)
    for path in (output, report):
        if path is not None:
            console.print(f"wrote {path}")


def _viewers(
    computed: "ConstraintForces",
    samples: int,
    output: Path | None,
    report: Path | None,
    files: ExitStack,
) -> "list[Viewer]":
    """What sees all forces on their way: a CSV file, the figure of a report."""
    from deltaid.files import written_whole
    from deltaid.joint_forces.study import CsvFile

    found: list[Viewer] = []
    if output is not None:
        found.append(CsvFile(computed, files.enter_context(written_whole(output))))
    if report is not None:
        from deltaid.view.forces import Envelope

        found.append(Envelope(computed, samples))
    return found


def _write_report(
    model: "Model",
    computed: "ConstraintForces",
    name: str,
    result: "Study",
    viewers: "list[Viewer]",
    path: Path,
) -> None:
    from deltaid.view.forces import Envelope, forces_page
    from deltaid.view.page import write_page

    envelope = next(viewer for viewer in viewers if isinstance(viewer, Envelope))
    write_page(forces_page(model, computed, name, result, envelope), path)


def print_tables(computed: "ConstraintForces", result: "Study") -> None:
    """Worst cases as tables, and a sentence on what is known of them."""
    from deltaid.cli.output import console, shown
    from deltaid.view.forces import tables, what_is_open

    for each in tables(result, computed.socket_force):
        console.print(shown(each))
        console.print()
    console.print(what_is_open(result))


def as_dictionary(computed: "ConstraintForces", name: str, result: "Study") -> dict[str, Any]:
    """The result as one JSON object."""
    found = result.extremes
    return {
        "robot": computed.robot.name,
        "motion": name,
        "struts": list(computed.struts),
        "note": computed.note or None,
        "socket_force": computed.socket_force,
        "worst": [_finding(finding, computed.socket_force) for finding in result.findings],
        "extremes": {
            channel: {
                "unit": found.units[k],
                "least": float(found.values[0, k]),
                "largest": float(found.values[1, k]),
            }
            for k, channel in enumerate(found.names)
        },
    }


def _finding(finding: "Finding", socket_force: float | None) -> dict[str, Any]:
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
