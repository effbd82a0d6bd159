"""The page of `deltaid excite`: the motion, its limits, and what it will tell."""

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Bool, Float
from plotly.subplots import make_subplots

from deltaid.motion.excitation.excite import Excitation, Exciter, LimitUse
from deltaid.view import style
from deltaid.view.animation import ShownMotion, animation
from deltaid.view.drawing import drawing
from deltaid.view.motions import prediction_table, start_table
from deltaid.view.numbers import number, percent
from deltaid.view.page import Fact, Figure, Page, Section, Summary, Table, Text, Trust
from deltaid.view.robots import robot_figure

# Points over time that a figure draws quickly.
_SAMPLES = 2000
# A limit that a search has reached counts as kept.
_ROUNDING = 1e-6


def excitation_page(result: Excitation) -> Page:
    """Everything about an optimised motion, at the robot's prior."""
    exciter, run = result.exciter, result.run
    robot, settings = exciter.dynamics.robot, exciter.settings
    fullest = max(result.limits, key=lambda limit: limit.share, default=None)
    periods = f"{run.repeats} periods" if run.repeats > 1 else "1 period"
    facts = [
        Fact("duration", f"{run.duration:.4g} s", f"{periods} of {run.motion.period:.3g} s"),
        Fact(
            f"criterion {settings.criterion}",
            number(result.criterion_after),
            f"{number(result.criterion_before)} as drawn at random",
        ),
    ]
    if fullest is not None:
        facts.append(Fact("fullest limit", _used(fullest), fullest.name))
    return Page(
        title=robot.title or robot.name,
        subtitle="Motion for identification, from rest to rest within all limits",
        verdict=verdict(result),
        drawing=drawing(robot, exciter.dynamics.kinematics),
        facts=tuple(facts),
        sections=(
            Section(
                "Motion",
                (_animation(result), _over_time(result)),
                "the robot moving, and its drives over time",
            ),
            Section("Limits", (_limits(result),), "how much of each the motion uses"),
            Section(
                "Predicted deviations",
                _predictions(result),
                "how well each number will be known",
            ),
            Section("Search", (start_table(result), _settings(result)), "starts and settings"),
        ),
    )


def verdict(result: Excitation) -> Summary:
    """Whether the motion keeps its limits."""
    run, beyond = result.run, [limit.name for limit in result.limits if limit.share > 1 + _ROUNDING]
    lasts = f"{run.duration:.1f} s from rest to rest"
    if beyond:
        return Summary(Trust.POOR, f"Poor: {lasts}, and beyond a limit of {', '.join(beyond)}.")
    fullest = max(result.limits, key=lambda limit: limit.share, default=None)
    used = f"; {fullest.name} comes nearest, {_used(fullest)}" if fullest else ""
    lines = (f"It shows {len(result.predictions)} combinations of the robot's numbers.",)
    return Summary(Trust.GOOD, f"Good: {lasts}, within all {len(result.limits)} limits{used}.",
                   lines)  # fmt: skip


def _used(limit: LimitUse) -> str:
    return f"{100 * limit.share:.1f} %"


def _animation(result: Excitation) -> Figure:
    time = np.linspace(0, result.run.duration, max(_SAMPLES, int(50 * result.run.duration)))
    z, *_ = result.run.evaluate(time)
    return animation(
        result.exciter.dynamics.kinematics,
        ShownMotion(time, z),
        "The robot on the liveliest seconds of the motion, in real time. Drag to turn the view. "
        "The distance of the two struts in a pair is not part of the description and drawn as it "
        "looks usual.",
    )


def excitation_figure(result: Excitation) -> go.Figure:
    """Platform, drives, speeds and torques over time, lower than in a report."""
    return _over_time(result).figure.update_layout(height=640)


def exciter_figure(exciter: Exciter) -> go.Figure:
    """The robot with the workspace that motions stay in."""
    return robot_figure(exciter.dynamics.robot)


def _over_time(result: Excitation) -> Figure:
    """Platform, drives, speeds and torques of a run."""
    run, dynamics = result.run, result.exciter.dynamics
    time = np.linspace(0, run.duration, _SAMPLES)
    z, zd, zdd = run.evaluate(time)
    q, qd, _ = dynamics.kinematics.drive_motion(z, zd, zdd)
    units = dynamics.robot.drive_units
    first, shown = next(iter(units.values())), np.array([u.per_shown for u in units.values()])
    task = dynamics.robot.task
    axes = {"xyz"[axis]: style.SERIES[4 + axis] for axis in task.axes}
    turns = dict(zip(units, style.SERIES, strict=False))
    rows = [
        ("platform [m]", z[:, task.moves], axes),
        ("{0.motion} [{0.shown}]", q * shown, turns),
        ("speed [{0.shown}/s]", qd * shown, turns),
        ("{0.effort} [{0.force}]", result.exciter.preview(run, _SAMPLES), turns),
    ]
    foreign = np.array([u != first for u in units.values()])
    figure = make_subplots(
        rows=len(rows),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.03,
        specs=[[{"secondary_y": True}]] * len(rows),
    )
    for row, (title, values, colors) in enumerate(rows, 1):
        right = foreign | _of_another_size(values) if colors is turns else np.zeros(3, bool)
        for i, (name, color) in enumerate(colors.items()):
            figure.add_scatter(
                x=time.astype(np.float32),
                y=values[:, i].astype(np.float32),
                name=name,
                legendgroup=name,
                showlegend=row <= 2,
                mode="lines",
                line={"color": color, "width": 1.4},
                hovertemplate=f"{name} %{{y:.4g}} at %{{x:.4g}} s<extra></extra>",
                row=row,
                col=1,
                secondary_y=bool(right[i]),
            )
            if right[i]:
                own = {
                    "title_text": f"{name} {title.format(units[name])}" if foreign[i] else name,
                    "color": color,
                    "showgrid": False,
                    "tickmode": "auto",
                }
                figure.update_yaxes(own, row=row, col=1, secondary_y=True)
        figure.update_yaxes(title_text=title.format(first), row=row, col=1, secondary_y=False)
    for edge in (run.ramp, run.duration - run.ramp):
        figure.add_vline(x=edge, line={"color": style.PRIOR, "dash": "dot", "width": 1})
    figure.update_xaxes(title_text="time [s]", row=len(rows), col=1)
    figure.update_layout(height=880)
    return Figure(
        figure,
        "Platform point, coordinates and speeds of the drives, and the torques or forces that the "
        "prior predicts. A drive whose numbers are of another size or unit has its own axis on the "
        "right. Dotted lines are the ends of the ramps from and to rest.",
        paper=480,
    )


def _of_another_size(values: Float[np.ndarray, "samples drives"]) -> Bool[np.ndarray, " drives"]:
    """Which columns are so much larger or smaller than most that one of both would look flat."""
    sizes = np.abs(values).max(axis=0)
    usual = np.median(sizes)
    return (sizes > 5 * usual) | (sizes < 0.2 * usual)


def _limits(result: Excitation) -> Figure:
    figure = go.Figure(
        go.Bar(
            x=[100 * limit.share for limit in result.limits],
            y=[style.label(limit.name) for limit in result.limits],
            orientation="h",
            marker={"color": style.SERIES[0]},
            hovertemplate="%{y}: %{x:.1f} %<extra></extra>",
        ),
        {
            "yaxis": style.DOWNWARDS,
            "xaxis": {"title": "largest use over the whole run [%]", "rangemode": "tozero"},
            "height": 22 * len(result.limits) + 100,
            "margin": {"t": 20},
            "bargap": 0.35,
        },
    )
    figure.add_vline(x=100, line={"color": style.LIMIT, "width": 1.5})
    return Figure(figure, "Largest use of every limit over the whole run; the line is the limit.")


def _predictions(result: Excitation) -> tuple[Text, Table]:
    settings = result.exciter.settings
    return (
        Text(
            f"Standard deviations of least squares on this motion, if the prior is right. Torque "
            f"noise: {percent(settings.torque_noise)} of each drive's largest torque, samples at "
            f"{settings.rate:g} Hz."
        ),
        prediction_table(result),
    )


def _settings(result: Excitation) -> Table:
    s = result.exciter.settings
    return Table(
        ("setting", "value"),
        (
            ("criterion", s.criterion),
            ("harmonics", str(s.harmonics)),
            ("longest period [s]", number(s.duration)),
            ("repeats", str(s.repeats)),
            ("weight of speed", number(s.velocity_weight)),
            ("weighed by the prior", "yes" if s.weigh_prior else "no"),
            ("torque noise, share of the largest torque", percent(s.torque_noise)),
            ("rate [Hz]", number(s.rate)),
            ("starts", str(s.starts)),
            ("seed", str(s.seed)),
        ),
    )
