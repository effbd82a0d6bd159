"""`deltaid compare-controllers`: every controller with every model of a robot, on one plant."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import AsJson, Columns, ModelOrRobot, Report, UsePoor
from deltaid.cli.output import (
    console,
    print_json,
    print_problems,
    print_warnings,
    print_written,
    progress,
    require_outputs,
    shown,
    used,
)
from deltaid.cli.simulate import (
    DEFAULT_BANDWIDTH,
    DEFAULT_RATE,
    Bandwidth,
    CurrentLoop,
    Delay,
    ElasticGears,
    Encoder,
    PayloadText,
    Rate,
    Trajectory,
    conditions_dictionary,
    error_dictionary,
)

if TYPE_CHECKING:
    from deltaid.control.comparison import ControllerRun


def compare_controllers(
    model: ModelOrRobot,
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
    report: Report = None,
    force: UsePoor = False,
    as_json: AsJson = False,
) -> None:
    """Compare tracking: prior, base values, full model.

    Every controller runs with every model on the plant, all tuned alike: what differs is what they
    know of the robot. With --payload, the identified model runs a second time with its mass known,
    and all runs again two standard deviations off. Runs at a limit, lost, or far from the motion
    are marked in the table, and none of them is called best; the exit code stays 0.
    """
    from deltaid.control.simulate import compare_controllers as run
    from deltaid.model.model import load
    from deltaid.view.tracking import comparison_table, infeasible_lines

    require_outputs((model, trajectory, plant, columns), {"--report": report})
    with used(load(model), force=force), progress(as_json) as say:
        result = run(
            model, trajectory, plant=plant, rate=rate, bandwidth=bandwidth, encoder=encoder,
            delay=delay, current_loop=current_loop, payload=payload, elastic_gears=elastic_gears,
            columns=columns, progress=say,
        )  # fmt: skip
        if report is not None:
            say(f"writing {report}")
            result.report(report)
    on = result.conditions
    print_warnings(on.warnings)
    if as_json:
        held = asdict(on.payload) | {"known": False, "ends": []} if on.payload else None
        print_json(
            {"model": model, "plant": plant}
            | conditions_dictionary(on)
            | {"payload": held}
            | {"infeasible": [asdict(problem) for problem in result.problems]}
            | {"runs": [_as_dictionary(run) for run in result.runs]}
        )
    else:
        console.print(shown(comparison_table(on.model.robot, result.runs)))
        print_written(report)
    print_problems(infeasible_lines(result.problems, result.runs))


def _as_dictionary(run: "ControllerRun") -> dict[str, Any]:
    value: dict[str, Any] = {
        "controller": run.controller,
        "model": run.model or None,
        "why_not": run.why_not or None,
    }
    if run.tracking is not None:
        value |= error_dictionary(run.tracking)
        value["infeasible"] = [asdict(problem) for problem in run.problems]
    if run.ends:
        value["ends"] = [
            {"mass": mass, "platform_rms": end.error.platform_rms} for mass, end in run.ends
        ]
    return value
