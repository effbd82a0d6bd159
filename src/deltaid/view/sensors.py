"""The page of `deltaid sensors`: uncertain entries, the effect of each measurement, purchases."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from deltaid.sensors.planning.null_space import DESCRIBED, PLAN, TORQUES
from deltaid.sensors.planning.plan import SensorPlan
from deltaid.view import style
from deltaid.view.drawing import drawing
from deltaid.view.numbers import in_words, number, percent
from deltaid.view.page import Block, Fact, Figure, Page, Section, Summary, Table, Text, Trust
from deltaid.view.sensor_plan import (
    bought,
    chosen_entries,
    count_table,
    entry_table,
    known_entries,
    open_table,
    stages,
    step_table,
    stopped,
    undetermined,
    use_table,
)

# Height of a bar, and of everything around the bars [px].
_BAR, _AROUND = 22, 110


def plan_page(plan: SensorPlan, entries: Sequence[str] | None = None) -> Page:
    """The page of `deltaid sensors`.

    Args:
        entries: in the table of uses; None for the default ones.
    """
    if entries is None:
        entries = chosen_entries(plan)
    robot, now = plan.model.robot, plan.described
    known = DESCRIBED if plan.has_described else TORQUES
    open_now = next(opening for opening in plan.openings if opening.name == known).null
    hidden = Text(f"Nothing of the list determines much of {', '.join(undetermined(plan))}.")
    return Page(
        title=robot.label,
        subtitle=f"What sensors and scales would determine, planned for {plan.motion}",
        verdict=_verdict(plan, len(open_now.directions)),
        drawing=drawing(robot, plan.model.dynamics.kinematics),
        facts=(
            Fact("directions that stay open", str(len(open_now.directions)), now.title),
            Fact(plan.goal, percent(now.goal), "typical standard deviation now"),
            *(Fact(*fact) for fact in bought(plan)),
        ),
        sections=(
            Section(
                f"What to buy next for {plan.goal}",
                _steps(plan),
                "step by step, by gain and price",
                unfolded=True,
            ),
            Section(
                "What is known of each entry",
                (_bars(plan),),
                "now, and with what is bought",
                unfolded=True,
            ),
            Section(
                "The same in numbers",
                (entry_table(plan), *([hidden] if undetermined(plan) else [])),
                "standard deviations of all entries",
            ),
            Section(
                "What each would make of it",
                (_gains(plan), use_table(plan, entries)),
                "each measurement by itself",
            ),
            Section("What stays open", _open(plan), "what nothing of it determines"),
            Section("Taken for granted", _granted(plan), "assumptions, settings, prices"),
        ),
    )


def plan_figure(plan: SensorPlan) -> go.Figure:
    """Standard deviation after each step; without purchases, those of all entries."""
    return next(block.figure for block in (*_steps(plan), _bars(plan)) if isinstance(block, Figure))


def _verdict(plan: SensorPlan, open_now: int) -> Summary:
    now, lines = plan.described, [f"{stopped(plan)}."]
    stays = "direction stays" if open_now == 1 else "directions stay"
    said = (
        f"With {now.title} a typical standard deviation of {percent(now.goal)} is left for "
        f"{plan.goal}, and {in_words(open_now)} {stays} open"
    )
    if plan.steps:
        (_, left, spent), (_, first, cost) = bought(plan)
        buy = f"Buy {first} first, for {cost}; all that is worth buying costs {spent} and leaves "
        predicted = "Predicted for a motion, a noise and a prior; nothing has been measured."
        lines = [f"{buy}{left}.", *lines, predicted]
    return Summary(Trust.UNTESTED, f"{said}.", tuple(lines))


def _bars(plan: SensorPlan) -> Figure:
    """Standard deviations before and after, one bar each; wide ones behind narrow ones."""
    u, shown = plan.unknowns, known_entries(plan)
    looks = {
        "torques": ("torques alone", style.PRIOR, 0.8),
        "described": ("as described", style.MEASURED, 0.55),
        "with all bought": ("with all bought", style.IDENTIFIED, 0.3),
    }
    bars = [
        go.Bar(
            x=100 * outlook.shares[shown],
            y=[style.label(u.names[k]) for k in shown],
            width=looks[name][2],
            orientation="h",
            name=looks[name][0],
            marker={"color": looks[name][1]},
            hovertemplate=f"%{{y}} {looks[name][0]}: %{{x:.2g}} %<extra></extra>",
        )
        for name, outlook in stages(plan).items()
    ]
    axis = {"title": "standard deviation [% of the prior value]", "rangemode": "tozero"}
    layout = {"yaxis": style.DOWNWARDS, "xaxis": axis, "height": _BAR * len(shown) + _AROUND}
    return Figure(
        go.Figure(bars, layout | {"barmode": "overlay"}),
        "One standard deviation of every entry that something determines. Where the narrow bar is "
        "as long as the wide one, nothing that is bought helps.",
    )


def _gains(plan: SensorPlan) -> Figure:
    uses = sorted(plan.uses, key=lambda use: -use.gain)
    figure = style.bars(
        [use.name for use in uses],
        [use.gain for use in uses],
        f"gain for {style.label(plan.goal)} [nats]",
        height=_BAR * len(uses) + _AROUND,
        marker={"color": style.MEASURED},
        customdata=[[style.label(use.title), use.cost] for use in uses],
        hovertemplate="%{customdata[0]}: %{x:.2f} nats for %{customdata[1]:.0f} "
        f"{style.label(plan.offers.currency)}<extra></extra>",
    )
    return Figure(
        figure, "What each thing by itself would gain, whatever it costs, the most telling first."
    )


def _steps(plan: SensorPlan) -> tuple[Block, ...]:
    if not plan.steps:
        return (Text(f"Nothing of the list is worth buying for {plan.goal}."),)
    spent = [0.0, *(step.spent for step, _ in plan.steps)]
    left = [plan.described.goal, *(outlook.goal for _, outlook in plan.steps)]
    names = ["as it is", *(step.use.name for step, _ in plan.steps)]
    money = style.label(plan.offers.currency)
    figure = go.Figure(
        go.Scatter(
            x=np.arange(len(left)),
            y=100 * np.array(left),
            mode="lines+markers",
            line={"color": style.IDENTIFIED, "width": 1.6},
            customdata=[[style.label(n), s] for n, s in zip(names, spent, strict=True)],
            hovertemplate="%{customdata[0]}: %{y:.2g} % left for %{customdata[1]:.0f} "
            f"{money}<extra></extra>",
        ),
        {
            "height": 320,
            "margin": {"t": 20},
            "showlegend": False,
            "xaxis": {
                "tickvals": np.arange(len(left)),
                "ticktext": [f"{cost:.0f}" for cost in spent],
                "title": f"spent [{money}], step by step",
            },
            "yaxis": {"title": "left [%]", "type": "log"},
        },
    )
    return (
        Figure(figure, "Typical standard deviation (geometric mean) after each step.", paper=240),
        step_table(plan),
    )


def _open(plan: SensorPlan) -> tuple[Block, ...]:
    blocks: list[Block] = [
        Text(
            "A point mass that passes from one body to another at a joint which both share changes "
            "no torque and no force outside of that joint. Such directions stay open however long "
            "and well one records; a cut at the joint, or a scale, parts them."
        ),
        count_table(plan),
    ]
    for opening in plan.openings:
        if opening.name in (TORQUES, DESCRIBED, PLAN) and opening.null.directions:
            rows = tuple(
                (f"{words} ({entries})", parted)
                for words, entries, parted in open_table(opening).rows
            )
            blocks.append(Table((f"stays open, {opening.title}", "parted by any of"), rows))
    return tuple(blocks)


def _granted(plan: SensorPlan) -> tuple[Block, ...]:
    settings, money = plan.settings, plan.offers.currency
    chosen = (
        ("torque noise, share of each drive's largest torque", percent(settings.torque_noise)),
        ("independent samples a second", number(settings.rate)),
        ("standard deviation of the prior", percent(settings.prior_spread)),
        ("good enough", percent(settings.enough)),
        ("goal", plan.goal),
    )
    offers = Table(
        ("offer", money, "hours", "what, and what is assumed"),
        tuple(
            (
                key,
                f"{offer.price:g}",
                f"{offer.hours:g}",
                f"{offer.title}; {offer.remark}".removesuffix("; "),
            )
            for key, offer in plan.offers.offers.items()
        ),
        f"The list. An hour costs {plan.offers.hourly:g} {money}. Put in your own by --sensors.",
    )
    notes = Text("\n\n".join(f"{note[0].upper()}{note[1:]}." for note in plan.notes))
    return notes, Table(("setting", "value"), chosen), offers
