"""`deltaid demo`: the whole job on a surrogate robot whose truth is known."""

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaid.cli.options import Full
from deltaid.cli.output import console, percent, progress
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
    full: Full = False,
) -> None:
    """Simulate a robot, record it, identify it, compare.

    Its parameters are known, and the recording is as a drive would make it.

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
    _print(result, keep, full)


def _print(result: "Demonstration", keep: Path | None, full: bool) -> None:
    from deltaid.cli.identified import Truth, print_result
    from deltaid.identification.demo import FILES

    truth = Truth(
        result.truth.tolist(),
        "Against the truth: mass matrix within "
        f"{percent(result.mass_error_diagonal)} on and {percent(result.mass_error_off_diagonal)} "
        f"off the diagonal, friction within {percent(result.friction_error)}; a single body's own "
        "numbers are less certain than what the drives feel of them.",
    )
    print_result(result.identification, result.verification, truth=truth, full=full)
    if keep is not None:
        files = f"{', '.join(FILES[:-1])} and {FILES[-1]}"
        console.print(f"{files} are in {keep}")
