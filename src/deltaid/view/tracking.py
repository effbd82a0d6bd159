"""The pages of `deltaid simulate` and `deltaid compare-controllers`, and their tables."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
import polars as pl

from deltaid.control.comparison import ControllerRun
from deltaid.control.infeasible import MotionProblem
from deltaid.control.simulate import Comparison, Simulation
from deltaid.control.tracking import Drives, Tracking
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.numbers import number, percent
from deltaid.view.page import Fact, Page, Section, Summary, Table, Text, Trust
from deltaid.view.show import Card
from deltaid.view.tracking_figures import (
    COLOURS,
    NO_MODEL,
    drive_figure,
    error_bars,
    error_figures,
    torque_figure,
)


def comparison_page(
    robot: RobotDescription,
    runs: Sequence[ControllerRun],
    title: str,
    drives: Drives,
    bandwidth: float,
    problems: Sequence[MotionProblem] = (),
    conditions: Sequence[str] = (),
) -> Page:
    """All controllers with all models on one plant; bandwidth in Hz.

    Nothing is praised on a motion that the robot cannot run (`problems`), and no run that stood at
    a limit or was far off.
    """
    done = [(run, run.tracking) for run in runs if run.tracking is not None]
    return Page(
        title=robot.title or robot.name,
        subtitle=f"Simulated tracking: {title}",
        facts=(_best(runs, problems), *(() if problems else _gains(runs))),
        sections=(
            Section(
                "What identification buys",
                (
                    error_bars(runs),
                    comparison_table(robot, runs),
                    _conditions(drives, bandwidth, conditions),
                ),
            ),
            *[
                Section(
                    controller,
                    error_figures(
                        [
                            (run.model or NO_MODEL, COLOURS[run.model], tracking)
                            for run, tracking in done
                            if run.controller == controller
                        ]
                    ),
                )
                for controller in dict.fromkeys(run.controller for run, _ in done)
            ],
        ),
        verdict=_compared(runs, problems),
    )


def _compared(runs: Sequence[ControllerRun], problems: Sequence[MotionProblem]) -> Summary:
    lines = infeasible_lines(problems, runs)
    if problems:
        return Summary(Trust.POOR, f"Not feasible: {lines[0]}.", lines[1:])
    sound = _sound(runs)
    if not sound:
        return Summary(Trust.POOR, "Poor: no controller follows this motion.", lines)
    run, tracking = min(sound, key=lambda pair: pair[1].error.platform_rms)
    model = {"": NO_MODEL, "base parameters": run.model}.get(run.model, f"the {run.model} model")
    error = tracking.error
    return Summary(
        Trust.GOOD,
        f"Good: {run.controller} with {model} follows best, within "
        f"{1e3 * error.platform_rms:.3g} mm (rms; {1e3 * error.platform_max:.3g} mm at most).",
        lines,
    )


def _best(runs: Sequence[ControllerRun], problems: Sequence[MotionProblem]) -> Fact:
    if problems:
        return Fact("no comparison", "not feasible", "the motion is beyond the robot's limits")
    sound = [(run, tracking.error) for run, tracking in _sound(runs)]
    if not sound:
        return Fact("no controller", "follows this motion", "each stood at a limit or was far off")
    run, error = min(sound, key=lambda pair: pair[1].platform_rms)
    note = f"rms; {run.controller}, {run.model or NO_MODEL}"
    return Fact("least error of the platform", f"{1e3 * error.platform_rms:.3g} mm", note)


def _sound(runs: Sequence[ControllerRun]) -> list[tuple[ControllerRun, Tracking]]:
    """Runs that followed the motion, within the limits."""
    done = [(run, run.tracking) for run in runs if run.tracking is not None]
    return [(run, result) for run, result in done if result.ended is None and not run.problems]


def _gains(runs: Sequence[ControllerRun]) -> tuple[Fact, ...]:
    by_name = {(run.controller, run.model): tracking for run, tracking in _sound(runs)}
    facts = []
    for controller in dict.fromkeys(run.controller for run in runs):
        prior, after = (by_name.get((controller, m)) for m in ("prior", "identified"))
        if prior is not None and after is not None:
            before, now = prior.error.platform_rms, after.error.platform_rms
            note = f"{1e3 * before:.3g} mm with the prior, {1e3 * now:.3g} mm identified"
            times = f"{before / now:.0f}" if before >= 10 * now else f"{before / now:.2g}"
            facts.append(Fact(controller, f"{times} times nearer", note))
    return tuple(facts)


def _conditions(drives: Drives, bandwidth: float, more: Sequence[str]) -> Text:
    step = f"steps of {drives.encoder_step:.3g} rad or m" if drives.encoder_step else "no steps"
    late = f"a delay of {drives.delay} samples" if drives.delay else "no delay"
    loop = (
        f", current loops of {drives.current_loop:g} Hz" if np.isfinite(drives.current_loop) else ""
    )
    feedback = (
        f"Feedback of {bandwidth:g} Hz, {drives.rate:g} samples a second, encoders with {step}, "
        f"{late}{loop}"
    )
    return Text(". ".join([feedback, *(f"{text[:1].upper()}{text[1:]}" for text in more)]) + ".")


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


def comparison_table(robot: RobotDescription, runs: Sequence[ControllerRun]) -> Table:
    """Distance of the platform from where it should be, by controller and model."""
    turns = any(run.tracking is not None and run.tracking.turn_error is not None for run in runs)
    ends = any(run.ends for run in runs)
    rows = []
    for run in runs:
        name = (run.controller, run.model or NO_MODEL)
        if run.tracking is None:
            rows.append((*name, "—", "—", *["—"] * (turns + ends), "—", run.why_not))
            continue
        error = run.tracking.error
        numbers = [number(1e3 * error.platform_rms, 3), number(1e3 * error.platform_max, 3)]
        if ends:
            worst = max((end.error.platform_rms for _, end in run.ends), default=np.nan)
            numbers.append(number(1e3 * worst, 3))
        numbers += [number(np.rad2deg(error.turn_rms or 0.0), 3)] * turns
        rows.append(
            (
                *name,
                *numbers,
                percent(float(error.saturated.max())),
                "; ".join(p.short for p in run.problems),
            )
        )
    columns = (
        "controller",
        "model",
        "rms [mm]",
        "max [mm]",
        *["rms, worst load [mm]"] * ends,
        *["turn rms [°]"] * turns,
        "at a limit",
        "remark",
    )
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    title = f"{robot.title or robot.name}: platform error"
    return Table(columns, tuple(rows), "Share of time at a torque limit.", title=title)


def infeasible_lines(
    problems: Sequence[MotionProblem], runs: Sequence[ControllerRun]
) -> tuple[str, ...]:
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


def simulation_card(value: Simulation | Comparison) -> Card:
    """The errors, and what is not feasible."""
    robot, title = value.conditions.model.robot, f"Simulated tracking: {_title(value)}"
    if isinstance(value, Comparison):
        return Card(
            title,
            value.remarks,
            table=comparison_table(robot, value.runs),
            told=infeasible_lines(value.problems, value.runs),
            methods=('.report("x.html")',),
        )
    return Card(
        title,
        value.remarks,
        table=drive_table(robot, value.tracking),
        told=tuple(problem.text for problem in value.problems),
        methods=(".error", ".plot()", ".to_frame()", '.report("x.html")'),
    )


def simulation_frame(value: Simulation) -> pl.DataFrame:
    """Motion and torques over time, as a log."""
    return value.table()


def simulation_figure(value: Simulation) -> go.Figure:
    """Error of the platform over time."""
    return error_figures([(_title(value), style.IDENTIFIED, value.tracking)])[0].figure


def simulation_page(value: Simulation | Comparison) -> Page:
    """The page of `deltaid simulate`: one controller on one plant; of a comparison that of it."""
    on, problems = value.conditions, value.problems
    if isinstance(value, Comparison):
        rest = _title(value), on.drives, on.bandwidth, problems, value.remarks
        return comparison_page(on.model.robot, value.runs, *rest)
    result, robot, title = value.tracking, on.plant.model.robot, _title(value)
    error = result.error
    facts = [
        Fact("platform error", f"{1e3 * error.platform_rms:.3g} mm", "rms"),
        Fact("largest platform error", f"{1e3 * error.platform_max:.3g} mm"),
    ]
    if error.turn_rms is not None:
        facts.append(Fact("error of the tool's turn", f"{np.rad2deg(error.turn_rms):.3g}°", "rms"))
    facts.append(Fact("at a torque limit", percent(float(error.saturated.max())), "of the time"))
    verdict = Summary(
        Trust.GOOD,
        f"Good: the platform follows within {1e3 * error.platform_rms:.3g} mm (rms; "
        f"{1e3 * error.platform_max:.3g} mm at most), and no drive stands at a limit.",
    )
    if problems:
        first, *others = (problem.text for problem in problems)
        verdict = Summary(Trust.POOR, f"Not feasible: {first}.", tuple(others))
    return Page(
        title=robot.title or robot.name,
        subtitle=f"Simulated tracking: {title}",
        facts=tuple(facts),
        sections=(
            Section(
                "Tracking",
                (
                    *error_figures([(title, style.IDENTIFIED, result)]),
                    drive_figure(robot, result),
                    _conditions(on.drives, on.bandwidth, value.remarks),
                ),
            ),
            Section("Torques", (torque_figure(robot, result), drive_table(robot, result))),
        ),
        verdict=verdict,
    )


def _title(value: Simulation | Comparison) -> str:
    on = value.conditions
    what = f"{on.model.source} on {on.plant.model.source} along {on.path}"
    return what if isinstance(value, Comparison) else f"{value.controller} with {what}"
