"""`deltaid simulate` and `compare-controllers`: controllers with a model, on a plant, along a
motion."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import deltaid
from deltaid.cli.options import (
    CSV,
    AsJson,
    Columns,
    ModelOrRobot,
    Report,
    UsePoor,
    output_file,
    require_outputs,
)
from deltaid.cli.output import (
    console,
    print_found,
    print_json,
    print_written,
    progress,
    remark,
    table,
    used,
    write_files,
)
from deltaid.control.options import ControllerName, ControlSettings
from deltaid.files import write_csv

if TYPE_CHECKING:
    from deltaid.control.tracking import Tracking

Trajectory = Annotated[
    Path, typer.Argument(help="Motion to follow: a file of `deltaid excite`, or a recording.")
]
OnPlant = Annotated[
    str | None,
    typer.Option(
        help="Simulated robot: a model, a catalogue name or a robot file. Default: MODEL."
    ),
]
Rate = Annotated[float, typer.Option(help="Sampling rate of the drives, Hz.")]
Bandwidth = Annotated[float, typer.Option(help="Bandwidth of the feedback, Hz.")]
Encoder = Annotated[
    float | None,
    typer.Option(help="Encoder step, rad or m; 0 for none. Default: 2⁻²⁰ of a turn.", min=0),
]
Delay = Annotated[
    int, typer.Option(help="Delay from measurement to command, in samples.", min=0, max=1000)
]
PayloadText = Annotated[
    str | None,
    typer.Option(
        "--payload",
        help="Load at the tool of the simulated robot, kg: 1.5, 1.5±0.1 or 1.5+-0.1.",
        metavar="MASS[±STD]",
    ),
]
PayloadKnown = Annotated[
    bool, typer.Option("--payload-known", help="Let the controller know the mass of --payload.")
]
CurrentLoop = Annotated[
    float | None,
    typer.Option(help="Bandwidth of the drives' current loop, Hz. Default: ideal."),
]
ElasticGears = Annotated[
    bool,
    typer.Option(
        "--elastic-gears", help="Simulate compliant gears with the robot's gear_stiffness."
    ),
]

_USUAL = ControlSettings()


def simulate(
    model: Annotated[str, typer.Argument(help="Saved model, catalogue name or robot file.")],
    trajectory: Trajectory,
    controller: Annotated[
        ControllerName,
        typer.Option(help="Control law."),
    ] = "computed-torque",
    plant: OnPlant = None,
    rate: Rate = _USUAL.rate,
    bandwidth: Bandwidth = _USUAL.bandwidth,
    encoder: Encoder = None,
    delay: Delay = 0,
    current_loop: CurrentLoop = None,
    payload: PayloadText = None,
    payload_known: PayloadKnown = False,
    elastic_gears: ElasticGears = False,
    columns: Columns = None,
    output: Annotated[
        Path | None,
        output_file(
            "--output", "-o", help="CSV file to write, with motion and torques.", endings=CSV
        ),
    ] = None,
    report: Report = None,
    force: UsePoor = False,
    as_json: AsJson = False,
) -> None:
    """Simulate a controller that follows a motion.

    The controller uses MODEL; the simulated robot may differ from it.

    The simulation includes friction at rest, torque limits, encoder steps and sampling. A robot
    without identified parameters has those of its prior. If the motion exceeds what the robot can
    do, or the controller does not follow it, the command prints this in red; the exit code stays 0,
    and --json has it under "infeasible".
    """
    from deltaid.view.tracking import drive_table

    require_outputs((model, trajectory, plant, columns), {"--output": output, "--report": report})
    with used(deltaid.load(model), force=force), progress(as_json) as say:
        result = deltaid.simulate(
            model, trajectory, controller=controller, plant=plant, payload_known=payload_known,
            columns=columns, progress=say, settings=ControlSettings(
                rate, bandwidth, encoder, delay, current_loop, payload, elastic_gears
            ),
        )  # fmt: skip
        write_files(
            (output, lambda path: write_csv(path, [result.table()])),
            (report, result.report),
        )
    on, error = result.conditions, result.tracking.error
    remark("warning", *on.warnings)
    if as_json:
        ends = [
            {
                "mass": mass,
                "platform_rms": end.error.platform_rms,
                "platform_max": end.error.platform_max,
                "ended": end.ended,
            }
            for mass, end in result.ends
        ]
        print_json(
            {"controller": controller, "model": model, "plant": plant or model}
            | _on_what(result, known=result.payload_known, ends=ends)
            | _errors(result.tracking)
            | {"infeasible": [asdict(problem) for problem in result.problems]}
        )
    else:
        lines = [
            f"Platform error {1e3 * error.platform_rms:.3g} mm rms, "
            f"{1e3 * error.platform_max:.3g} mm at most, over {result.tracking.time[-1]:.4g} s."
        ]
        if error.turn_rms is not None and error.turn_max is not None:
            lines.append(
                f"Error of the tool's turn {1e3 * error.turn_rms:.3g} mrad rms, "
                f"{1e3 * error.turn_max:.3g} mrad at most."
            )
        print_found(lines, [drive_table(on.model.robot, result.tracking)], full=True)
        for text in result.remarks:
            console.print(text)
        print_written(output, report)
    remark("not feasible", *(problem.text for problem in result.problems))


def compare_controllers(
    model: ModelOrRobot,
    trajectory: Trajectory,
    plant: Annotated[
        str, typer.Option(help="Simulated robot: a model, a catalogue name or a robot file.")
    ],
    rate: Rate = _USUAL.rate,
    bandwidth: Bandwidth = _USUAL.bandwidth,
    encoder: Encoder = None,
    delay: Delay = 0,
    current_loop: CurrentLoop = None,
    payload: PayloadText = None,
    elastic_gears: ElasticGears = False,
    columns: Columns = None,
    report: Report = None,
    force: UsePoor = False,
    as_json: AsJson = False,
) -> None:
    """Compare tracking: prior, base values, full model.

    Every controller runs with every model on the simulated robot. All are tuned alike, so only the
    models differ. With --payload, the identified model also runs with known mass, and all runs are
    repeated with loads two standard deviations off. The table marks runs at a limit, lost, or far
    from the motion, and calls none of them best. The exit code stays 0.
    """
    from deltaid.view.tracking import comparison_table, infeasible_lines

    require_outputs((model, trajectory, plant, columns), {"--report": report})
    with used(deltaid.load(model), force=force), progress(as_json) as say:
        result = deltaid.compare_controllers(
            model, trajectory, plant=plant, columns=columns, progress=say, settings=ControlSettings(
                rate, bandwidth, encoder, delay, current_loop, payload, elastic_gears
            ),
        )  # fmt: skip
        write_files((report, result.report))
    on = result.conditions
    remark("warning", *on.warnings)
    if as_json:
        print_json(
            {"model": model, "plant": plant}
            | _on_what(result, known=False, ends=[])
            | {"infeasible": [asdict(problem) for problem in result.problems]}
            | {
                "runs": [
                    {
                        "controller": run.controller,
                        "model": run.model or None,
                        "why_not": run.why_not or None,
                    }
                    | (_errors(run.tracking) if run.tracking else {})
                    | ({"infeasible": list(map(asdict, run.problems))} if run.tracking else {})
                    | (
                        {
                            "ends": [
                                {"mass": mass, "platform_rms": end.error.platform_rms}
                                for mass, end in run.ends
                            ]
                        }
                        if run.ends
                        else {}
                    )
                    for run in result.runs
                ]
            }
        )
    else:
        console.print(table(comparison_table(on.model.robot, result.runs)))
        print_written(report)
    remark("not feasible", *infeasible_lines(result.problems, result.runs))


def _on_what(result: "deltaid.Simulation | deltaid.Comparison", **held: object) -> dict[str, Any]:
    on, drives = result.conditions, result.conditions.drives
    return {
        "bandwidth_hz": on.bandwidth,
        "rate_hz": drives.rate,
        "encoder_step": drives.encoder_step,
        "delay": drives.delay,
        "current_loop_hz": drives.current_loop if math.isfinite(drives.current_loop) else None,
        "elastic_gears": on.plant.elastic,
        "payload": asdict(on.payload) | held if on.payload else None,
    }


def _errors(result: "Tracking") -> dict[str, Any]:
    return {"samples": len(result.time), "ended": result.ended} | asdict(result.error)
