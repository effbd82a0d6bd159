"""The pages of `deltaid simulate` and `deltaid compare-controllers`, and their tables."""

from collections.abc import Sequence

import numpy as np

from deltaid.control.comparison import ControllerRun
from deltaid.control.infeasible import MotionProblem
from deltaid.control.tracking import Drives, Tracking
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.numbers import number, percent
from deltaid.view.page import Fact, Page, Section, Summary, Table, Text, Trust
from deltaid.view.tracking_figures import (
    COLOURS,
    NO_MODEL,
    drive_figure,
    error_bars,
    error_figures,
    torque_figure,
)


def tracking_page(
    robot: RobotDescription,
    result: Tracking,
    title: str,
    drives: Drives,
    bandwidth: float,
    problems: Sequence[MotionProblem] = (),
    conditions: Sequence[str] = (),
) -> Page:
    """One controller on one plant, which is `robot`; bandwidth in Hz.

    Args:
        conditions: what else holds of the plant and of what the controller knows, in words.
    """
    return Page(
        title=robot.title or robot.name,
        subtitle=f"Simulated tracking: {title}",
        facts=_facts(result),
        sections=(
            Section(
                "Tracking",
                (
                    *error_figures([(title, style.IDENTIFIED, result)]),
                    drive_figure(robot, result),
                    _conditions(drives, bandwidth, conditions),
                ),
            ),
            Section("Torques", (torque_figure(robot, result), drive_table(robot, result))),
        ),
        verdict=_followed(result, problems),
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
    lines = [
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
    ]
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
            *lines,
        ),
        verdict=_compared(runs, problems),
    )


def _followed(result: Tracking, problems: Sequence[MotionProblem]) -> Summary:
    """Whether a simulated motion can be run, and how well it was followed."""
    if problems:
        first, *others = (problem.text for problem in problems)
        return Summary(Trust.POOR, f"Not feasible: {first}.", tuple(others))
    error = result.error
    return Summary(
        Trust.GOOD,
        f"Good: the platform follows within {1e3 * error.platform_rms:.3g} mm (rms; "
        f"{1e3 * error.platform_max:.3g} mm at most), and no drive stands at a limit.",
    )


def _compared(runs: Sequence[ControllerRun], problems: Sequence[MotionProblem]) -> Summary:
    """What a comparison came to; nothing on a motion that cannot be run."""
    lines = infeasible_lines(problems, runs)
    if problems:
        return Summary(Trust.POOR, f"Not feasible: {lines[0]}.", lines[1:])
    sound = _sound(runs)
    if not sound:
        return Summary(Trust.POOR, "Poor: no controller follows this motion.", lines)
    run, tracking = min(sound, key=lambda pair: pair[1].error.platform_rms)
    named = {"": NO_MODEL, "base parameters": run.model}
    model = named.get(run.model, f"the {run.model} model")
    error = tracking.error
    return Summary(
        Trust.GOOD,
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


def _best(runs: Sequence[ControllerRun], problems: Sequence[MotionProblem]) -> Fact:
    """Who came nearest, of those that followed a motion that can be run."""
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
    """How much smaller the error is with the identified model than with the prior."""
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
    """What the drives do, in a sentence, and more of them."""
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
