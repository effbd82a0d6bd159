"""`deltaid simulate`: a controller that knows a model, on a robot, along a motion."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import AsJson, Columns, Report, UsePoor, output_file
from deltaid.cli.output import (
    console,
    print_json,
    print_problems,
    print_warnings,
    print_written,
    progress,
    require_outputs,
    used,
)
from deltaid.cli.screen import print_found
from deltaid.control.options import ControllerName
from deltaid.files import together, written_whole

if TYPE_CHECKING:
    from deltaid.control.simulate import Conditions, Simulation
    from deltaid.control.tracking import Tracking
    from deltaid.robot.description import RobotDescription


Trajectory = Annotated[
    Path, typer.Argument(help="Motion to follow: a file of `deltaid excite`, or a recording.")
]
OnPlant = Annotated[
    str | None,
    typer.Option(help="The robot it runs on: another model, robot name or file. Default: MODEL."),
]
Rate = Annotated[float, typer.Option(help="Samples a second of the drives.")]
Bandwidth = Annotated[float, typer.Option(help="Of the feedback, in Hz.")]
Encoder = Annotated[
    float | None,
    typer.Option(help="Encoder step, rad or m; 0 for none. Default: 2⁻²⁰ of a turn.", min=0),
]
Delay = Annotated[int, typer.Option(help="Samples from reading to use.", min=0, max=1000)]
PayloadText = Annotated[
    str | None,
    typer.Option(
        "--payload",
        help="Load at the tool of the robot that is moved, kg: 1.5, or 1.5±0.1 (or 1.5+-0.1).",
        metavar="MASS[±STD]",
    ),
]
PayloadKnown = Annotated[bool, typer.Option("--payload-known", help="The controller knows MASS.")]
CurrentLoop = Annotated[
    float | None,
    typer.Option(help="Bandwidth of the drives' current loop, Hz. Default: torques at once."),
]
ElasticGears = Annotated[
    bool,
    typer.Option("--elastic-gears", help="Gears wind up by the plant's gear_stiffness."),
]

DEFAULT_RATE, DEFAULT_BANDWIDTH = 1000.0, 10.0


def simulate(
    model: Annotated[str, typer.Argument(help="A saved model; or a robot, by name or file.")],
    trajectory: Trajectory,
    controller: Annotated[
        ControllerName,
        typer.Option(help="What the drives' computer does."),
    ] = "computed-torque",
    plant: OnPlant = None,
    rate: Rate = DEFAULT_RATE,
    bandwidth: Bandwidth = DEFAULT_BANDWIDTH,
    encoder: Encoder = None,
    delay: Delay = 0,
    current_loop: CurrentLoop = None,
    payload: PayloadText = None,
    payload_known: PayloadKnown = False,
    elastic_gears: ElasticGears = False,
    columns: Columns = None,
    output: Annotated[
        Path | None, output_file("--output", "-o", help="CSV file for motion and torques.")
    ] = None,
    report: Report = None,
    force: UsePoor = False,
    as_json: AsJson = False,
) -> None:
    """Follow a motion with a controller and a plant.

    The controller knows MODEL; the robot may be another one.

    Friction at rest, torque limits, encoder steps and sampling are simulated. A robot stands for
    its prior. A motion that asks for more than the robot has, or that its controller does not
    follow, is said in red; the exit code stays 0, and --json has it under "infeasible".
    """
    from deltaid.control.simulate import simulate as run
    from deltaid.model.model import load

    inputs = (model, trajectory, plant, columns)
    require_outputs(inputs, {"--output": output, "--report": report})
    with used(load(model), force=force), progress(as_json) as say:
        result = run(
            model, trajectory, controller=controller, plant=plant, rate=rate, bandwidth=bandwidth,
            encoder=encoder, delay=delay, current_loop=current_loop, payload=payload,
            payload_known=payload_known, elastic_gears=elastic_gears, columns=columns, progress=say,
        )  # fmt: skip
        with together():
            if output is not None:
                with written_whole(output) as file:
                    file.write(result.table().write_csv())
            if report is not None:
                say(f"writing {report}")
                result.report(report)
    print_warnings(result.conditions.warnings)
    if as_json:
        print_json(
            {"controller": controller, "model": model, "plant": plant or model}
            | conditions_dictionary(result.conditions)
            | _payload_dictionary(result)
            | error_dictionary(result.tracking)
            | {"infeasible": [asdict(problem) for problem in result.problems]}
        )
    else:
        _print(result.conditions.model.robot, result.tracking)
        for text in result.remarks:
            console.print(text)
        print_written(output, report)
    print_problems([problem.text for problem in result.problems])


def conditions_dictionary(on: "Conditions") -> dict[str, Any]:
    """On what controllers were tried, for JSON."""
    drives = on.drives
    return {
        "bandwidth_hz": on.bandwidth,
        "rate_hz": drives.rate,
        "encoder_step": drives.encoder_step,
        "delay": drives.delay,
        "current_loop_hz": drives.current_loop if math.isfinite(drives.current_loop) else None,
        "elastic_gears": on.plant.elastic,
    }


def _payload_dictionary(result: "Simulation") -> dict[str, Any]:
    """What is held, for JSON, and errors at both ends of what it may be."""
    payload = result.conditions.payload
    if payload is None:
        return {"payload": None}
    ends = [
        {
            "mass": mass,
            "platform_rms": end.error.platform_rms,
            "platform_max": end.error.platform_max,
            "ended": end.ended,
        }
        for mass, end in result.ends
    ]
    return {"payload": asdict(payload) | {"known": result.payload_known, "ends": ends}}


def error_dictionary(result: "Tracking") -> dict[str, Any]:
    """Tracking errors for JSON, SI units."""
    error = result.error
    return {
        "samples": len(result.time),
        "ended": result.ended,
        "platform_rms": error.platform_rms,
        "platform_max": error.platform_max,
        "turn_rms": error.turn_rms,
        "turn_max": error.turn_max,
        "drive_rms": error.drive_rms.tolist(),
        "drive_max": error.drive_max.tolist(),
        "torque_rms": error.torque_rms.tolist(),
        "torque_max": error.torque_max.tolist(),
        "saturated": error.saturated.tolist(),
    }


def _print(robot: "RobotDescription", result: "Tracking") -> None:
    from deltaid.view.tracking import drive_table

    error = result.error
    lines = [
        f"Platform error {1e3 * error.platform_rms:.3g} mm rms, {1e3 * error.platform_max:.3g} mm "
        f"at most, over {result.time[-1]:.4g} s."
    ]
    if error.turn_rms is not None and error.turn_max is not None:
        lines.append(
            f"Error of the tool's turn {1e3 * error.turn_rms:.3g} mrad rms, "
            f"{1e3 * error.turn_max:.3g} mrad at most."
        )
    print_found(lines, [drive_table(robot, result)], full=True)
