"""`deltaid simulate`: a controller that knows a model, on a robot, along a motion."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.conditions import (
    CurrentLoop,
    ElasticGears,
    PayloadKnown,
    PayloadText,
    condition_lines,
    drives_dictionary,
    drives_of,
    payload_dictionary,
    payload_of,
)
from deltaid.cli.options import output_file
from deltaid.control.options import ControllerName

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    import polars as pl

    from deltaid.control.tracking import Tracking
    from deltaid.control.trajectory import SampledTrajectory
    from deltaid.model.model import Model
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
Columns = Annotated[Path | None, typer.Option(help="Which column is what, and its unit (YAML).")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]

DEFAULT_RATE, DEFAULT_BANDWIDTH = 1000.0, 10.0


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("simulate")(simulate)


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
    report: Annotated[
        Path | None, output_file(help="HTML page with figures, works offline.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Follow a motion with a controller that knows MODEL, on a robot that may be another one.

    Friction at rest, torque limits, encoder steps and sampling are simulated. A robot stands for
    its prior. A motion that asks for more than the robot has, or that its controller does not
    follow, is said in red; the exit code stays 0, and --json has it under "infeasible".
    """
    from deltaid.cli.output import (
        console,
        print_json,
        print_origin,
        print_problems,
        print_warnings,
        progress,
        require_outputs,
    )
    from deltaid.control.comparison import gains
    from deltaid.control.control_model import ControlModel
    from deltaid.control.infeasible import of_motion, of_tracking
    from deltaid.control.plant import Plant
    from deltaid.control.tracking import track
    from deltaid.files import together, written_whole
    from deltaid.model.model import load

    drives = drives_of(rate, bandwidth, encoder, delay, current_loop)
    held = payload_of(payload, payload_known)
    require_outputs(given(model, trajectory, plant, columns), {"--output": output}, report)
    subject = load(model)
    print_origin(subject)
    runs_on = load_plant(plant or model, subject.robot)
    moved = Plant(runs_on, elastic=elastic_gears)
    known = ControlModel(subject.robot, subject.p)
    if held is not None:
        moved = moved.carrying(held.mass)
        known = known.holding(held.mass) if payload_known else known
    with progress(as_json) as say, together():
        say(f"checking {trajectory}")
        motion, warnings = load_trajectory(trajectory, subject.robot, columns)
        say("simulating")
        law = gains(controller, known, motion, bandwidth)
        problems = of_motion(moved.at(0.0), motion)
        result = track(moved, law, known, motion, drives)
        problems += of_tracking(runs_on, result)
        ends = [
            (mass, track(moved.carrying(mass), law, known, motion, drives))
            for mass in (held.ends if held else ())
        ]
        conditions = condition_lines(held, payload_known, ends, elastic_gears)
        if output is not None:
            with written_whole(output) as file:
                file.write(as_table(result, sensed(moved.at(0.0), result)).write_csv())
        if report is not None:
            from deltaid.view.page import write_page
            from deltaid.view.tracking import tracking_page

            say(f"writing {report}")
            title = f"{controller} with {Path(model).name} on {Path(plant or model).name}"
            title = f"{title} along {trajectory.name}"
            robot = runs_on.forward.robot
            page = tracking_page(robot, result, title, drives, bandwidth, problems, conditions)
            write_page(page, report)
    print_warnings(warnings)
    if as_json:
        settings = {"controller": controller, "model": model, "plant": plant or model}
        settings |= drives_dictionary(drives, bandwidth)
        settings |= {"elastic_gears": elastic_gears}
        settings |= payload_dictionary(held, payload_known, ends)
        told = {"infeasible": [asdict(problem) for problem in problems]}
        print_json(settings | error_dictionary(result) | told)
    else:
        _print(subject.robot, result)
        for text in conditions:
            console.print(text)
        for path in (output, report):
            if path is not None:
                console.print(f"wrote {path}")
    print_problems([problem.text for problem in problems])


def given(*names: str | Path | None) -> list[Path]:
    """The input files among some arguments."""
    return [Path(name) for name in names if name is not None]


def load_plant(name: str, like: "RobotDescription") -> "Model":
    """The robot that a controller runs on.

    Raises:
        DeltaidError: its drives are not those of the model.
    """
    from deltaid.errors import DeltaidError
    from deltaid.model.model import load

    subject = load(name)
    robot = subject.robot
    kinds = [[r.is_linear(drive) for drive in r.drives] for r in (robot, like)]
    if kinds[0] != kinds[1]:
        words = [f"{k.count(False)} rotary and {k.count(True)} linear drives" for k in kinds]
        raise DeltaidError(
            f"has {words[0]}, but the model's robot has {words[1]}",
            where=f"--plant {name}",
            cure="the plant must be the robot that the model is of",
        )
    return subject


def load_trajectory(
    path: Path, robot: "RobotDescription", columns: Path | None
) -> "tuple[SampledTrajectory, list[str]]":
    """The motion of a file, and warnings about it.

    Raises:
        RecordingError: it cannot be used.
    """
    from deltaid.control.trajectory import open_trajectory
    from deltaid.dynamics.dynamics import compiled
    from deltaid.recording.mapping import load_mapping

    mapping = load_mapping(columns) if columns else None
    motion, log = open_trajectory(path, compiled(robot).kinematics, mapping)
    return motion, [f"{path}: {text}" for text in log.warnings]


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


def sensed(plant: "Model", result: "Tracking") -> "dict[str, np.ndarray]":
    """What the plant's sensors would show, with their noise; nothing of a plant without any.

    Accelerations are differences of velocities, so as they are between the drives' samples.
    """
    if not plant.robot.sensors:
        return {}
    import numpy as np

    from deltaid.dynamics.dynamics import compiled
    from deltaid.sensors.simulated import simulated_sensors

    qdd = np.gradient(result.qd, result.time, axis=0)
    rng = np.random.default_rng(0)
    motion = result.z, result.qd, qdd
    return simulated_sensors(compiled(plant.robot), plant.p, *motion, rng)


def as_table(
    result: "Tracking", sensors: "Mapping[str, np.ndarray] | None" = None
) -> "pl.DataFrame":
    """Motion and torques with the default names of a log, what sensors show, what was desired.

    It ends where the robot was lost, so that it can be read as a log.
    """
    import numpy as np
    import polars as pl

    task = result.task.names
    columns = {"t": result.time}
    for name, values in (
        ("q{}", result.q),
        ("tau{}", result.tau),
        ("q{}_desired", result.q_desired),
    ):
        columns |= {name.format(i + 1): values[:, i] for i in range(values.shape[1])}
    columns |= {name: result.z[:, i] for i, name in enumerate(task)}
    columns |= {f"{name}_desired": result.z_desired[:, i] for i, name in enumerate(task)}
    columns |= sensors or {}
    valid = result.time < (np.inf if result.ended is None else result.ended)
    return pl.DataFrame({name: values[valid] for name, values in columns.items()})


def _print(robot: "RobotDescription", result: "Tracking") -> None:
    from deltaid.cli.output import console, shown
    from deltaid.view.tracking import drive_table

    error = result.error
    console.print(shown(drive_table(robot, result)))
    console.print()
    console.print(
        f"platform {1e3 * error.platform_rms:.3g} mm rms and {1e3 * error.platform_max:.3g} mm at "
        f"most from where it should be, over {result.time[-1]:.4g} s"
    )
    if error.turn_rms is not None and error.turn_max is not None:
        console.print(
            f"tool {1e3 * error.turn_rms:.3g} mrad rms and {1e3 * error.turn_max:.3g} mrad at "
            "most from the turn it should have"
        )
