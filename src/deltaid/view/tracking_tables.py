"""Tables of simulated tracking, for the terminal and for a page."""

from collections.abc import Sequence

import numpy as np

from deltaid.control.comparison import Run
from deltaid.control.infeasible import Problem
from deltaid.control.tracking import Tracking
from deltaid.robot.description import RobotDescription
from deltaid.view.numbers import number, percent
from deltaid.view.table import Table

NO_MODEL = "no model"


def drive_table(robot: RobotDescription, result: Tracking) -> Table:
    """Errors and efforts of each drive."""
    error = result.error
    rows = []
    for i, (drive, units) in enumerate(robot.drive_units.items()):
        length, scale = ("mm", 1e3) if robot.is_linear(drive) else ("°", np.rad2deg(1.0))
        rows.append(
            (
                drive,
                f"{number(scale * error.drive_rms[i], 3)} {length}",
                f"{number(scale * error.drive_max[i], 3)} {length}",
                f"{number(error.torque_rms[i], 3)} {units.force}",
                f"{number(error.torque_max[i], 3)} {units.force}",
                percent(float(error.saturated[i])),
            )
        )
    columns = ("drive", "error rms", "largest", "effort rms", "largest effort", "at its limit")
    return Table(columns, tuple(rows), title=robot.title or robot.name)


def comparison_table(robot: RobotDescription, runs: Sequence[Run]) -> Table:
    """Error of the platform for each controller and model."""
    turns = any(run.tracking is not None and run.tracking.turn_error is not None for run in runs)
    ends = any(run.ends for run in runs)
    rows = []
    for run in runs:
        name = (run.controller, run.model or NO_MODEL)
        if run.tracking is None:
            rows.append((*name, "—", "—", *["—"] * (turns + ends), "—", run.why_not))
            continue
        error = run.tracking.error
        remark = "; ".join(problem.short for problem in run.problems)
        numbers = [number(1e3 * error.platform_rms, 3), number(1e3 * error.platform_max, 3)]
        if ends:
            worst = max((end.error.platform_rms for _, end in run.ends), default=np.nan)
            numbers.append(number(1e3 * worst, 3))
        numbers += [number(np.rad2deg(error.turn_rms or 0.0), 3)] * turns
        rows.append((*name, *numbers, percent(float(error.saturated.max())), remark))
    turn = ["turn rms [°]"] * turns
    worst = ["rms, worst load [mm]"] * ends
    columns = (
        "controller",
        "model",
        "rms [mm]",
        "largest [mm]",
        *worst,
        *turn,
        "at a limit",
        "remark",
    )
    title = f"{robot.title or robot.name}: distance of the platform from where it should be"
    return Table(columns, tuple(rows), "Share of time at a torque limit.", title=title)


def infeasible_lines(problems: Sequence[Problem], runs: Sequence[Run]) -> tuple[str, ...]:
    """Why a comparison tells nothing, or less: of the motion itself, then of the runs."""
    lines = [problem.text for problem in problems]
    if lines:
        lines.append(
            "no robot with these limits runs this motion, so the comparison ranks no controller; "
            "take a slower or smaller one, such as `deltaid excite` plans"
        )
    done = [run for run in runs if run.tracking is not None]
    spoilt = [run for run in done if run.problems]
    for run in spoilt if len(spoilt) < len(done) else spoilt[-1:]:
        name = f"{run.controller}, {run.model or NO_MODEL}"
        if len(spoilt) == len(done):
            name = f"all controllers; {name}"
        lines += [f"{name}: {problem.text}" for problem in run.problems]
    return tuple(lines)
