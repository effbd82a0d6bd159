"""`deltaid sensors`: what scales, force plates and gauges would tell, and which are worth it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import output_file

if TYPE_CHECKING:
    from deltaid.sensors.planning.null_space import Opening
    from deltaid.sensors.planning.plan import Outlook, SensorPlan


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("sensors")(sensors)


def sensors(
    robot: Annotated[str, typer.Argument(help="Catalogue name, or a robot or model file.")],
    motion: Annotated[
        Path | None,
        typer.Argument(help="A planned motion or a recording; a random motion without one."),
    ] = None,
    goal: Annotated[
        str, typer.Option(help="bodies, the name of one body, forces or gains.")
    ] = "bodies",
    budget: Annotated[
        float | None, typer.Option(help="Most that all may cost, work included.")
    ] = None,
    offers: Annotated[
        Path | None,
        typer.Option("--sensors", help="List of what could be bought (YAML), for the shipped one."),
    ] = None,
    combine: Annotated[
        list[str] | None,
        typer.Option(help="Also try these together: kitchen-scale:S,edge:S; may be repeated."),
    ] = None,
    entries: Annotated[
        str | None, typer.Option(help="Entries to show, such as U.mcx,S.m,P.m.")
    ] = None,
    columns: Annotated[
        Path | None, typer.Option(help="Which column of MOTION is what, and its unit (YAML).")
    ] = None,
    torque_noise: Annotated[
        float, typer.Option(help="Torque noise, share of each drive's largest torque.")
    ] = 0.02,
    rate: Annotated[float, typer.Option(help="Independent samples a second.")] = 200.0,
    duration: Annotated[float, typer.Option(help="Of the random motion, in s.")] = 20.0,
    prior_spread: Annotated[
        float, typer.Option(help="Standard deviation of the prior, as a share of its values.")
    ] = 0.5,
    gain_spread: Annotated[
        float | None,
        typer.Option(help="Of torque constants, as a share. Default: 0, or 0.1 as the goal."),
    ] = None,
    enough: Annotated[
        float, typer.Option(help="Share of a value that is known well enough with.")
    ] = 0.01,
    steps: Annotated[int, typer.Option(help="Most things to buy.", min=0, max=100)] = 10,
    seed: Annotated[int, typer.Option(help="Seed of the random motion.", min=0)] = 0,
    print_list: Annotated[
        bool, typer.Option("--list", help="Print the list of what could be bought and stop.")
    ] = False,
    report: Annotated[
        Path | None, output_file(help="HTML page with figures and tables, works offline.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """What torques leave open of a robot's bodies, what would close it, and at which price.

    Nothing is measured: standard deviations are predicted for a motion, a noise and a prior.
    """
    from deltaid.cli.output import console, print_json, print_note, progress, require_outputs
    from deltaid.errors import positive, within
    from deltaid.recording.mapping import load_mapping
    from deltaid.robot.load import read_text
    from deltaid.sensors.planning.offers import shipped_text
    from deltaid.sensors.planning.plan import PlanSettings, sensor_plan

    if print_list:
        print(read_text(offers) if offers else shipped_text(), end="")
        return
    positive("--budget", budget, (1e-9, 1e12))
    positive("--torque-noise", torque_noise, (1e-9, 10.0))
    positive("--rate", rate, (1e-3, 1e6))
    positive("--duration", duration, (0.1, 36_000.0))
    positive("--prior-spread", prior_spread, (1e-6, 1e3))
    positive("--enough", enough, (1e-9, 1.0))
    if gain_spread is not None:
        within("--gain-spread", gain_spread, (0.0, 10.0))
    inputs = [path for path in (Path(robot), motion, offers, columns) if path]
    require_outputs(inputs, {}, report)
    settings = PlanSettings(
        torque_noise=torque_noise,
        rate=rate,
        duration=duration,
        prior_spread=prior_spread,
        gain_spread=gain_spread,
        enough=enough,
        steps=steps,
        seed=seed,
    )
    mapping = load_mapping(columns) if columns else None
    with progress(as_json) as say:
        plan = sensor_plan(
            robot,
            motion,
            offers=offers,
            goal=goal,
            budget=budget,
            combinations=[_names(text) for text in combine or ()],
            settings=settings,
            columns=mapping,
            progress=say,
        )
    shown = _shown(plan, entries)
    if report is not None:
        from deltaid.view.html import write_page
        from deltaid.view.sensors import sensors_page

        write_page(sensors_page(plan, shown), report)
    if as_json:
        print_json(as_dictionary(plan))
        return
    if plan.model.identified is not None:
        print_note(f"{plan.model.source} is a model: planned with its masses and friction")
    _print(plan, shown)
    if report is not None:
        console.print(f"wrote {report}")


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _shown(plan: "SensorPlan", entries: str | None) -> tuple[str, ...]:
    """Entries of the table of uses.

    Raises:
        DeltaidError: there is none of a name.
    """
    from deltaid.view.sensor_plan import chosen_entries

    if entries is None:
        return chosen_entries(plan)
    names = _names(entries)
    for name in names:
        plan.entry(name)
    return names


def _print(plan: "SensorPlan", entries: tuple[str, ...]) -> None:
    from deltaid.cli.output import console, shown, styled
    from deltaid.view.sensor_plan import (
        count_table,
        entry_table,
        open_lines,
        step_table,
        stopped,
        untold,
        use_table,
    )

    console.print(styled(plan.model.robot.title or plan.model.robot.name))
    console.print(f"planned for {plan.motion}, {assumptions(plan)}")
    for note in plan.notes:
        console.print(note)
    console.print()
    console.print(shown(entry_table(plan)))
    if hidden := untold(plan):
        console.print(f"nothing of the list tells much of {', '.join(hidden)}")
    console.print()
    console.print(shown(use_table(plan, entries)))
    console.print()
    if plan.steps:
        console.print(shown(step_table(plan)))
        console.print(stopped(plan))
    else:
        console.print(f"nothing of the list is worth buying for {plan.goal}")
    console.print()
    console.print(shown(count_table(plan)))
    for one in told(plan):
        if one.null.directions:
            console.print()
            console.print(styled(f"what stays open, {one.title}"))
            for line in open_lines(one):
                console.print(f"  {line}")


def told(plan: "SensorPlan") -> "list[Opening]":
    """What is told in words: what there is, and what stays open when all has been bought."""
    from deltaid.sensors.planning.null_space import DESCRIBED, PLAN, TORQUES

    now = DESCRIBED if plan.has_described else TORQUES
    return [one for one in plan.openings if one.name in (now, PLAN)]


def assumptions(plan: "SensorPlan") -> str:
    """Noise and prior in words."""
    from deltaid.view.numbers import percent

    s = plan.settings
    return (
        f"torque noise {percent(s.torque_noise)} of each drive's largest torque, {s.rate:g} "
        f"independent samples a second, prior {percent(s.prior_spread)}"
    )


def as_dictionary(plan: "SensorPlan") -> dict[str, Any]:
    """The plan as one JSON object."""
    u = plan.unknowns
    return {
        "robot": plan.model.robot.name,
        "motion": plan.motion,
        "goal": plan.goal_name,
        "currency": plan.offers.currency,
        "notes": list(plan.notes),
        "entries": [
            {"name": name, "prior": float(value), "unit": unit, "size": float(size), "std": spread}
            for name, value, unit, size, spread in zip(
                u.names, u.prior, u.units, u.sizes, u.spread.tolist(), strict=True
            )
        ],
        "torques": _outlook(plan, plan.torques),
        "described": _outlook(plan, plan.described) if plan.has_described else None,
        "uses": [_outlook(plan, one) for one in plan.uses],
        "combinations": [_outlook(plan, one) for one in plan.combinations],
        "steps": [
            {
                "name": step.use.name,
                "cost": step.cost,
                "spent": step.spent,
                "gain": step.gain,
                "goal": outlook.goal,
                "std": _stds(plan, outlook),
            }
            for step, outlook in plan.steps
        ],
        "open": [
            {
                "with": one.name,
                "title": one.title,
                "seen": one.null.visible,
                "told": one.null.rank,
                "directions": [
                    {
                        "words": open_.words,
                        "entries": list(open_.entries),
                        "parted_by": list(parted),
                    }
                    for open_, parted in zip(one.null.directions, one.parted, strict=True)
                ],
            }
            for one in plan.openings
        ],
    }


def _outlook(plan: "SensorPlan", one: "Outlook") -> dict[str, Any]:
    return {
        "name": one.name,
        "title": one.title,
        "cost": one.cost,
        "gain": one.gain,
        "goal": one.goal,
        "std": _stds(plan, one),
    }


def _stds(plan: "SensorPlan", one: "Outlook") -> dict[str, float]:
    """Standard deviation of each entry as a share of its size."""
    return dict(zip(plan.unknowns.names, one.shares.tolist(), strict=True))
