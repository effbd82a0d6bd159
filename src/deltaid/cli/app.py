"""The `deltaid` command: its subcommands and what happens to errors."""

import io
import signal
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

import typer

from deltaid.cli import (
    base,
    calibrate,
    check,
    columns,
    compare_controllers,
    demo,
    drift,
    excite,
    export,
    fleet,
    forces,
    gather,
    identify,
    new,
    online,
    reproduce,
    robots,
    sample,
    schema,
    sensors,
    show,
    simulate,
    studio,
    torque,
    validate,
)
from deltaid.cli.address_space import limited_address_space
from deltaid.cli.output import print_error, print_note
from deltaid.cli.streams import open_closed_streams, written_output
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
# In the order of `--help`; each module has a function of its own name.
COMMANDS = {
    "Start": (demo, studio, robots, new, columns, check),
    "Identify": (excite, sensors, calibrate, identify, validate, sample),
    "Use": (torque, simulate, compare_controllers, forces, online, export),
    "Look": (show, base, schema, reproduce),
    "Fleet": (gather, fleet, drift),
}
for group, modules in COMMANDS.items():
    for module in modules:
        name = module.__name__.rpartition(".")[2]
        app.command(name.replace("_", "-"), rich_help_panel=group)(getattr(module, name))


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
        from deltaid.mechanism.user_code import use_mechanism

        use_mechanism(mechanism)
    if version:
        from importlib.metadata import version as installed

        typer.echo(f"deltaid {installed('deltaid')}")
        raise typer.Exit


def main() -> None:
    """Entry point. Exit code 0 when done, 2 when the user has something to mend."""
    open_closed_streams()
    _speak_unicode()
    try:
        with limited_address_space(), _cleaning_up(), written_output():
            app(prog_name="deltaid")
    except DeltaidError as error:
        with suppress(OSError):  # the code says it too
            print_error(error)
        sys.exit(2)
    except _EndedError as ended:
        with suppress(OSError):  # the terminal may be gone
            print_note(f"ended by {signal.Signals(ended.number).name}; no file is half-written")
        sys.exit(128 + ended.number)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        sys.exit(0)


class _EndedError(BaseException):
    """A signal asks the process to end."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def _cleaning_up() -> Generator[None, None, None]:
    """Leave by the way of errors when told to end, so that no half-written file stays."""

    def on_end(number: int, frame: object) -> None:
        raise _EndedError(number)

    names = ("SIGTERM", "SIGHUP") if threading.current_thread() is threading.main_thread() else ()
    signals = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.signal(number, on_end) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _speak_unicode() -> None:
    """Write UTF-8 into files and pipes, and to terminals at least no error over a Greek letter.

    Windows would choose a code page without γ for them, and YAML and JSON are UTF-8 anyway.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            encoding = stream.encoding if stream.isatty() else "utf-8"
            stream.reconfigure(encoding=encoding, errors="replace")
