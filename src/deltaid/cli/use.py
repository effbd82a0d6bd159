"""`deltaid torque`, `forces` and `sample`: applications of a model."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import deltaid
from deltaid.cli.options import (
    CSV,
    AsJson,
    Columns,
    Full,
    ModelOrRobot,
    MotionColumns,
    Report,
    UsePoor,
    bounded,
    output_file,
    require_outputs,
)
from deltaid.cli.output import (
    console,
    print_outcome,
    progress,
    remark,
    used,
    write_files,
)
from deltaid.errors import DeltaidError
from deltaid.files import require_new_folder, require_writable
from deltaid.model.options import SAMPLES_LIMITS, TOLERANCE_LIMITS

Form = Literal["npz", "mjcf"]


def torque(
    model: ModelOrRobot,
    log: Annotated[
        Path, typer.Argument(help="Recording or planned motion, in any supported format.")
    ],
    output: Annotated[Path, output_file("--output", "-o", help="CSV file to write.", endings=CSV)],
    columns: Columns = None,
    periodic: Annotated[
        bool,
        typer.Option("--periodic", help="Treat the motion as one period of a repeated motion."),
    ] = False,
    force: UsePoor = False,
) -> None:
    """Compute the drive torques that a model predicts.

    The columns are t, tau1, tau2, … in s and N m (N).

    If the identification estimated gains of the drives, these are the torques to command; all other
    numbers of a model are torques at the joints. A motion without velocities and accelerations is
    filtered and differentiated. If it rests at its ends, or is --periodic, every row has torques;
    otherwise rows within the filter's length of an end have none.
    """
    require_outputs((model, log, columns), {"--output": output})
    known = deltaid.load(model)
    with used(known, force=force), progress(False) as say:
        result = deltaid.torque(known, log, columns=columns, periodic=periodic, progress=say)
        remark("warning", *result.warnings)
        say(f"predicting torques along {log}")
        result.save(output)
    cutoff = result.recording.motion_cutoff
    filtered = f", positions low-passed at {cutoff:.3g} Hz" if cutoff else ""
    samples = result.recording.log.samples
    console.print(f"wrote {result.rows} of {samples} samples to {output}{filtered}")


def forces(
    model: ModelOrRobot,
    motion: Annotated[
        Path, typer.Argument(help="Planned motion or recording, in any supported format.")
    ],
    logs: Annotated[
        list[Path] | None,
        typer.Option(
            help="Recording that the model was fitted to, for narrower intervals. Repeatable."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        output_file(
            "--output", "-o", help="CSV file to write, with all forces over time.", endings=CSV
        ),
    ] = None,
    strut_spacing: Annotated[
        float | None,
        typer.Option(help="Distance of a limb's struts, m, if the description lacks it."),
    ] = None,
    socket_force: Annotated[
        float | None,
        typer.Option(help="Spring force at each ball joint, N, if the description lacks it."),
    ] = None,
    columns: MotionColumns = None,
    log_columns: Annotated[
        list[Path] | None,
        typer.Option(
            help="Mapping file of the recordings of --logs. Repeatable: one for all, or one each."
        ),
    ] = None,
    report: Report = None,
    force: UsePoor = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Compute joint and strut forces along a motion.

    The command prints worst cases, margins of ball joints, and the uncertainty of forces.

    Some forces depend on parameters that torques do not determine. With --logs, the command
    computes the smallest and largest force that agree with the recordings; otherwise how far the
    prior leaves a force open.
    """
    from deltaid.view.forces import tables, verdict, what_is_open

    require_outputs(
        (model, motion, *(logs or ()), columns, *(log_columns or ())),
        {"--output": output, "--report": report},
    )
    with used(deltaid.load(model), force=force), progress(as_json) as say:
        result = deltaid.forces(
            model, motion, logs=logs or (), strut_spacing=strut_spacing, socket_force=socket_force,
            columns=columns, log_columns=log_columns, progress=say,
        )  # fmt: skip
        write_files((output, result.save), (report, result.report))
    remark("warning", *result.warnings)
    computed, extremes = result.constraint_forces, result.extremes
    print_outcome(
        as_json,
        {
            "robot": computed.robot.name,
            "motion": result.recording.path.name,
            "struts": list(computed.struts),
            "note": computed.note or None,
            "socket_force": computed.socket_force,
            "worst": _findings(result),
            "extremes": {
                channel: {"unit": unit, "least": least, "largest": largest}
                for channel, unit, least, largest in zip(
                    extremes.names, extremes.units, *extremes.values, strict=True
                )
            },
        },
        [verdict(result).sentence, what_is_open(result)],
        tables(result),
        full=full,
        files=(output, report),
    )


def _findings(result: "deltaid.Forces") -> list[dict[str, Any]]:
    """Worst case of each part, for JSON; sockets with the residual force of their springs."""
    held = result.constraint_forces.socket_force
    return [
        {
            "part": worst.part,
            "kind": worst.kind,
            "channel": worst.channel,
            "unit": worst.unit,
            "value": worst.value,
            "margin": worst.value + held if worst.kind == "socket" and held else None,
            "time": worst.at.time,
            "z": worst.at.z,
            "low": finding.range.low if finding.range else None,
            "high": finding.range.high if finding.range else None,
            "open": finding.openness.half_width,
            "open_entries": list(finding.openness.unknowns),
        }
        for finding in result.findings
        for worst in [finding.worst]
    ]


def sample(
    model: Annotated[str, typer.Argument(help="Model file of `deltaid identify`.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="File (.npz) or new folder (mjcf) to write.", metavar="PATH"
        ),
    ],
    n: Annotated[
        int, bounded("-n", "--number", help="Number of models.", limits=SAMPLES_LIMITS)
    ] = 1000,
    seed: Annotated[
        int, bounded(help="Seed; the same seed gives the same models.", limits=(0.0, 2.0**63))
    ] = 0,
    to: Annotated[
        Form,
        typer.Option(help="Format: npz, all parameters in one file; or mjcf, one file per model."),
    ] = "npz",
    limb_tolerance: Annotated[
        float,
        bounded(
            help="Standard deviation of masses between limbs, as a share.",
            limits=TOLERANCE_LIMITS,
        ),
    ] = 0.0,
    force: UsePoor = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Draw consistent models from the posterior.

    The samples follow data, prior and physical consistency together.

    docs/posterior.md describes their use: Monte Carlo of any result of a model, and domain
    randomisation that agrees with the recordings.
    """
    from deltaid.view.models import sample_sentence, sample_table

    if to == "npz" and output.suffix.lower() != ".npz":
        raise DeltaidError("must end in .npz for --to npz", where=str(output))
    if to == "npz":
        require_writable(output, [Path(model)])
    else:
        require_new_folder(output)
    known = deltaid.load(model)
    with used(known, force=force), progress(as_json) as say:
        say("drawing models")
        drawn = known.sample(n, seed, limb_tolerance)
        say(f"writing {output}")
        written = drawn.save(output) if to == "npz" else drawn.mjcf(output)
    print_outcome(
        as_json,
        {
            "robot": drawn.robot.name,
            "models": len(drawn),
            "seed": drawn.seed,
            "limb_tolerance": drawn.limb_tolerance,
            "effective_size": drawn.ess.min(),
            "rhat": drawn.rhat.max(),
            "output": str(written),
            "parameters": [
                {
                    "name": name,
                    "unit": unit,
                    "mean": column.mean(),
                    "std": column.std(),
                    "effective_size": size,
                    "rhat": factor,
                }
                for name, unit, column, size, factor in zip(
                    drawn.names, drawn.units, drawn.p.T, drawn.ess, drawn.rhat, strict=True
                )
            ],
        },
        [sample_sentence(drawn)],
        [sample_table(drawn)],
        full=full,
        files=(written,),
    )
