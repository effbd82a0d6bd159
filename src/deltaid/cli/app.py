"""The `deltaid` command: its subcommands and what happens to errors."""

import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

import deltaid
from deltaid.cli import (
    calibrate,
    check,
    columns,
    control,
    drift,
    excite,
    export,
    fleet,
    gather,
    identify,
    look,
    new,
    online,
    reproduce,
    sensors,
    start,
    use,
    validate,
)
from deltaid.cli.output import print_error, print_note
from deltaid.cli.process import (
    EndedError,
    cleaning_up,
    limited_address_space,
    open_streams,
    written_output,
)
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
    "Start": (start.demo, start.studio, start.robots, new.new, columns.columns, check.check),
    "Identify": (
        excite.excite,
        sensors.sensors,
        calibrate.calibrate,
        identify.identify,
        validate.validate,
        use.sample,
    ),
    "Use": (
        use.torque,
        control.simulate,
        control.compare_controllers,
        use.forces,
        online.online,
        export.export,
    ),
    "Look": (look.show, look.base, look.schema, reproduce.reproduce),
    "Fleet": (gather.gather, fleet.fleet, drift.drift),
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
