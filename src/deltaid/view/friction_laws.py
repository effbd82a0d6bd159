"""Friction laws over speed, prior and identified, with recorded values, and their selection."""

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.model.model import Model, ModelLike, load
from deltaid.model.parameter_record import FrictionChoice, FrictionCurve, FrictionTrial
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.comparison import TorqueComparison, even_rows
from deltaid.view.model_tables import ADDITIONS, choice_sentence, choice_table
from deltaid.view.numbers import number, percent
from deltaid.view.page import Figure, Section, Table, Text
from deltaid.view.torques import grid, place

# Number of dots of a recording, few enough not to hide a law.
_DOTS = 1500


def friction_section(model: ModelLike, comparisons: tuple[TorqueComparison, ...]) -> Section:
    """Friction laws of all joints, with recorded values of the drives."""
    model = load(model)
    if not model.robot.friction_joints:
        return Section("Friction", (Text("The description has no friction in any joint."),))
    record = model.identified.friction_choice if model.identified else None
    choice = _choice(record, model.robot) if record else ()
    return Section("Friction", (_laws(model, comparisons), *choice), "over speed, joint by joint")


def law(
    robot: RobotDescription,
    joint: str,
    speed: Float[np.ndarray, " samples"],
    p: Float[np.ndarray, " parameters"],
) -> Float[np.ndarray, " samples"]:
    """Friction of a joint over its speed for parameters p, without the load-dependent part."""
    terms = zip(robot.friction_terms, p[parameter_layout(robot).friction].tolist(), strict=True)
    own = (size * x.values(speed) for x, size in terms if x.joint == joint and not x.of_load)
    return sum(own, np.zeros_like(speed))


def _laws(model: Model, comparisons: tuple[TorqueComparison, ...]) -> Figure:
    robot, known = model.robot, model.identified
    figure, prior = grid(robot.friction_joints, 270), prior_parameters(robot)
    for i, joint in enumerate(robot.friction_joints):
        fastest, units, traces = robot.platform_speed, robot.units(joint), list[go.Scatter]()
        if joint in robot.drives:
            drive = robot.drives.index(joint)
            speed = np.concatenate([c.speed[:, drive] for c in comparisons])
            residual = np.concatenate([c.residual[:, drive] for c in comparisons])
            fastest, every = float(np.abs(speed).max()) or 1.0, even_rows(len(speed), _DOTS)
            dots = go.Scatter(
                x=speed[every],
                y=residual[every] + law(robot, joint, speed, model.p)[every],
                name="measured, less all else",
                mode="markers",
                marker={"color": style.MEASURED, "size": 3, "opacity": 0.35},
            )
            traces.append(dots)
        positive = np.geomspace(1e-3 * fastest, fastest, num=200)
        speeds = np.concatenate([-positive[::-1], positive])
        dashed = {"color": style.PRIOR, "dash": "dash"}
        traces.append(_line("prior", speeds, law(robot, joint, speeds, prior), dashed))
        if known is not None:
            traces += [_band(curve) for curve in known.friction_curves if curve.joint == joint]
            solid = {"color": style.IDENTIFIED, "dash": "solid"}
            traces.append(_line("identified", speeds, law(robot, joint, speeds, model.p), solid))
        for trace in traces:
            x, y = (np.asarray(values, np.float32) for values in (trace.x, trace.y))
            figure.add_trace(trace.update(x=units.per_shown * x, y=y), **place(i))
        figure.update_xaxes(title_text=f"speed [{units.shown}/s]", **place(i))
        figure.update_yaxes(title_text=f"{units.effort} [{units.force}]", **place(i))
    return Figure(
        style.one_legend(figure),
        "Friction over speed, prior and identified. The dots are what the recordings leave for a "
        "drive's friction when everything else the model predicts is taken away; where they leave "
        "the line, the law does not fit. The band is the 95 % interval of the whole curve, with "
        "the law's speed and exponent unknown. What depends on load is not in the lines.",
    )


def _line(name: str, speed: np.ndarray, torque: np.ndarray, look: dict[str, str]) -> go.Scatter:
    return go.Scatter(x=speed, y=torque, name=name, mode="lines", line={"width": 2, **look})


def _band(curve: FrictionCurve) -> go.Scatter:
    low, high = curve.band(np.array(curve.speed))
    return go.Scatter(
        x=[*curve.speed, *curve.speed[::-1]],
        y=np.concatenate([low, high[::-1]]),
        name="its 95 % interval",
        mode="lines",
        line={"width": 0},
        fill="toself",
        fillcolor=style.IDENTIFIED,
        opacity=0.25,
        hoverinfo="skip",
    )


def _choice(choice: FrictionChoice, robot: RobotDescription) -> tuple[Text | Table, ...]:
    if not choice.steps:
        return (Text("No joint shows more friction than its described law has."),)
    return (
        Text(
            "Laws were extended where the recordings show more friction than the described ones "
            f"have, by the scatter between {choice.folds} stretches of time: "
            f"{choice_sentence(choice)}."
        ),
        choice_table(choice, robot),
        _trials(choice.steps, "What was added, in this order, and whether the final law keeps it."),
        _trials(
            choice.trials,
            "Every addition alone, to the described laws, and whether its gain is beyond chance. "
            "The gain is the share by which the squared error falls; its significance is the "
            "multiple of what chance explains.",
        ),
    )


def _trials(trials: tuple[FrictionTrial, ...], caption: str) -> Table:
    return Table(
        ("joint", "addition", "torque error", "gain", "significance", "useful"),
        tuple(
            (
                trial.joint,
                ADDITIONS[trial.addition],
                percent(trial.error),
                percent(trial.gain),
                number(trial.significance, 3),
                "yes" if trial.useful else "no",
            )
            for trial in trials
        ),
        caption,
        frozenset(i for i, trial in enumerate(trials) if not trial.useful),
    )
