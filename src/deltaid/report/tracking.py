"""The pages of `deltaid simulate` and `deltaid compare-controllers`."""

from collections.abc import Callable, Sequence

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float
from plotly.subplots import make_subplots

from deltaid.control.comparison import Run
from deltaid.control.infeasible import Problem
from deltaid.control.tracking import Drives, Tracking
from deltaid.dynamics.limits import effort_limits
from deltaid.report import style
from deltaid.report.numbers import percent
from deltaid.report.page import Fact, Figure, Page, Section, Text
from deltaid.report.summary import Grade, Summary
from deltaid.report.tracking_tables import (
    NO_MODEL,
    comparison_table,
    drive_table,
    infeasible_lines,
)
from deltaid.robot.description import RobotDescription

# Points a line is drawn with.
_POINTS = 4000
_MODELS = {
    "": style.LIMIT,
    "prior": style.PRIOR,
    "base parameters": style.MEASURED,
    "identified": style.IDENTIFIED,
}

Signal = Float[np.ndarray, " samples"]
Points = Float[np.ndarray, " points"]


def tracking_page(
    robot: RobotDescription,
    result: Tracking,
    title: str,
    drives: Drives,
    bandwidth: float,
    problems: Sequence[Problem] = (),
    conditions: Sequence[str] = (),
) -> Page:
    """One controller on one plant, which is `robot`; bandwidth in Hz.

    Args:
        conditions: what else holds of the plant and of what the controller knows, in words.
    """
    own = [(title, style.IDENTIFIED, result)]
    return Page(
        title=robot.title or robot.name,
        subtitle=f"Simulated tracking: {title}",
        facts=_facts(result),
        sections=(
            Section(
                "Tracking",
                (*_errors(own), _drives(robot, result), _conditions(drives, bandwidth, conditions)),
            ),
            Section("Torques", (_torques(robot, result), drive_table(robot, result))),
        ),
        verdict=_followed(result, problems),
    )


def comparison_page(
    robot: RobotDescription,
    runs: Sequence[Run],
    title: str,
    drives: Drives,
    bandwidth: float,
    problems: Sequence[Problem] = (),
    conditions: Sequence[str] = (),
) -> Page:
    """All controllers with all models on one plant; bandwidth in Hz.

    Nothing is praised on a motion that the robot cannot run (`problems`), and no run that stood at
    a limit or was far off.
    """
    done = [(run, run.tracking) for run in runs if run.tracking is not None]
    lines = [
        Section(controller, _errors(_of_controller(controller, done)))
        for controller in dict.fromkeys(run.controller for run, _ in done)
    ]
    return Page(
        title=robot.title or robot.name,
        subtitle=f"Simulated tracking: {title}",
        facts=(_best(runs, problems), *(() if problems else _gains(runs))),
        sections=(
            Section(
                "What identification buys",
                (
                    _bars(runs),
                    comparison_table(robot, runs),
                    _conditions(drives, bandwidth, conditions),
                ),
            ),
            *lines,
        ),
        verdict=_compared(runs, problems),
    )


def _followed(result: Tracking, problems: Sequence[Problem]) -> Summary:
    """Whether a simulated motion can be run, and how well it was followed."""
    if problems:
        first, *others = (problem.text for problem in problems)
        return Summary(Grade.POOR, f"Not feasible: {first}.", tuple(others))
    error = result.error
    return Summary(
        Grade.GOOD,
        f"Good: the platform follows within {1e3 * error.platform_rms:.3g} mm (rms; "
        f"{1e3 * error.platform_max:.3g} mm at most), and no drive stands at a limit.",
    )


def _compared(runs: Sequence[Run], problems: Sequence[Problem]) -> Summary:
    """What a comparison came to; nothing on a motion that cannot be run."""
    lines = infeasible_lines(problems, runs)
    if problems:
        return Summary(Grade.POOR, f"Not feasible: {lines[0]}.", lines[1:])
    sound = _sound(runs)
    if not sound:
        return Summary(Grade.POOR, "Poor: no controller follows this motion.", lines)
    run, tracking = min(sound, key=lambda pair: pair[1].error.platform_rms)
    model = f"the {run.model} model" if run.model else NO_MODEL
    if run.model == "base parameters":
        model = run.model
    error = tracking.error
    return Summary(
        Grade.GOOD,
        f"Good: {run.controller} with {model} follows best, within "
        f"{1e3 * error.platform_rms:.3g} mm (rms; {1e3 * error.platform_max:.3g} mm at most).",
        lines,
    )


def _facts(result: Tracking) -> tuple[Fact, ...]:
    error = result.error
    return (
        Fact("platform error", f"{1e3 * error.platform_rms:.3g} mm", "rms"),
        Fact("largest platform error", f"{1e3 * error.platform_max:.3g} mm"),
        *(
            [Fact("error of the tool's turn", f"{np.rad2deg(error.turn_rms):.3g}°", "rms")]
            if error.turn_rms is not None
            else []
        ),
        Fact("at a torque limit", percent(float(error.saturated.max())), "of the time"),
    )


def _best(runs: Sequence[Run], problems: Sequence[Problem]) -> Fact:
    """Who came nearest, of those that followed a motion that can be run."""
    if problems:
        return Fact("no comparison", "not feasible", "the motion is beyond the robot's limits")
    sound = [(run, tracking.error) for run, tracking in _sound(runs)]
    if not sound:
        return Fact("no controller", "follows this motion", "each stood at a limit or was far off")
    run, error = min(sound, key=lambda pair: pair[1].platform_rms)
    note = f"rms; {run.controller}, {run.model or NO_MODEL}"
    return Fact("least error of the platform", f"{1e3 * error.platform_rms:.3g} mm", note)


def _sound(runs: Sequence[Run]) -> list[tuple[Run, Tracking]]:
    """Runs that followed the motion, within the limits."""
    done = [(run, run.tracking) for run in runs if run.tracking is not None]
    return [(run, result) for run, result in done if result.ended is None and not run.problems]


def _gains(runs: Sequence[Run]) -> tuple[Fact, ...]:
    """How much smaller the error is with the identified model than with the prior."""
    by_name = {(run.controller, run.model): tracking for run, tracking in _sound(runs)}
    facts = []
    for controller in dict.fromkeys(run.controller for run in runs):
        prior, after = (by_name.get((controller, m)) for m in ("prior", "identified"))
        if prior is not None and after is not None:
            before, now = prior.error.platform_rms, after.error.platform_rms
            note = f"{1e3 * before:.3g} mm with the prior, {1e3 * now:.3g} mm identified"
            share = before / now
            times = f"{share:.0f}" if share >= 10 else f"{share:.2g}"
            facts.append(Fact(controller, f"{times} times nearer", note))
    return tuple(facts)


def _of_controller(
    controller: str, done: Sequence[tuple[Run, Tracking]]
) -> list[tuple[str, str, Tracking]]:
    return [
        (run.model or NO_MODEL, _MODELS[run.model], tracking)
        for run, tracking in done
        if run.controller == controller
    ]


def _bars(runs: Sequence[Run]) -> Figure:
    """Error of the platform for each controller and model."""
    figure = go.Figure()
    for model in dict.fromkeys(run.model for run in runs):
        own = [r for r in runs if r.model == model and r.tracking is not None]
        errors = [1e3 * r.tracking.error.platform_rms for r in own if r.tracking is not None]
        figure.add_bar(
            x=[run.controller for run in own],
            y=errors,
            name=model or NO_MODEL,
            marker={"color": _MODELS[model], "line": {"width": 0}},
            text=[f"{error:.2g}" if error < 99.5 else f"{error:.0f}" for error in errors],
            textposition="outside",
            cliponaxis=False,
            hovertemplate="%{x}, " + (model or NO_MODEL) + ": %{y:.3g} mm<extra></extra>",
        )
    figure.update_yaxes(type="log", title_text="platform error, rms [mm]", dtick=1)
    figure.update_layout(barmode="group", height=420, bargap=0.25)
    return Figure(
        figure,
        "Distance of the platform point from where it should be, root mean square, with a "
        "logarithmic scale. All are tuned alike, so what differs is what they know of the robot.",
    )


def _conditions(drives: Drives, bandwidth: float, more: Sequence[str]) -> Text:
    """What the drives do, in a sentence, and more of them."""
    step = f"steps of {drives.encoder_step:.3g} rad or m" if drives.encoder_step else "no steps"
    late = f"a delay of {drives.delay} samples" if drives.delay else "no delay"
    loop = (
        f", current loops of {drives.current_loop:g} Hz" if np.isfinite(drives.current_loop) else ""
    )
    told = (
        f"Feedback of {bandwidth:g} Hz, {drives.rate:g} samples a second, encoders with {step}, "
        f"{late}{loop}"
    )
    return Text(". ".join([told, *(f"{text[:1].upper()}{text[1:]}" for text in more)]) + ".")


def _errors(runs: Sequence[tuple[str, str, Tracking]]) -> tuple[Figure, ...]:
    """Distance of the platform from where it should be, and error of the tool's turn, over time."""
    platform = [(name, color, run.time, 1e3 * run.platform_error) for name, color, run in runs]
    caption = "Distance of the platform point from where it should be."
    figures = [_over_time(platform, "platform error", "mm", caption)]
    turns = [
        (name, color, run.time, np.rad2deg(run.turn_error))
        for name, color, run in runs
        if run.turn_error is not None
    ]
    if turns:
        caption = "Turn ψ of the tool, actual less desired."
        figures.append(_over_time(turns, "error of the turn", "°", caption))
    return tuple(figures)


def _over_time(
    lines: Sequence[tuple[str, str, Signal, Signal]], what: str, unit: str, caption: str
) -> Figure:
    figure = go.Figure()
    for name, color, times, errors in lines:
        time, error = _peaks(times, errors)
        figure.add_scatter(
            x=time,
            y=error,
            name=style.label(name),
            mode="lines",
            line={"color": color, "width": 1.3},
            showlegend=len(lines) > 1,
            hovertemplate=f"%{{y:.3g}} {unit} at %{{x:.4g}} s<extra></extra>",
        )
    figure.update_xaxes(title_text="time [s]")
    figure.update_yaxes(title_text=f"{what} [{unit}]", rangemode="tozero")
    figure.update_layout(height=340)
    return Figure(figure, caption)


def _drives(robot: RobotDescription, result: Tracking) -> Figure:
    """q − q_d of each drive."""
    units = {d: "mm" if robot.is_linear(d) else "°" for d in robot.drives}
    figure = _stack(robot, lambda drive: f"{drive} [{units[drive]}]")
    for i, drive in enumerate(robot.drives):
        scale = 1e3 if robot.is_linear(robot.drives[i]) else np.rad2deg(1.0)
        time, error = _peaks(result.time, scale * result.drive_error[:, i])
        _line(figure, i, time, error, style.RESIDUAL, f"{drive} %{{y:.3g}} {units[drive]}")
    return Figure(figure, "Error of each drive, actual less desired coordinate.")


def _torques(robot: RobotDescription, result: Tracking) -> Figure:
    """Torques that were applied, with the drives' limits where they come near."""
    units = robot.drive_units
    figure = _stack(robot, lambda drive: f"{drive} [{units[drive].force}]")
    for i, (drive, limit) in enumerate(zip(robot.drives, effort_limits(robot), strict=True)):
        tau = result.tau[:, i]
        time, shown = _peaks(result.time, tau)
        _line(figure, i, time, shown, style.MEASURED, f"{drive} %{{y:.4g}} {units[drive].force}")
        if np.nanmax(np.abs(tau)) > 0.5 * limit:
            for edge in (-limit, limit):
                line = {"color": style.LIMIT, "dash": "dot", "width": 1}
                figure.add_hline(y=edge, line=line, row=i + 1, col=1)  # pyright: ignore[reportArgumentType]
    return Figure(figure, "Torques of the drives. Dotted: limits of the plant, if near.")


def _stack(robot: RobotDescription, title: Callable[[str], str]) -> go.Figure:
    """One panel a drive with one time axis."""
    n = len(robot.drives)
    figure = make_subplots(rows=n, cols=1, shared_xaxes=True, vertical_spacing=0.12 / n)
    for i, drive in enumerate(robot.drives):
        figure.update_yaxes(title_text=title(drive), row=i + 1, col=1)
    figure.update_xaxes(title_text="time [s]", row=n, col=1)
    figure.update_layout(height=170 * n + 80)
    return figure


def _line(figure: go.Figure, i: int, time: Points, values: Points, color: str, hover: str) -> None:
    figure.add_scatter(
        x=time,
        y=values,
        mode="lines",
        showlegend=False,
        line={"color": color, "width": 1.2},
        hovertemplate=hover + " at %{x:.4g} s<extra></extra>",
        row=i + 1,
        col=1,
    )


def _peaks(time: Signal, values: Signal) -> tuple[Points, Points]:
    """At most `_POINTS` samples: of each stretch the one of largest size."""
    step = -(-len(time) // _POINTS)
    if step == 1:
        return time.astype(np.float32), values.astype(np.float32)
    whole = len(time) // step
    size = np.nan_to_num(np.abs(values[: whole * step]), nan=-1.0).reshape(whole, step)
    at = np.arange(whole) * step + size.argmax(axis=1)
    return time[at].astype(np.float32), values[at].astype(np.float32)
