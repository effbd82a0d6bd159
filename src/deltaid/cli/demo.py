"""`deltaid demo`: the whole job on a surrogate robot whose truth is known."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaid.cli.output import console, percent, print_tables, progress, styled
from deltaid.files import require_writable, together, write_bytes

if TYPE_CHECKING:
    from deltaid.identification.demo import Demonstration


def demo(
    robot: Annotated[str, typer.Argument(help="Catalogue name or YAML file.")] = "irb360-6-1600",
    seed: Annotated[int, typer.Option(help="Seed of truth, motions and noise.", min=0)] = 0,
    noise: Annotated[
        float, typer.Option(help="Torque noise as a share of the largest torque.", min=0, max=1)
    ] = 0.02,
    keep: Annotated[
        Path | None, typer.Option(help="Folder to keep robot, logs and model in.")
    ] = None,
) -> None:
    """Simulate a robot with known parameters, record it as a drive would, and identify it.

    The truth is up to 30 % away from the prior; the log has encoder steps and torque noise. The
    motions keep the robot's limits.
    """
    from deltaid.identification.demo import FILES, demonstrate
    from deltaid.robot.load import load_robot

    description = load_robot(robot)
    if keep is not None:
        for name in FILES:
            require_writable(keep / name)
    with tempfile.TemporaryDirectory() as temporary, progress(False) as say:
        folder = Path(temporary)
        result = demonstrate(description, folder, seed=seed, torque_noise=noise, progress=say)
        if keep is not None:
            with together():
                for name in FILES:
                    write_bytes(keep / name, (folder / name).read_bytes())
    _print(result, keep)


def _print(result: "Demonstration", keep: Path | None) -> None:
    from deltaid.cli.identified import summary
    from deltaid.identification.demo import FILES
    from deltaid.model.model import load
    from deltaid.view.model_tables import error_table, parameter_table

    model = result.identification.model
    parameters = parameter_table(model, result.truth.tolist())
    parameters = replace(parameters, title=f"{parameters.title}, simulated")
    print_tables(parameters, error_table(load(model), result.verification))
    for line in summary(result.identification):
        console.print(line)
    console.print(
        styled("against the truth:"),
        "mass matrix within "
        f"{percent(result.mass_error_diagonal)} on and {percent(result.mass_error_off_diagonal)} "
        f"off the diagonal, friction within {percent(result.friction_error)}; a single body's own "
        "numbers are less certain than what the drives feel of them",
    )
    if keep is not None:
        files = f"{', '.join(FILES[:-1])} and {FILES[-1]}"
        console.print(f"{files} are in {keep}")
