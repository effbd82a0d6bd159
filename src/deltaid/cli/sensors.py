"""`deltaid sensors`: effect and price of scales, force plates and gauges."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import deltaid
from deltaid.cli.options import (
    AsJson,
    Full,
    MotionColumns,
    Report,
    Robot,
    UsePoor,
    bounded,
    names,
    require_outputs,
)
from deltaid.cli.output import (
    note_planned,
    print_outcome,
    progress,
    used,
    write_files,
)
from deltaid.levels import TORQUE_NOISE
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.view.numbers import percent

if TYPE_CHECKING:
    from deltaid.sensors.planning.plan import Outlook


def sensors(
    robot: Robot,
    motion: Annotated[
        Path | None,
        typer.Argument(help="Planned motion or recording. Default: a random motion."),
    ] = None,
    goal: Annotated[
        str, typer.Option(help="Goal: bodies, the name of one body, forces or gains.")
    ] = "bodies",
    budget: Annotated[
        float | None,
        bounded(
            help="Largest total price. Default: until everything is known well enough.",
            limits=(1e-9, 1e12),
        ),
    ] = None,
    offers: Annotated[
        Path | None,
        typer.Option(
            "--sensors", help="Offer of sensors and prices (YAML), instead of the built-in one."
        ),
    ] = None,
    combine: Annotated[
        list[str] | None,
        typer.Option(help="Uses to evaluate together, such as kitchen-scale:S,edge:S. Repeatable."),
    ] = None,
    entries: Annotated[
        str | None, typer.Option(help="Entries to print, such as U.mcx,S.m,P.m.")
    ] = None,
    columns: MotionColumns = None,
    torque_noise: Annotated[
        float,
        bounded(help="Torque noise, share of each drive's largest torque.", limits=(1e-9, 10.0)),
    ] = TORQUE_NOISE,
    rate: Annotated[
        float, bounded(help="Independent samples per second.", limits=(1e-3, 1e6))
    ] = 200.0,
    duration: Annotated[
        float, bounded(help="Duration of the random motion, s.", limits=(0.1, 36_000.0))
    ] = 20.0,
    prior_spread: Annotated[
        float,
        bounded(
            help="Standard deviation of the prior, as a share of its values.", limits=(1e-6, 1e3)
        ),
    ] = PRIOR_SPREAD,
    gain_spread: Annotated[
        float | None,
        bounded(
            help="Standard deviation of torque constants, as a share. Default: 0, or 0.1 "
            "with --goal gains.",
            limits=(0.0, 10.0),
        ),
    ] = None,
    enough: Annotated[
        float,
        bounded(
            help="Standard deviation that is good enough, as a share of a value.",
            limits=(1e-9, 1.0),
        ),
    ] = 0.01,
    steps: Annotated[
        int, typer.Option(help="Largest number of things to buy.", min=1, max=100)
    ] = 10,
    seed: Annotated[int, typer.Option(help="Seed of the random motion.", min=0)] = 0,
    print_list: Annotated[
        bool, typer.Option("--list", help="Print the offer of sensors and prices, and stop.")
    ] = False,
    report: Report = None,
    full: Full = False,
    as_json: AsJson = False,
    force: UsePoor = False,
) -> None:
    """Plan weighings and sensors in addition to torques.

    The command shows which parameters of bodies torques do not determine, which measurements
    determine them, and at which price.

    Nothing is measured: standard deviations are predictions for a motion, a noise and a prior.
    """
    from deltaid.robot.load import read_text
    from deltaid.sensors.planning.null_space import DESCRIBED, PLAN, TORQUES
    from deltaid.sensors.planning.offers import shipped_text
    from deltaid.view import sensor_plan as view
    from deltaid.view import show

    if print_list:
        if offers is not None:
            deltaid.load_offers(offers)
        print(read_text(offers) if offers else shipped_text(), end="")
        return
    require_outputs((robot, motion, offers, columns), {"--report": report})
    settings = deltaid.PlanSettings(
        torque_noise=torque_noise,
        rate=rate,
        duration=duration,
        prior_spread=prior_spread,
        gain_spread=gain_spread,
        enough=enough,
        steps=steps,
        seed=seed,
    )
    model = deltaid.load(robot)
    with used(model, force=force, as_prior=False), progress(as_json) as say:
        plan = deltaid.sensor_plan(
            model,
            motion,
            offers=offers,
            goal=goal,
            budget=budget,
            combinations=[names(text) for text in combine or ()],
            settings=settings,
            columns=columns,
            progress=say,
        )
    shown = view.chosen_entries(plan) if entries is None else names(entries)
    for name in shown:
        plan.entry(name)  # raises for an unknown one
    write_files((report, lambda path: show.report(plan, path, shown)))
    if not as_json:
        note_planned(plan.model)
    hidden, card = view.undetermined(plan), view.plan_card(plan)
    details = [
        f"planned for {plan.motion}, torque noise {percent(settings.torque_noise)} of each drive's "
        f"largest torque, {settings.rate:g} independent samples a second, prior "
        f"{percent(settings.prior_spread)}",
        *plan.notes,
    ]
    if hidden:
        details.append(f"nothing of the list determines much of {', '.join(hidden)}")
    now = DESCRIBED if plan.has_described else TORQUES
    still_open = [  # now, and with all purchases
        view.open_table(opening)
        for opening in plan.openings
        if opening.name in (now, PLAN) and opening.null.directions
    ]
    print_outcome(
        as_json,
        as_dictionary(plan),
        [
            card.title,
            *card.lines,
            "; ".join(f"{name}: {value}" for name, value in card.facts),
        ],
        [view.step_table(plan)] if plan.steps else [],
        [
            view.entry_table(plan),
            view.use_table(plan, shown),
            view.count_table(plan),
            *still_open,
        ],
        details,
        full=full,
        files=(report,),
    )


def as_dictionary(plan: "deltaid.SensorPlan") -> dict[str, Any]:
    u = plan.unknowns
    return {
        "robot": plan.model.robot.name,
        "motion": plan.motion,
        "goal": plan.goal_name,
        "currency": plan.offers.currency,
        "notes": list(plan.notes),
        "entries": [
            {"name": name, "prior": value, "unit": unit, "size": size, "std": spread}
            for name, value, unit, size, spread in zip(
                u.names, u.prior, u.units, u.sizes, u.spread, strict=True
            )
        ],
        "torques": _outlook(plan, plan.torques),
        "described": _outlook(plan, plan.described) if plan.has_described else None,
        "uses": [_outlook(plan, outlook) for outlook in plan.uses],
        "combinations": [_outlook(plan, outlook) for outlook in plan.combinations],
        "steps": [
            {
                "name": step.use.name,
                "cost": step.cost,
                "spent": step.spent,
                "gain": step.gain,
                "goal": outlook.goal,
                "std": _outlook(plan, outlook)["std"],
            }
            for step, outlook in plan.steps
        ],
        "open": [
            {
                "with": opening.name,
                "title": opening.title,
                "visible": opening.null.visible,
                "rank": opening.null.rank,
                "directions": [
                    {
                        "words": direction.words,
                        "entries": list(direction.entries),
                        "parted_by": list(parted),
                    }
                    for direction, parted in zip(
                        opening.null.directions, opening.parted, strict=True
                    )
                ],
            }
            for opening in plan.openings
        ],
    }


def _outlook(plan: "deltaid.SensorPlan", outlook: "Outlook") -> dict[str, Any]:
    return {
        "name": outlook.name,
        "title": outlook.title,
        "cost": outlook.cost,
        "gain": outlook.gain,
        "goal": outlook.goal,
        "std": dict(zip(plan.unknowns.names, outlook.shares, strict=True)),
    }
