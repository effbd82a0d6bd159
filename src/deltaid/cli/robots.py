"""`deltaid robots`: the shipped catalogue."""

from typing import TYPE_CHECKING, Annotated

import typer

from deltaid.cli.output import console, table

if TYPE_CHECKING:
    from deltaid.robot.description import RobotDescription


def robots(
    name: Annotated[str | None, typer.Argument(help="Print this robot's description file.")] = None,
) -> None:
    """List catalogue robots, or print one to start from."""
    from deltaid.robot.load import catalogue, catalogue_text, load_robot

    if name is not None:
        typer.echo(catalogue_text(name))
        return
    rows = []
    for robot_name in catalogue():
        robot = load_robot(robot_name)
        free = sum(len(body.free) for body in robot.bodies.values())
        variables = free + len(robot.friction_terms) + len(robot.spring_joints)
        variables += len(robot.rotor_drives)
        rows.append([robot_name, robot.title, _class(robot), str(variables)])
    console.print(table("", ["name", "robot", "mechanism", "free"], rows))
    console.print("\nfree: parameters that a fit may change.")
    console.print("`deltaid robots NAME > my-robot.yaml` writes one as a start for your own.")


def _class(robot: "RobotDescription") -> str:
    """What a mechanism is composed of: limbs, platform, telescope."""
    limbs = [limb.drive for limb in robot.limb_geometry]
    parts = [f"{limbs.count(kind)} {kind}" for kind in dict.fromkeys(limbs)]
    parts += [robot.platform.kind] if robot.platform_turns else []
    parts += ["telescope"] if robot.telescope else []
    return ", ".join(parts)
