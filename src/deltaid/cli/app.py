"""The `deltaid` command: its subcommands, error handling, and the process.

Streams may be closed, full, or have lost their reader. Under a low limit of address space, as
`ulimit -v` sets it, libraries that get no memory abort the process, or try again for ever, and no
exception ever arrives; so they are not loaded.
"""

import errno
import os
import signal
import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from inspect import cleandoc
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated

import typer

import deltaid
from deltaid.cli import (
    calibrate,
    check,
    control,
    excite,
    export,
    fleet,
    gather,
    identify,
    look,
    new,
    sensors,
    start,
    use,
)
from deltaid.cli.output import remark
from deltaid.errors import DeltaidError
from deltaid.files import handling_signals

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
    "Start": (start.demo, start.studio, start.robots, new.new, check.columns, check.check),
    "Identify": (
        excite.excite,
        sensors.sensors,
        calibrate.calibrate,
        identify.identify,
        identify.validate,
        use.sample,
    ),
    "Use": (
        use.torque,
        control.simulate,
        control.compare_controllers,
        use.forces,
        export.online,
        export.export,
    ),
    "Look": (look.show, look.base, look.schema, look.reproduce),
    "Fleet": (gather.gather, fleet.fleet, gather.drift),
}


def _paragraphs(text: str) -> str:
    """Each paragraph as one line: the terminal would keep line breaks of the source."""
    return "\n\n".join(" ".join(part.split()) for part in cleandoc(text).split("\n\n"))


for group, commands in COMMANDS.items():
    for command in commands:
        name, text = command.__name__.replace("_", "-"), _paragraphs(command.__doc__ or "")
        app.command(name, help=text, rich_help_panel=group)(command)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
    mechanism: Annotated[
        Path | None,
        typer.Option(
            help="Python file with the geometry of a mechanism of your own. deltaid runs it."
        ),
    ] = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Compile all code again, and do not cache it.")
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


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
# Address space [B] that `identify` and `torque` need on 1,500 rows with 2 to 8 threads, for
# libraries and the stacks and heaps of threads; 1.4e9 on one core.
_NEEDED = 1.9e9
# Libraries that retry for ever if they get no threads or memory.
_WITH_THREADS = ("polars", "scipy")
# Address space that NumPy needs to load [B].
_LEAST = 4e8


def _open_streams() -> None:
    """Replace closed streams by the null device, because the next opened file would take their
    place.

    Files and pipes get UTF-8, as YAML and JSON require: on Windows the default code page has no γ.
    Terminals keep their encoding, with a replacement for unknown characters.
    """
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, "w" if descriptor else "r", encoding="utf-8")  # noqa: SIM115
            if stream.fileno() != descriptor and sys.platform != "win32":
                os.dup2(stream.fileno(), descriptor)
            setattr(sys, name, stream)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            encoding = stream.encoding if stream.isatty() else "utf-8"
            stream.reconfigure(encoding=encoding, errors="replace")


@contextmanager
def _written_output() -> Generator[None, None, None]:
    """Flush standard output at the end of the block.

    Raises:
        DeltaidError: it cannot be written.
        BrokenPipeError: its reader has closed it.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except OSError as error:
        is_unread = isinstance(error, BrokenPipeError)
        if not is_unread and (error.errno not in _FULL or error.filename is not None):
            raise
        with suppress(OSError):  # Python would write the rest again when it exits
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if is_unread:
            raise
        raise DeltaidError(
            f"cannot be written: {error.strerror}",
            where="standard output",
            cure="check the space left, or send it elsewhere; files that were asked for may be "
            "complete",
        ) from None


class EndedError(BaseException):
    """Request to end the process by a signal; its argument is the signal's number."""


@contextmanager
def _cleaning_up() -> Generator[None, None, None]:
    """Turn signals that end the process into an exception, so that no half-written file remains."""

    def on_end(number: int, frame: object) -> None:
        raise EndedError(number)

    with handling_signals(on_end, "SIGTERM", "SIGHUP"):
        yield


def _keep_to_address_space() -> None:
    """Prevent imports that fail under a low limit of address space.

    Raises:
        DeltaidError: it is too low for any command; or later, when a library with threads loads.
    """
    if sys.platform != "linux":  # other systems have no such limit
        return
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY or limit >= _NEEDED:
        return
    refusal = DeltaidError(
        "too little for this command",
        where=f"address space limited to {limit / 1e9:.2g} GB",
        cure=f"`ulimit -v unlimited`, or at least twice the {_NEEDED / 1e9:.2g} GB that "
        "libraries and threads take; long recordings need little more",
    )
    if limit < _LEAST:
        raise refusal
    sys.meta_path.insert(0, _Refusal(refusal))


class _Refusal:
    """An import hook that refuses libraries which would retry for ever."""

    def __init__(self, error: DeltaidError) -> None:
        self.error = error

    def find_spec(self, name: str, path: object, target: object = None) -> None:
        """Refuse a module, or return None so that the next finder handles it.

        Raises:
            DeltaidError: the module is one of these libraries.
        """
        if name in _WITH_THREADS:
            raise self.error


def _refuse_empty(words: Sequence[str]) -> None:
    """Refuse an empty name: as a path it is the current folder, and as the value of an option that
    takes a list it is none.

    Raises:
        DeltaidError: names the option, or what stands before the empty word.
    """
    for before, word in zip(["deltaid", *words], words, strict=False):
        option, given, value = word.partition("=") if word.startswith("--") else (before, "=", word)
        if given and not value.strip():
            raise DeltaidError(
                "nothing is given",
                where=f"{option} ''",
                cure="is a variable of the shell empty? give a name; . is this folder",
            )


def main() -> None:
    """Entry point. Exit code 0 when done, 2 when the user has something to fix."""
    _open_streams()
    try:
        _keep_to_address_space()
        with _cleaning_up(), _written_output():
            _refuse_empty(sys.argv[1:])
            app(prog_name="deltaid")
    except DeltaidError as error:
        with suppress(OSError):  # the exit code is the same
            remark("error", error)
        sys.exit(2)
    except EndedError as ended:
        with suppress(OSError):  # the terminal may be closed
            name = signal.Signals(ended.args[0]).name
            remark("note", f"ended by {name}; no file is half-written")
        sys.exit(128 + ended.args[0])
    except BrokenPipeError:  # the reader of a pipe closed it
        sys.exit(0)
