"""`deltaid compare-controllers`: every controller with every model of a robot, on one plant."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import output_file
from deltaid.cli.simulate import (
    DEFAULT_BANDWIDTH,
    DEFAULT_RATE,
    AsJson,
    Bandwidth,
    Columns,
    CurrentLoop,
    Delay,
    ElasticGears,
    Encoder,
    PayloadText,
    Rate,
    Trajectory,
)

if TYPE_CHECKING:
    from deltaid.control.comparison import ControllerRun
    from deltaid.robot.description import RobotDescription


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("compare-controllers")(compare_controllers)


def compare_controllers(
    model: Annotated[
        str, typer.Argument(help="A saved model; or a robot, by name or file, for its prior.")
    ],
    trajectory: Trajectory,
    plant: Annotated[str, typer.Option(help="The true robot: another model, robot name or file.")],
    rate: Rate = DEFAULT_RATE,
    bandwidth: Bandwidth = DEFAULT_BANDWIDTH,
    encoder: Encoder = None,
    delay: Delay = 0,
    current_loop: CurrentLoop = None,
    payload: PayloadText = None,
    elastic_gears: ElasticGears = False,
    columns: Columns = None,
    report: Annotated[
        Path | None, output_file(help="HTML page with figures, works offline.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare tracking with the prior, the base parameters and the identified model.

    Every controller runs with every model on the plant, all tuned alike: what differs is what they
    know of the robot. With --payload, the identified model runs a second time with its mass known,
    and all runs again two standard deviations off. Runs at a limit, lost, or far from the motion
    are marked in the table, and none of them is called best; the exit code stays 0.
    """
    from deltaid.cli.output import (
        print_json,
        print_origin,
        print_problems,
        print_warnings,
        progress,
        require_report,
    )
    from deltaid.cli.simulate import conditions_dictionary, given
    from deltaid.control.simulate import compare_controllers as run
    from deltaid.view.tracking import infeasible_lines

    if report is not None:
        require_report(report, given(model, trajectory, plant, columns))
    with progress(as_json) as say:
        result = run(
            model, trajectory, plant=plant, rate=rate, bandwidth=bandwidth, encoder=encoder,
            delay=delay, current_loop=current_loop, payload=payload, elastic_gears=elastic_gears,
            columns=columns, progress=say,
        )  # fmt: skip
        if report is not None:
            say(f"writing {report}")
            result.report(report)
    on = result.conditions
    print_origin(on.model)
    print_warnings(on.warnings)
    if as_json:
        held = asdict(on.payload) | {"known": False, "ends": []} if on.payload else None
        settings = {"model": model, "plant": plant} | conditions_dictionary(on) | {"payload": held}
        infeasible = {"infeasible": [asdict(problem) for problem in result.problems]}
        runs = {"runs": [_as_dictionary(run) for run in result.runs]}
        print_json(settings | infeasible | runs)
    else:
        _print(on.model.robot, result.runs, report)
    print_problems(infeasible_lines(result.problems, result.runs))


def _as_dictionary(run: "ControllerRun") -> dict[str, Any]:
    from deltaid.cli.simulate import error_dictionary

    head = {
        "controller": run.controller,
        "model": run.model or None,
        "why_not": run.why_not or None,
    }
    if run.tracking is None:
        return head
    told: dict[str, Any] = {"infeasible": [asdict(problem) for problem in run.problems]}
    if run.ends:
        told["ends"] = [
            {"mass": mass, "platform_rms": end.error.platform_rms} for mass, end in run.ends
        ]
    return head | error_dictionary(run.tracking) | told


def _print(
    robot: "RobotDescription", runs: "tuple[ControllerRun, ...]", report: Path | None
) -> None:
    from deltaid.cli.output import console, shown
    from deltaid.view.tracking import comparison_table

    console.print(shown(comparison_table(robot, runs)))
    if report is not None:
        console.print(f"wrote {report}")
