"""`deltaid base`: which combinations of parameters torques can tell."""

from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("base")(base)


def base(
    robot: Annotated[str, typer.Argument(help="Catalogue name or YAML file of the robot.")],
    seed: Annotated[int, typer.Option(help="Seed of the random motion.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List the base parameters of a robot as formulas, found from a random motion."""
    import numpy as np

    from deltaid.cli.output import console, print_json
    from deltaid.dynamics.dynamics import Dynamics
    from deltaid.excitation.random_motion import random_motion
    from deltaid.identification.base import base_parameters
    from deltaid.identification.information import gather_samples
    from deltaid.identification.reduction import build_reduction
    from deltaid.robot.load import load_robot

    description = load_robot(robot)
    dynamics = Dynamics(description)
    motion = random_motion(dynamics.kinematics, np.random.default_rng(seed))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, 2000))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    information = gather_samples(dynamics, z, qd, qdd, np.zeros_like(z))
    result = base_parameters(information, dynamics.layout)
    invisible = [dynamics.layout.names[i] for i in result.invisible]
    variables = build_reduction(description, information.columns).size
    if as_json:
        print_json(
            {
                "robot": description.name,
                "columns": len(dynamics.layout.names),
                "nonzero_columns": len(dynamics.layout.names) - len(invisible),
                "base_parameters": result.rank,
                "optimization_variables": variables,
                "condition": result.condition,
                "groups": list(result.formulas),
                "invisible": invisible,
            }
        )
        return
    console.print(f"[bold]{description.title or description.name}[/]")
    console.print(
        f"{len(dynamics.layout.names)} parameters, {len(dynamics.layout.names) - len(invisible)} "
        f"visible in torques, {result.rank} base parameters; {variables} free in a consistent fit"
    )
    for i, formula in enumerate(result.formulas):
        console.print(f"{i + 1:4d}  {formula}")
    console.print(f"not visible in any torque: {', '.join(invisible)}")
