"""`deltaid demo`, `studio` and `robots`: first steps without a recording."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

import deltaid
from deltaid.cli.options import Full
from deltaid.cli.output import Finished, console, progress, table
from deltaid.files import require_writable, together, write_bytes
from deltaid.levels import TORQUE_NOISE
from deltaid.libraries import require
from deltaid.view.numbers import percent


def demo(
    robot: Annotated[str, typer.Argument(help="Catalogue name or robot file.")] = "irb360-6-1600",
    seed: Annotated[
        int, typer.Option(help="Seed of the true parameters, motions and noise.", min=0)
    ] = 0,
    noise: Annotated[
        float, typer.Option(help="Torque noise as a share of the largest torque.", min=0, max=1)
    ] = TORQUE_NOISE,
    keep: Annotated[
        Path | None,
        typer.Option(help="Folder to write robot, recordings and model into. Default: none."),
    ] = None,
    full: Full = False,
) -> None:
    """Simulate a robot, record it, identify it, compare.

    The true parameters are known, and the recording resembles that of a real drive.

    The true parameters differ from the prior by up to 30 %; the recording has encoder steps and
    torque noise. The motions stay within the robot's limits.
    """
    from deltaid.cli.identified import print_result
    from deltaid.identification.demo import FILES, demonstrate

    description = deltaid.load_robot(robot)
    kept = [] if keep is None else [keep / name for name in FILES]
    for path in kept:
        require_writable(path)
    with tempfile.TemporaryDirectory() as temporary, progress(False) as say:
        folder = Path(temporary)
        result = demonstrate(description, folder, seed=seed, torque_noise=noise, progress=say)
        with together():
            for path in kept:
                write_bytes(path, (folder / path.name).read_bytes())
    against = (
        "Against the truth: mass matrix within "
        f"{percent(result.mass_error_diagonal)} on and {percent(result.mass_error_off_diagonal)} "
        f"off the diagonal, friction within {percent(result.friction_error)}; a single body's own "
        "numbers are less certain than the torques they cause."
    )
    print_result(
        result.identification, result.verification,
        truth=result.truth.tolist(), against=against, full=full,
    )  # fmt: skip
    if kept:
        console.print(f"{', '.join(FILES[:-1])} and {FILES[-1]} are in {keep}")


def studio(
    folder: Annotated[
        Path, typer.Argument(help="Folder of robot, recordings and models; created if missing.")
    ] = Path(),
    port: Annotated[
        int | None,
        typer.Option(
            help="Port on this machine; 0 for any. Default: 8090, or the next free one.",
            min=0,
            max=65535,
        ),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
) -> None:
    """Work in a browser, on this machine only.

    The stages are robot, recording, check, fit, result and use.

    All files are in FOLDER; the other commands read and write the same files.
    """
    require(
        "nicegui",
        by="deltaid studio",
        name="NiceGUI",
        install="pip install '.[studio]' in a clone of deltaid, or pip install 'nicegui>=3'",
    )
    from deltaid.studio.server import PORTS, serve
    from deltaid.view.own_page import free_port

    opened = list[str]()

    def say(address: str) -> None:
        at = f"in another browser: {address}" if opened else f"{folder.resolve()} at {address}"
        console.print(f"{at} until Ctrl-C", soft_wrap=True)
        console.file.flush()
        opened.append(address)

    try:
        serve(folder, free_port(PORTS if port is None else (port,)), show=browser, say=say)
    except KeyboardInterrupt:
        console.print("closed")


def robots(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Catalogue name of a robot whose file to print. Default: list all robots."
        ),
    ] = None,
) -> None:
    """List catalogue robots, or print one to start from."""
    from deltaid.robot.load import catalogue_text

    if name is not None:
        typer.echo(catalogue_text(name))
        return
    rows = list[tuple[str, ...]]()
    for robot in map(deltaid.load_robot, deltaid.catalogue()):
        free = sum(len(body.free) for body in robot.bodies.values())
        joints = (robot.friction_terms, robot.spring_joints, robot.rotor_drives)
        variables = free + sum(map(len, joints))
        rows.append((robot.name, robot.title, _mechanism(robot), str(variables)))
    console.print(table(Finished(("name", "robot", "mechanism", "free"), tuple(rows))))
    console.print("\nfree: parameters that a fit may change.")
    console.print("`deltaid robots NAME > my-robot.yaml` writes one as a start for your own.")


def _mechanism(robot: "deltaid.RobotDescription") -> str:
    limbs = [limb.drive for limb in robot.limb_geometry]
    parts = [f"{limbs.count(kind)} {kind}" for kind in dict.fromkeys(limbs)]
    parts += [robot.platform.kind] if robot.platform_turns else []
    parts += ["telescope"] if robot.telescope else []
    return ", ".join(parts)
