"""`deltaid compare-controllers`: every controller with every model of a robot, on one plant."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.conditions import (
    CurrentLoop,
    ElasticGears,
    PayloadText,
    drives_dictionary,
    drives_of,
    payload_dictionary,
    payload_of,
)
from deltaid.cli.options import output_file
from deltaid.cli.simulate import (
    DEFAULT_BANDWIDTH,
    DEFAULT_RATE,
    AsJson,
    Bandwidth,
    Columns,
    Delay,
    Encoder,
    Rate,
    Trajectory,
)

if TYPE_CHECKING:
    from deltaid.control.comparison import Run
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
    from deltaid.cli.simulate import given, load_plant, load_trajectory
    from deltaid.control.comparison import candidates, compare
    from deltaid.control.infeasible import of_motion
    from deltaid.control.plant import Plant
    from deltaid.model.model import load
    from deltaid.view.tracking import infeasible_lines

    drives = drives_of(rate, bandwidth, encoder, delay, current_loop)
    held = payload_of(payload, known=False)
    if report is not None:
        require_report(report, given(model, trajectory, plant, columns))
    known = load(model)
    print_origin(known)
    runs_on = load_plant(plant, known.robot)
    moved = Plant(runs_on, elastic=elastic_gears)
    with progress(as_json) as say:
        say(f"checking {trajectory}")
        motion, warnings = load_trajectory(trajectory, known.robot, columns)
        problems = of_motion(moved.carrying(held.mass).at(0.0) if held else runs_on, motion)
        runs = compare(moved, candidates(known), motion, drives, bandwidth, say, held)
        if report is not None:
            from deltaid.view.page import write_page
            from deltaid.view.tracking import comparison_page

            say(f"writing {report}")
            names = f"{Path(model).name} on {Path(plant).name} along {trajectory.name}"
            said = ["gears wind up, with the encoders on the motors"] * elastic_gears
            said += [f"the robot holds a load of {held.mass:.4g} kg"] if held else []
            page = comparison_page(known.robot, runs, names, drives, bandwidth, problems, said)
            write_page(page, report)
    print_warnings(warnings)
    if as_json:
        settings = {"model": str(model), "plant": plant} | drives_dictionary(drives, bandwidth)
        settings |= {"elastic_gears": elastic_gears} | payload_dictionary(held, False, ())
        told = {"infeasible": [asdict(problem) for problem in problems]}
        print_json(settings | told | {"runs": [_as_dictionary(run) for run in runs]})
    else:
        _print(known.robot, runs, report)
    print_problems(infeasible_lines(problems, runs))


def _as_dictionary(run: "Run") -> dict[str, Any]:
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


def _print(robot: "RobotDescription", runs: "tuple[Run, ...]", report: Path | None) -> None:
    from deltaid.cli.output import console, shown
    from deltaid.view.tracking import comparison_table

    console.print(shown(comparison_table(robot, runs)))
    if report is not None:
        console.print(f"wrote {report}")
