"""The `deltaid` command: its subcommands and what happens to errors."""

import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

import deltaid
from deltaid.cli.calibrate import calibrate
from deltaid.cli.check import check
from deltaid.cli.columns import columns
from deltaid.cli.control import compare_controllers, simulate
from deltaid.cli.drift import drift
from deltaid.cli.excite import excite
from deltaid.cli.export import export
from deltaid.cli.fleet import fleet
from deltaid.cli.gather import gather
from deltaid.cli.identify import identify
from deltaid.cli.look import base, schema, show
from deltaid.cli.new import new
from deltaid.cli.online import online
from deltaid.cli.output import print_error, print_note
from deltaid.cli.process import (
    EndedError,
    cleaning_up,
    limited_address_space,
    open_streams,
    written_output,
)
from deltaid.cli.reproduce import reproduce
from deltaid.cli.sensors import sensors
from deltaid.cli.start import demo, robots, studio
from deltaid.cli.use import forces, sample, torque
from deltaid.cli.validate import validate
from deltaid.errors import DeltaidError

app = typer.Typer(
    name="deltaid",
    help="Physically consistent dynamic models of Delta-like robots, identified from recordings.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    add_completion=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# In the order of `--help`.
COMMANDS = {
    "Start": (demo, studio, robots, new, columns, check),
    "Identify": (excite, sensors, calibrate, identify, validate, sample),
    "Use": (torque, simulate, compare_controllers, forces, online, export),
    "Look": (show, base, schema, reproduce),
    "Fleet": (gather, fleet, drift),
}
for group, commands in COMMANDS.items():
    for command in commands:
        app.command(command.__name__.replace("_", "-"), rich_help_panel=group)(command)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
    mechanism: Annotated[
        Path | None,
        typer.Option(help="Python file with the geometry of a mechanism of your own; it is run."),
    ] = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Compile all code anew and keep none of it.")
    ] = False,
) -> None:
    if no_cache:
        from deltaid.kernel.store import switch_off

        switch_off()
    if mechanism is not None:
        deltaid.use_mechanism(mechanism)
    if version:
        typer.echo(f"deltaid {deltaid.__version__}")
        raise typer.Exit


def main() -> None:
    """Entry point. Exit code 0 when done, 2 when the user has something to mend."""
    open_streams()
    try:
        with limited_address_space(), cleaning_up(), written_output():
            app(prog_name="deltaid")
    except DeltaidError as error:
        with suppress(OSError):  # the code says it too
            print_error(error)
        sys.exit(2)
    except EndedError as ended:
        with suppress(OSError):  # the terminal may be gone
            print_note(f"ended by {signal.Signals(ended.number).name}; no file is half-written")
        sys.exit(128 + ended.number)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        sys.exit(0)
