"""Optimised motions and what makes them: tables, cards."""

import polars as pl

from deltaid.motion.excitation.excite import Excitation, Exciter
from deltaid.motion.excitation.run import Run, sample_run
from deltaid.motion.fourier import FourierMotion
from deltaid.view.card import Card
from deltaid.view.numbers import number, percent
from deltaid.view.page import Table


def excitation_card(value: Excitation) -> Card:
    """Duration, criterion, fullest limit; folded predicted deviations."""
    robot, settings, run = value.exciter.dynamics.robot, value.exciter.settings, value.run
    facts = [
        ("duration", f"{number(run.duration)} s"),
        ("criterion", f"{number(value.criterion_after)} ({settings.criterion}), "
         f"{number(value.criterion_before)} before"),
        ("base parameters", f"{len(value.predictions)} made visible"),
    ]  # fmt: skip
    fullest = max(value.limits, key=lambda limit: limit.share, default=None)
    if fullest is not None:
        facts.append(("fullest limit", f"{percent(fullest.share)} ({fullest.name})"))
    return Card(
        f"Motion of {robot.title or robot.name} from rest to rest, within all limits",
        facts=tuple(facts),
        more=(("limits", limit_table(value)), ("predicted deviations", prediction_table(value))),
        methods=(".plot()", ".to_frame()", '.save("motion.csv")', '.report("x.html")'),
    )


def excitation_frame(value: Excitation) -> pl.DataFrame:
    """The run at the rate of the settings: t, q1…, qd1…, qdd1…, x, y, z; in SI units."""
    exciter = value.exciter
    return sample_run(exciter.dynamics.kinematics, value.run, exciter.settings.rate)


def exciter_card(value: Exciter) -> Card:
    """What is to be optimised."""
    robot, settings = value.dynamics.robot, value.settings
    return Card(
        f"Exciter of {robot.title or robot.name}",
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
    """Period, number of harmonics, and duration of a run."""
    motion = value.motion if isinstance(value, Run) else value
    facts = [
        ("period", f"{number(motion.period)} s"),
        ("harmonics", str(motion.sine.shape[1])),
        ("coordinates", str(len(motion.centre))),
    ]
    title = "Periodic motion"
    if isinstance(value, Run):
        title = "Motion from rest to rest"
        facts[:0] = ("duration", f"{number(value.duration)} s"), ("periods", str(value.repeats))
    return Card(title, facts=tuple(facts), methods=(".evaluate(time)",))


def limit_table(result: Excitation) -> Table:
    """Largest use of every limit over the whole run."""
    rows = tuple((limit.name, f"{100 * limit.share:.1f} %") for limit in result.limits)
    return Table(("limit", "in use"), rows, title="limits")


def prediction_table(result: Excitation) -> Table:
    """What the motion will tell about every base parameter."""
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
    """What became of each start of the search."""
    accounts = result.optimum.accounts
    judged = any(a.judged is not None for a in accounts)
    rows = tuple(
        (
            str(a.seed),
            number(a.before),
            number(a.after),
            str(a.evaluations),
            f"{a.seconds:.1f}",
            f"{100 * a.use:.1f} %",
            "yes" if a.feasible else "no",
            *([number(a.judged, 5) if a.judged is not None else ""] if judged else []),
        )
        for a in accounts
    )
    columns = (
        "start", "as drawn", "optimised", "evaluations", "seconds", "fullest limit", "feasible",
        *(["bodies"] if judged else []),
    )  # fmt: skip
    caption = "Objective of the search for each start as it was drawn at random, and optimised."
    if judged:
        caption += (
            " Bodies: ½ log det of the covariance of all their entries after torques and sensors, "
            "in nats, by which the motion was chosen."
        )
    return Table(columns, rows, caption, title="starts")
