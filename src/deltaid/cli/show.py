"""`deltaid show`: a robot to look at, as tables, as a page, or live in a browser."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaid.cli.options import Full, bounded, output_file
from deltaid.cli.output import (
    console,
    judged,
    print_warnings,
    print_written,
    progress,
    require_outputs,
)
from deltaid.cli.screen import print_found

if TYPE_CHECKING:
    from deltaid.dynamics.at_rest import AtRest
    from deltaid.view.reach import Reach, WorkspaceSurvey

# Seconds. A wait without end may not wake up for Ctrl-C while a server's thread runs.
_LOOK = 0.5


def show(
    robot: Annotated[
        str, typer.Argument(help="Catalogue name or YAML file of the robot, or a saved model.")
    ],
    report: Annotated[
        Path | None,
        output_file("--report", "-o", help="HTML page: picture, workspace, reach, condition."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Open a view in which one drags the platform.")
    ] = False,
    port: Annotated[
        int | None,
        bounded(
            help="Port of the live view. Default: 8080, or the next that is free.",
            limits=(0, 65535),
        ),
    ] = None,
    full: Full = False,
) -> None:
    """Show a robot's workspace, limits and holding torques.

    What it can reach, which limits end that, condition, torques at rest.

    Without options it prints tables.
    """
    from deltaid.dynamics.at_rest import AtRest
    from deltaid.model.model import load
    from deltaid.view.reach import require_space

    require_outputs([robot], {"--report": report})
    if live:
        from deltaid.view.live import require_viser
        from deltaid.view.own_page import free_port

        require_viser()
        if port is not None:
            free_port((port,))
    model = load(robot)
    require_space(model.robot)
    with judged(model, force=True), progress(False) as say:
        say("compiling")
        at_rest = AtRest(model.dynamics, model.p)
    if report is not None:
        known = "identified" if model.identified else "prior"
        robot_report(at_rest, report, f"Robot at rest, with its {known} parameters")
    elif not live:
        print_survey(at_rest, full=full)
    if live:
        _open(at_rest, port)


def robot_report(robot: "AtRest", path: Path, origin: str) -> None:
    """Write the page of a robot at rest, whose parameters are of that origin."""
    from deltaid.view.html import write_page
    from deltaid.view.reach import reach, survey
    from deltaid.view.robots import rest_page

    write_page(rest_page(robot, reach(robot), survey(robot), origin), path)
    print_written(path)


def print_survey(robot: "AtRest", *, full: bool = False) -> None:
    """Facts and tables of a robot at rest."""
    from deltaid.view import robots
    from deltaid.view.reach import reach, survey

    reached, surveyed = reach(robot), survey(robot)
    print_warnings(robots.rest_warnings(robot, surveyed))
    uses, ends = robots.use_table(robot, surveyed), robots.end_table(robot, reached)
    drives = robots.rest_table(robot, surveyed).without("held at home")
    print_found(
        fact_lines(robot, reached, surveyed),
        [
            replace(drives, title="drives"),
            replace(uses, title="limits in the workspace"),
            replace(ends, title="limits that end straight moves from home"),
        ],
        full=full,
    )


def fact_lines(robot: "AtRest", reached: "Reach", surveyed: "WorkspaceSurvey") -> list[str]:
    """A robot's title and its figures at rest, a line each."""
    from deltaid.view.robots import rest_facts

    return [
        robot.robot.title or robot.robot.name,
        *(
            f"{fact.label}: {fact.value}" + (f" ({fact.note})" if fact.note else "")
            for fact in rest_facts(robot, reached, surveyed)
        ),
    ]


def _open(robot: "AtRest", port: int | None) -> None:
    from deltaid.view.live import DEFAULT_PORT, LiveView

    live = LiveView(robot, DEFAULT_PORT if port is None else port)
    try:
        console.print(f"{robot.robot.name} is shown at {live.url} until Ctrl-C")
        closed = threading.Event()
        while not closed.wait(_LOOK):
            pass
    except KeyboardInterrupt:
        console.print("closed")
    finally:
        live.close()
