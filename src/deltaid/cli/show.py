"""`deltaid show`: a robot to look at, as tables, as a page, or live in a browser."""

import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaid.cli.options import output_file

if TYPE_CHECKING:
    from deltaid.dynamics.at_rest import AtRest

# Seconds. A wait without end may not wake up for Ctrl-C while a server's thread runs.
_LOOK = 0.5


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("show")(show)


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
        typer.Option(help="Port of the live view. Default: 8080, or the next that is free."),
    ] = None,
) -> None:
    """Show a robot at rest: what it can reach, which limits end that, condition, holding torques.

    Without options it prints tables.
    """
    from deltaid.cli.output import progress, require_report
    from deltaid.dynamics.at_rest import AtRest
    from deltaid.model.model import load
    from deltaid.view.reach import require_space

    if report is not None:
        require_report(report, [Path(robot)])
    if live:
        _require_live(port)
    model = load(robot)
    require_space(model.robot)
    with progress(False) as say:
        say("compiling")
        at_rest = AtRest(model.dynamics, model.p)
    if report is not None or not live:
        known = "identified" if model.identified else "prior"
        survey_of(at_rest, report, f"Robot at rest, with its {known} parameters")
    if live:
        _open(at_rest, port)


def _require_live(port: int | None) -> None:
    from deltaid.errors import DeltaidError
    from deltaid.view.live import require_port, require_viser

    require_viser()
    if port is not None:
        if not 0 <= port <= 65535:
            raise DeltaidError(f"must lie between 0 and 65535, not {port}", where="--port")
        require_port(port)


def survey_of(robot: "AtRest", report: Path | None, origin: str) -> None:
    """A robot at rest, as a page or as tables."""
    from deltaid.cli.output import console, print_warnings, styled, table
    from deltaid.view import robot_page as page
    from deltaid.view.html import write_page
    from deltaid.view.reach import reach, survey

    found, surveyed = reach(robot), survey(robot)
    if report is not None:
        write_page(page.robot_page(robot, found, surveyed, origin), report)
        console.print(f"wrote {report}")
        return
    print_warnings(page.warnings(robot, surveyed))
    console.print(styled(robot.robot.title or robot.robot.name))
    for fact in page.facts(robot, found, surveyed):
        console.print(f"{fact.label}: {fact.value}" + (f" ({fact.note})" if fact.note else ""))
    for title, part in (
        ("Drives", page.drive_table(robot, surveyed)),
        ("Limits in the workspace", page.use_table(robot, surveyed)),
        ("What ends ways from home", page.end_table(robot, found)),
    ):
        console.print()
        console.print(table(title, part.columns, part.rows))


def _open(robot: "AtRest", port: int | None) -> None:
    from deltaid.cli.output import console
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
