"""The pages of `deltaid simulate` and `deltaid compare-controllers`, with cards and tables."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from deltaid.control.comparison import Comparison, ControllerRun
from deltaid.control.infeasible import MotionProblem
from deltaid.control.simulate import Simulation
from deltaid.control.tracking import Drives, Tracking
from deltaid.grouping import grouped
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.numbers import number, percent
from deltaid.view.page import Fact, Page, Section, Summary, Table, Text, Trust
from deltaid.view.show import Card
from deltaid.view.tracking_figures import (
    NO_MODEL,
    drive_figure,
    drive_length,
    error_bars,
    error_figures,
    model_colour,
    torque_figure,
)

_NO_ROBOT = (
    "no robot with these limits runs this motion, so the comparison ranks no controller; take a "
    "slower or smaller one, such as `deltaid excite` plans"
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

    The page recommends nothing on a motion that the robot cannot run (`problems`), and no run that
    reached a limit or deviated far.
    """
    lines = grouped(
        (run.controller, (run.model or NO_MODEL, model_colour(run.model), run.tracking))
        for run in runs
        if run.tracking is not None
    )
    verdict, best = _verdict(runs, problems)
    return Page(
        title=robot.label,
        subtitle=f"Simulated tracking: {title}",
        facts=(best, *(() if problems else _gains(runs))),
        sections=(
            Section(
                "What identification buys",
                (
                    error_bars(runs),
                    comparison_table(robot, runs),
                    _conditions(drives, bandwidth, conditions),
                ),
            ),
            *(Section(name, error_figures(group)) for name, group in lines.items()),
        ),
        verdict=verdict,
    )


def _verdict(
    runs: Sequence[ControllerRun], problems: Sequence[MotionProblem]
) -> tuple[Summary, Fact]:
    lines, sound = infeasible_lines(problems, runs), _sound(runs)
    if problems:
        why = Fact("no comparison", "not feasible", "the motion is beyond the robot's limits")
        return Summary(Trust.POOR, f"Not feasible: {lines[0]}.", lines[1:]), why
    if not sound:
        why = Fact("no controller", "follows this motion", "each stood at a limit or was far off")
        return Summary(Trust.POOR, "Poor: no controller follows this motion.", lines), why
    run, tracking = min(sound, key=lambda pair: pair[1].error.platform_rms)
    model = {"": NO_MODEL, "base parameters": run.model}.get(run.model, f"the {run.model} model")
    rms, most = _platform_errors(tracking)
    said = f"{run.controller} with {model} follows best, within {rms} (rms; {most} at most)"
    note = f"rms; {run.controller}, {run.model or NO_MODEL}"
    best = Fact("least error of the platform", rms, note)
    return Summary(Trust.GOOD, f"Good: {said}.", lines), best


def _platform_errors(result: Tracking) -> tuple[str, str]:
    """Root mean square and largest distance of the platform from the desired motion."""
    error = result.error
    return f"{1e3 * error.platform_rms:.3g} mm", f"{1e3 * error.platform_max:.3g} mm"


def _sound(runs: Sequence[ControllerRun]) -> list[tuple[ControllerRun, Tracking]]:
    return [
        (run, run.tracking)
        for run in runs
        if run.tracking is not None and run.tracking.ended is None and not run.problems
    ]


def _gains(runs: Sequence[ControllerRun]) -> tuple[Fact, ...]:
    errors = {(run.controller, run.model): x.error.platform_rms for run, x in _sound(runs)}
    facts = []
    for controller in dict.fromkeys(run.controller for run in runs):
        before, now = (errors.get((controller, model)) for model in ("prior", "identified"))
        if before is not None and now is not None:
            note = f"{1e3 * before:.3g} mm with the prior, {1e3 * now:.3g} mm identified"
            times = f"{before / now:.0f}" if before >= 10 * now else f"{before / now:.2g}"
            facts.append(Fact(controller, f"{times} times nearer", note))
    return tuple(facts)


def _conditions(drives: Drives, bandwidth: float, more: Sequence[str]) -> Text:
    step = f"steps of {drives.encoder_step:.3g} rad or m" if drives.encoder_step else "no steps"
    late = f"a delay of {drives.delay} samples" if drives.delay else "no delay"
    if np.isfinite(drives.current_loop):
        late += f", current loops of {drives.current_loop:g} Hz"
    feedback = f"Feedback of {bandwidth:g} Hz, {drives.rate:g} samples a second, encoders with "
    said = [f"{feedback}{step}, {late}", *(f"{text[:1].upper()}{text[1:]}" for text in more)]
    return Text(". ".join(said) + ".")


def drive_table(robot: RobotDescription, result: Tracking) -> Table:
    error, rows = result.error, list[tuple[str, ...]]()
    for i, (drive, units) in enumerate(robot.drive_units.items()):
        length, scale = drive_length(robot, drive)
        off = (f"{number(scale * x[i], 3)} {length}" for x in (error.drive_rms, error.drive_max))
        tau = (f"{number(x[i], 3)} {units.force}" for x in (error.torque_rms, error.torque_max))
        rows.append((drive, *off, *tau, percent(float(error.saturated[i]))))
    columns = ("drive", "error rms", "largest", "effort rms", "largest effort", "at its limit")
    return Table(columns, tuple(rows), title=robot.label)


def comparison_table(robot: RobotDescription, runs: Sequence[ControllerRun]) -> Table:
    """Distance of the platform from the desired motion, by controller and model."""
    rows = []
    for run in runs:
        cells = ["—"] * 5 + [run.why_not]
        if run.tracking is not None:
            error = run.tracking.error
            worst = max((end.error.platform_rms for _, end in run.ends), default=np.nan)
            sizes = [1e3 * x for x in (error.platform_rms, error.platform_max, worst)]
            cells = [number(x, 3) for x in (*sizes, np.rad2deg(error.turn_rms or 0.0))]
            cells += [
                percent(float(error.saturated.max())),
                "; ".join(p.short for p in run.problems),
            ]
        rows.append((run.controller, run.model or NO_MODEL, *cells))
    table = Table(
        ("controller", "model", "rms", "max", "worst load", "turn [°]", "at a limit", "remark"),
        tuple(rows),
        "Rms of distance and turn, also with the worst load; share of time at a torque limit.",
        title=f"{robot.label}: platform error [mm]",
    )  # fmt: skip
    turns = any(run.tracking is not None and run.tracking.turn_error is not None for run in runs)
    needed = {
        "worst load": any(run.ends for run in runs),
        "turn [°]": turns,
        "remark": any(row[-1] for row in rows),
    }
    return table.without(*(name for name, there in needed.items() if not there))


def infeasible_lines(
    problems: Sequence[MotionProblem], runs: Sequence[ControllerRun]
) -> tuple[str, ...]:
    """Why a comparison is invalid or limited: faults of the motion, then of the runs."""
    lines = [*(problem.text for problem in problems), *[_NO_ROBOT] * bool(problems)]
    done = [run for run in runs if run.tracking is not None]
    spoilt = [run for run in done if run.problems]
    every = len(spoilt) == len(done)
    for run in spoilt[-1:] if every else spoilt:
        name = f"{'all controllers; ' * every}{run.controller}, {run.model or NO_MODEL}"
        lines += [f"{name}: {problem.text}" for problem in run.problems]
    return tuple(lines)


def simulation_card(value: Simulation | Comparison) -> Card:
    robot = value.conditions.model.robot
    if isinstance(value, Comparison):
        table, problems = (
            comparison_table(robot, value.runs),
            infeasible_lines(value.problems, value.runs),
        )
        more = ()
    else:
        table, problems = drive_table(robot, value.tracking), tuple(p.text for p in value.problems)
        more = (".error", ".plot()", ".to_frame()")
    return Card(
        f"Simulated tracking: {_title(value)}",
        value.remarks,
        table=table,
        prompt_lines=problems,
        methods=(*more, '.report("x.html")'),
    )


def simulation_figure(value: Simulation) -> go.Figure:
    return error_figures([(_title(value), style.IDENTIFIED, value.tracking)])[0].figure


def simulation_page(value: Simulation | Comparison) -> Page:
    """The page of `deltaid simulate`: one controller on one plant, or one run of a comparison."""
    on, problems, title = value.conditions, value.problems, _title(value)
    if isinstance(value, Comparison):
        return comparison_page(
            on.model.robot, value.runs, title, on.drives, on.bandwidth, problems, value.remarks
        )
    result, robot, error = value.tracking, on.plant.model.robot, value.tracking.error
    rms, most = _platform_errors(result)
    turn = f"{np.rad2deg(error.turn_rms or 0.0):.3g}°"
    said = (
        f"the platform follows within {rms} (rms; {most} at most), and no drive stands at a limit"
    )
    verdict = Summary(Trust.GOOD, f"Good: {said}.")
    if problems:
        first, *others = (problem.text for problem in problems)
        verdict = Summary(Trust.POOR, f"Not feasible: {first}.", tuple(others))
    tracking = (
        *error_figures([(title, style.IDENTIFIED, result)]),
        drive_figure(robot, result),
        _conditions(on.drives, on.bandwidth, value.remarks),
    )
    return Page(
        title=robot.label,
        subtitle=f"Simulated tracking: {title}",
        facts=(
            Fact("platform error", rms, "rms"),
            Fact("largest platform error", most),
            *([] if error.turn_rms is None else [Fact("error of the tool's turn", turn, "rms")]),
            Fact("at a torque limit", percent(float(error.saturated.max())), "of the time"),
        ),
        sections=(
            Section("Tracking", tracking),
            Section("Torques", (torque_figure(robot, result), drive_table(robot, result))),
        ),
        verdict=verdict,
    )


def _title(value: Simulation | Comparison) -> str:
    on = value.conditions
    what = f"{on.model.source} on {on.plant.model.source} along {on.path}"
    return what if isinstance(value, Comparison) else f"{value.controller} with {what}"
