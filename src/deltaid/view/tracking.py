"""The pages of `deltaid simulate` and `deltaid compare-controllers`, with tables and figures:
errors of platform and drives, torques, controllers side by side."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
import polars as pl
from jaxtyping import Float

from deltaid.control.comparison import Comparison, ControllerRun
from deltaid.control.infeasible import MotionProblem
from deltaid.control.simulate import Simulation
from deltaid.control.tracking import Drives, Tracking
from deltaid.dynamics.limits import effort_limits
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.comparison import POINTS, peak_rows
from deltaid.view.numbers import number, percent
from deltaid.view.page import Fact, Figure, Page, Section, Summary, Table, Text, Trust
from deltaid.view.show import Card

NO_MODEL = "no model"
# Colours by name of the model; other names are models with a known load.
_COLOURS = {
    "": style.LIMIT,
    "prior": style.PRIOR,
    "base parameters": style.MEASURED,
    "identified": style.IDENTIFIED,
}

_NO_ROBOT = (
    "no robot with these limits runs this motion, so the comparison ranks no controller; take a "
    "slower or smaller one, such as `deltaid excite` plans"
)

Signal = Float[np.ndarray, " samples"]


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
    lines = dict[str, list[tuple[str, str, Tracking]]]()
    for run in runs:
        if run.tracking is not None:
            lines.setdefault(run.controller, []).append(
                (run.model or NO_MODEL, _COLOURS.get(run.model, style.RESIDUAL), run.tracking)
            )
    verdict, best = _verdict(runs, problems)
    return Page(
        title=robot.title or robot.name,
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
    rms, most = (
        f"{1e3 * x:.3g} mm" for x in (tracking.error.platform_rms, tracking.error.platform_max)
    )
    said = f"{run.controller} with {model} follows best, within {rms} (rms; {most} at most)"
    note = f"rms; {run.controller}, {run.model or NO_MODEL}"
    best = Fact("least error of the platform", rms, note)
    return Summary(Trust.GOOD, f"Good: {said}.", lines), best


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
        length, scale = shown_length(robot, drive)
        off = (f"{number(scale * x[i], 3)} {length}" for x in (error.drive_rms, error.drive_max))
        tau = (f"{number(x[i], 3)} {units.force}" for x in (error.torque_rms, error.torque_max))
        rows.append((drive, *off, *tau, percent(float(error.saturated[i]))))
    columns = ("drive", "error rms", "largest", "effort rms", "largest effort", "at its limit")
    return Table(columns, tuple(rows), title=robot.title or robot.name)


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
        title=f"{robot.title or robot.name}: platform error [mm]",
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
        told=problems,
        methods=(*more, '.report("x.html")'),
    )


def simulation_frame(value: Simulation) -> pl.DataFrame:
    return value.table()


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
    rms, most = (f"{1e3 * x:.3g} mm" for x in (error.platform_rms, error.platform_max))
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
        title=robot.title or robot.name,
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


def error_bars(runs: Sequence[ControllerRun]) -> Figure:
    axis = {"type": "log", "title": "platform error, rms [mm]", "dtick": 1}
    layout = {"yaxis": axis, "barmode": "group", "height": 420, "bargap": 0.25}
    figure, models = go.Figure(layout=layout), dict[str, dict[str, float]]()
    for run in runs:
        errors = models.setdefault(run.model, {})
        if run.tracking is not None:
            errors[run.controller] = 1e3 * run.tracking.error.platform_rms
    for model, errors in models.items():
        figure.add_bar(
            x=list(errors),
            y=list(errors.values()),
            name=model or NO_MODEL,
            marker={"color": _COLOURS.get(model, style.RESIDUAL), "line": {"width": 0}},
            text=[f"{x:.2g}" if x < 99.5 else f"{x:.0f}" for x in errors.values()],
            textposition="outside",
            cliponaxis=False,
            hovertemplate="%{x}, " + (model or NO_MODEL) + ": %{y:.3g} mm<extra></extra>",
        )
    return Figure(
        figure,
        "Distance of the platform point from where it should be, root mean square, with a "
        "logarithmic scale. All have the same tuning, so what differs is what they know of the "
        "robot.",
    )


def error_figures(runs: Sequence[tuple[str, str, Tracking]]) -> tuple[Figure, ...]:
    """Distance of the platform from the desired motion, and error of the tool's turn, over time."""
    platform = [(name, color, run.time, 1e3 * run.platform_error) for name, color, run in runs]
    turns = [
        (name, color, run.time, np.rad2deg(run.turn_error))
        for name, color, run in runs
        if run.turn_error is not None
    ]
    where = "Distance of the platform point from where it should be."
    turned = "Turn ψ of the tool, actual less desired."
    return (
        _over_time(platform, "platform error", "mm", where),
        *([_over_time(turns, "error of the turn", "°", turned)] if turns else []),
    )


def _over_time(
    lines: Sequence[tuple[str, str, Signal, Signal]], what: str, unit: str, caption: str
) -> Figure:
    axis = {"title": f"{what} [{unit}]", "rangemode": "tozero"}
    figure = go.Figure(layout={"xaxis": {"title": "time [s]"}, "yaxis": axis, "height": 340})
    for name, color, time, error in lines:
        figure.add_scatter(
            **_peaks(time, error),
            name=style.label(name),
            mode="lines",
            line={"color": color, "width": 1.3},
            showlegend=len(lines) > 1,
            hovertemplate=f"%{{y:.3g}} {unit} at %{{x:.4g}} s<extra></extra>",
        )
    return Figure(figure, caption)


def shown_length(robot: RobotDescription, drive: str) -> tuple[str, float]:
    """Displayed unit of a drive's errors, and its number in a rad or m."""
    return ("mm", 1e3) if robot.is_linear(drive) else ("°", np.rad2deg(1.0))


def drive_figure(robot: RobotDescription, result: Tracking) -> Figure:
    """Position error q − q_d of each drive."""
    units = [shown_length(robot, drive) for drive in robot.drives]
    figure = _stack(robot, [unit for unit, _ in units])
    for i, (drive, (unit, scale)) in enumerate(zip(robot.drives, units, strict=True)):
        error, hover = scale * result.drive_error[:, i], f"{drive} %{{y:.3g}} {unit}"
        _line(figure, i, result.time, error, style.RESIDUAL, hover)
    return Figure(figure, "Error of each drive, actual less desired coordinate.")


def torque_figure(robot: RobotDescription, result: Tracking) -> Figure:
    """Applied torques, with the drives' limits if they come close."""
    units = [robot.units(drive).force for drive in robot.drives]
    figure, line = _stack(robot, units), {"color": style.LIMIT, "dash": "dot", "width": 1}
    for i, limit in enumerate(effort_limits(robot)):
        tau, hover = result.tau[:, i], f"{robot.drives[i]} %{{y:.4g}} {units[i]}"
        _line(figure, i, result.time, tau, style.MEASURED, hover)
        if np.nanmax(np.abs(tau)) > 0.5 * limit:
            for edge in (-limit, limit):
                figure.add_hline(y=edge, line=line, row=i + 1, col=1)  # pyright: ignore[reportArgumentType]
    return Figure(figure, "Torques of the drives. Dotted: limits of the plant, if near.")


def _stack(robot: RobotDescription, units: Sequence[str]) -> go.Figure:
    titles = [f"{drive} [{unit}]" for drive, unit in zip(robot.drives, units, strict=True)]
    return style.stacked(titles, height=170 * len(titles) + 80, spacing=0.12 / len(titles))


def _line(figure: go.Figure, i: int, time: Signal, values: Signal, color: str, hover: str) -> None:
    figure.add_scatter(
        **_peaks(time, values),
        mode="lines",
        showlegend=False,
        line={"color": color, "width": 1.2},
        hovertemplate=hover + " at %{x:.4g} s<extra></extra>",
        row=i + 1,
        col=1,
    )


def _peaks(time: Signal, values: Signal) -> dict[str, Float[np.ndarray, " shown"]]:
    """At most `POINTS` samples: the largest in magnitude of each stretch."""
    rows = peak_rows(np.abs(values), POINTS)
    return {"x": time[rows].astype(np.float32), "y": values[rows].astype(np.float32)}
