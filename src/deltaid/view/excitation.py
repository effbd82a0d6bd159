"""The page of `deltaid excite`: the motion, its limits, and predicted standard deviations."""

import numpy as np
import plotly.graph_objects as go
import polars as pl
from jaxtyping import Bool, Float

from deltaid.errors import counted
from deltaid.levels import FAINT
from deltaid.motion.excitation.excite import Excitation, Exciter, LimitUse
from deltaid.motion.excitation.plot import SAMPLES
from deltaid.motion.excitation.run import Run, sample_run
from deltaid.motion.excitation.settings import ExcitationSettings
from deltaid.motion.fourier import FourierMotion
from deltaid.view import style
from deltaid.view.animation import animation
from deltaid.view.drawing import drawing
from deltaid.view.numbers import number, percent
from deltaid.view.page import Fact, Figure, Page, Section, Summary, Table, Text, Trust
from deltaid.view.robots import robot_figure
from deltaid.view.show import Card


def excitation_page(result: Excitation) -> Page:
    """Page of an optimised motion, for the robot's prior."""
    exciter, run = result.exciter, result.run
    robot, settings = exciter.dynamics.robot, exciter.settings
    fullest, periods = _fullest(result), counted(run.repeats, "period")
    drawn = f"{number(result.criterion_before)} as drawn at random"
    condition = Text(
        "Standard deviations of least squares on this motion, if the prior is right. Torque noise: "
        f"{percent(settings.torque_noise)} of each drive's largest torque, samples at "
        f"{settings.rate:g} Hz."
    )
    time = np.linspace(0, run.duration, max(SAMPLES, int(50 * run.duration)))
    moving = animation(
        exciter.dynamics.kinematics,
        time,
        run.evaluate(time)[0],
        "The robot on the liveliest seconds of the motion, in real time. Drag to turn the view. "
        "The distance of the two struts in a pair is not part of the description and drawn as it "
        "looks usual.",
    )
    predicted = (condition, prediction_table(result))
    search = (start_table(result), _setting_table(settings))
    return Page(
        title=robot.label,
        subtitle="Motion for identification, from rest to rest within all limits",
        verdict=verdict(result),
        drawing=drawing(robot, exciter.dynamics.kinematics),
        facts=(
            Fact("duration", f"{run.duration:.4g} s", f"{periods} of {run.motion.period:.3g} s"),
            Fact(f"criterion {settings.criterion}", number(result.criterion_after), drawn),
            *([Fact("fullest limit", _in_use(fullest), fullest.name)] if fullest else []),
        ),
        sections=(
            Section(
                "Motion", (moving, _over_time(result)), "the robot moving, and its drives over time"
            ),
            Section("Limits", (_limit_bars(result),), "how much of each the motion uses"),
            Section("Predicted deviations", predicted, "how well each number will be known"),
            Section("Search", search, "starts and settings"),
        ),
    )


def _setting_table(settings: ExcitationSettings) -> Table:
    chosen = {
        "criterion": settings.criterion,
        "harmonics": str(settings.harmonics),
        "longest period [s]": number(settings.duration),
        "repeats": str(settings.repeats),
        "weight of speed": number(settings.velocity_weight),
        "weighed by the prior": "yes" if settings.weigh_prior else "no",
        "torque noise, share of the largest torque": percent(settings.torque_noise),
        "rate [Hz]": number(settings.rate),
        "starts": str(settings.starts),
        "seed": str(settings.seed),
    }
    return Table(("setting", "value"), tuple(chosen.items()))


def verdict(result: Excitation) -> Summary:
    """Whether the motion keeps its limits, and determines most base parameters."""
    beyond = [limit.name for limit in result.limits if limit.share > 1 + FAINT]
    lasts = f"{result.run.duration:.1f} s from rest to rest"
    if beyond:
        return Summary(Trust.POOR, f"Poor: {lasts}, and beyond a limit of {', '.join(beyond)}.")
    count = len(result.predictions)
    determined = sum(p.std < p.prior_std for p in result.predictions)
    shows = f"determines {determined} of {count} combinations of the robot's numbers"
    if determined < count / 2:
        return Summary(
            Trust.POOR,
            f"Poor: {lasts}, and {shows} better than the prior does; check units of limits and "
            "workspace, or give a longer --duration.",
        )
    fullest = _fullest(result)
    used = f"; {fullest.name} comes nearest, {_in_use(fullest)}" if fullest else ""
    return Summary(
        Trust.GOOD,
        f"Good: {lasts}, within all {len(result.limits)} limits{used}.",
        (f"It {shows} better than the prior does.",),
    )


def _in_use(limit: LimitUse) -> str:
    return f"{100 * limit.share:.1f} %"


def _fullest(result: Excitation) -> LimitUse | None:
    return max(result.limits, key=lambda limit: limit.share, default=None)


def excitation_figure(result: Excitation) -> go.Figure:
    """Platform, drives, speeds and torques over time, less high than in a report."""
    return _over_time(result).figure.update_layout(height=640)


def exciter_figure(exciter: Exciter) -> go.Figure:
    """The robot with the workspace of its motions."""
    return robot_figure(exciter.dynamics.robot)


def _over_time(result: Excitation) -> Figure:
    run, dynamics, task = result.run, result.exciter.dynamics, result.exciter.dynamics.robot.task
    time = np.linspace(0, run.duration, SAMPLES)
    z, zd, zdd = run.evaluate(time)
    q, qd, _ = dynamics.kinematics.drive_motion(z, zd, zdd)
    units = dynamics.robot.drive_units
    first, shown = next(iter(units.values())), np.array([u.per_shown for u in units.values()])
    turns = dict(zip(units, style.SERIES, strict=False))
    rows = [
        ("platform [m]", z[:, task.moves], {"xyz"[k]: style.SERIES[4 + k] for k in task.axes}),
        ("{0.motion} [{0.shown}]", q * shown, turns),
        ("speed [{0.shown}/s]", qd * shown, turns),
        ("{0.effort} [{0.force}]", result.exciter.preview(run, SAMPLES), turns),
    ]
    foreign = np.array([u != first for u in units.values()])
    figure = style.stacked(
        [title.format(first) for title, *_ in rows],
        height=880,
        spacing=0.03,
        specs=[[{"secondary_y": True}]] * len(rows),
    )
    for row, (title, values, colors) in enumerate(rows, 1):
        right = foreign | _of_another_size(values) if colors is turns else np.zeros(3, bool)
        for i, (name, color) in enumerate(colors.items()):
            place = {"row": row, "col": 1, "secondary_y": bool(right[i])}
            figure.add_scatter(
                x=time.astype(np.float32),
                y=values[:, i].astype(np.float32),
                name=name,
                legendgroup=name,
                showlegend=row <= 2,
                mode="lines",
                line={"color": color, "width": 1.4},
                hovertemplate=f"{name} %{{y:.4g}} at %{{x:.4g}} s<extra></extra>",
                **place,
            )
            if right[i]:
                named = f"{name} {title.format(units[name])}" if foreign[i] else name
                axis = {"color": color, "showgrid": False, "tickmode": "auto"}
                figure.update_yaxes(axis | {"title_text": named}, **place)
    for edge in (run.ramp, run.duration - run.ramp):
        figure.add_vline(x=edge, line={"color": style.PRIOR, "dash": "dot", "width": 1})
    return Figure(
        figure,
        "Platform point, coordinates and speeds of the drives, and the torques or forces that the "
        "prior predicts. A drive whose numbers are of another size or unit has its own axis on the "
        "right. Dotted lines are the ends of the ramps from and to rest.",
        paper=480,
    )


def _of_another_size(values: Float[np.ndarray, "samples drives"]) -> Bool[np.ndarray, " drives"]:
    """Columns so much larger or smaller than most that a common axis would flatten one of them."""
    sizes = np.abs(values).max(axis=0)
    return (sizes > 5 * np.median(sizes)) | (sizes < 0.2 * np.median(sizes))


def _limit_bars(result: Excitation) -> Figure:
    figure = style.bars(
        [limit.name for limit in result.limits],
        [100 * limit.share for limit in result.limits],
        "largest use over the whole run [%]",
        height=22 * len(result.limits) + 100,
        marker={"color": style.SERIES[0]},
        hovertemplate="%{y}: %{x:.1f} %<extra></extra>",
    ).add_vline(x=100, line={"color": style.LIMIT, "width": 1.5})
    return Figure(figure, "Largest use of every limit over the whole run; the line is the limit.")


def excitation_card(value: Excitation) -> Card:
    robot, settings, fullest = value.exciter.dynamics.robot, value.exciter.settings, _fullest(value)
    most = f"{percent(fullest.share)} ({fullest.name})" if fullest else ""
    before = f"{number(value.criterion_before)} before"
    return Card(
        f"Motion of {robot.label} from rest to rest, within all limits",
        facts=(
            ("duration", f"{number(value.run.duration)} s"),
            ("criterion", f"{number(value.criterion_after)} ({settings.criterion}), {before}"),
            ("base parameters", f"{len(value.predictions)} made visible"),
            *([("fullest limit", most)] if most else []),
        ),
        more=(("limits", limit_table(value)), ("predicted deviations", prediction_table(value))),
        methods=(".plot()", ".to_frame()", '.save("motion.csv")', '.report("x.html")'),
    )


def excitation_frame(value: Excitation) -> pl.DataFrame:
    """The run at the rate of the settings: t, q1…, qd1…, qdd1…, x, y, z in SI units."""
    exciter = value.exciter
    return sample_run(exciter.dynamics.kinematics, value.run, exciter.settings.rate)


def exciter_card(value: Exciter) -> Card:
    robot, settings = value.dynamics.robot, value.settings
    return Card(
        f"Exciter of {robot.label}",
        facts=(
            ("criterion", settings.criterion),
            ("starts", str(settings.starts)),
            ("harmonics", str(settings.harmonics)),
            ("longest period", f"{settings.duration:.4g} s"),
            ("base parameters", str(len(value.base.groups))),
        ),
        methods=(".optimise()", ".plot()"),
    )


def run_card(value: Run | FourierMotion) -> Card:
    motion, title, facts = value, "Periodic motion", list[tuple[str, str]]()
    if not isinstance(motion, FourierMotion):
        facts = [("duration", f"{number(motion.duration)} s"), ("periods", str(motion.repeats))]
        motion, title = motion.motion, "Motion from rest to rest"
    facts += [
        ("period", f"{number(motion.period)} s"),
        ("harmonics", str(motion.sine.shape[1])),
        ("coordinates", str(len(motion.centre))),
    ]
    return Card(title, facts=tuple(facts), methods=(".evaluate(time)",))


def limit_table(result: Excitation) -> Table:
    """Largest use of every limit over the whole run."""
    rows = tuple((limit.name, _in_use(limit)) for limit in result.limits)
    return Table(("limit", "in use"), rows, title="limits")


def prediction_table(result: Excitation) -> Table:
    return Table(
        ("base parameter", "prior", "predicted ±", "unit", "share"),
        tuple(
            (
                p.formula,
                number(p.value),
                f"{p.std:.2g}",
                p.unit,
                percent(p.std / abs(p.value)) if abs(p.value) > p.std else "",
            )
            for p in result.predictions
        ),
        "Predicted standard deviation of every base parameter; the share is of the prior, and is "
        "omitted where the deviation is larger than the value.",
        title="predicted deviations",
    )


def start_table(result: Excitation) -> Table:
    accounts = result.optimum.accounts
    judged = any(account.judged is not None for account in accounts)
    bodies = (
        " Bodies: ½ log det of the covariance of all their entries after torques and sensors, "
        "in nats, by which the motion was chosen."
    )
    table = Table(
        ("start", "as drawn", "optimised", "evaluations", "seconds", "fullest limit", "feasible",
         "bodies"),
        tuple(
            (
                str(account.seed),
                number(account.before),
                number(account.after),
                str(account.evaluations),
                f"{account.seconds:.1f}",
                f"{100 * account.use:.1f} %",
                "yes" if account.feasible else "no",
                number(account.judged, 5) if account.judged is not None else "",
            )
            for account in accounts
        ),
        "Objective of the search for each start as it was drawn at random, and optimised."
        f"{bodies if judged else ''}",
        title="starts",
    )  # fmt: skip
    return table if judged else table.without("bodies")
