"""`deltaid studio`: a page that guides from a robot and its recordings to a model."""

from pathlib import Path
from typing import Annotated

import typer

from deltaid.cli.output import console


def studio(
    folder: Annotated[
        Path, typer.Argument(help="Where robot, recordings and models lie; made if missing.")
    ] = Path(),
    port: Annotated[
        int | None,
        typer.Option(
            help="Port on this machine; 0 for any. Default: 8090, or the next one.",
            min=0,
            max=65535,
        ),
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open a browser.")] = True,
) -> None:
    """Work in a browser, on this machine only.

    Robot, recording, check, fit, result, use.

    Everything stays in FOLDER, in the files that the other commands read and write.
    """
    from deltaid.studio.server import PORTS, require_nicegui, serve
    from deltaid.view.own_page import free_port

    require_nicegui()
    opened = False

    def say(address: str) -> None:
        nonlocal opened
        at = f"in another browser: {address}" if opened else f"{folder.resolve()} at {address}"
        console.print(f"{at} until Ctrl-C", soft_wrap=True)
        console.file.flush()
        opened = True

    try:
        serve(folder, free_port(PORTS if port is None else (port,)), show=browser, say=say)
    except KeyboardInterrupt:
        console.print("closed")
