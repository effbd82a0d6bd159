"""`deltaid robots`: the shipped catalogue."""

from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("robots")(robots)


def robots(
    name: Annotated[str | None, typer.Argument(help="Print this robot's description file.")] = None,
) -> None:
    """List the robots that come with deltaid, or print the description of one to start from."""
    from deltaid.cli.output import console, table
    from deltaid.robot.load import catalogue, catalogue_text, load_robot

    if name is not None:
        typer.echo(catalogue_text(name))
        return
    rows = []
    for robot_name in catalogue():
        robot = load_robot(robot_name)
        free = sum(len(body.free) for body in robot.bodies.values())
        variables = free + len(robot.friction_terms) + len(robot.rotor_drives)
        rows.append([robot_name, robot.title, str(len(robot.drives)), str(variables)])
    console.print(table("", ["name", "robot", "drives", "free parameters"], rows))
    console.print("\n`deltaid robots NAME > my-robot.yaml` writes one as a start for your own.")
