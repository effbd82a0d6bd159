"""The process of a command: its streams, how it is ended, and its limit of address space.

Streams may be closed, full, or have lost their reader. Under a limit of address space, as
`ulimit -v` sets it, libraries that get no memory abort the process, end it, or try again for ever,
and no exception ever arrives. So the command runs in a child process, and its parent, which loads
none of them, says what happened.
"""

import errno
import os
import signal
import sys
import threading
import traceback
from collections.abc import Generator
from contextlib import contextmanager, suppress
from io import FileIO, TextIOWrapper
from typing import NoReturn

from deltaid.errors import DeltaidError, quoted, visible

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
# Address space of `identify` and `torque` on 1,500 rows, with 2 to 8 threads [B]: libraries,
# stacks and heaps of threads. On one core it is 1.4e9.
_NEEDED = 1.9e9
# What tries for ever to begin threads, or to get their memory, where there is none.
_WITH_THREADS = ("polars", "scipy")
# What libraries end a process with, or the system, where memory is lacking.
_FATAL = (signal.SIGABRT, signal.SIGSEGV, signal.SIGILL, signal.SIGFPE)


def open_streams() -> None:
    """Let streams that are closed lead nowhere, or the next file to be opened takes their place.

    Write UTF-8 into files and pipes, and to terminals at least no error over a Greek letter:
    Windows would choose a code page without γ for them, and YAML and JSON are UTF-8 anyway.
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
def written_output() -> Generator[None, None, None]:
    """Write all of standard output before the block ends.

    Raises:
        DeltaidError: it cannot be written.
        BrokenPipeError: nobody reads it any more.
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
        with suppress(OSError):  # Python would write what is left once more, at its end
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
    """A signal asks the process to end."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def cleaning_up() -> Generator[None, None, None]:
    """Leave by the way of errors when told to end, so that no half-written file stays."""

    def on_end(number: int, frame: object) -> None:
        raise EndedError(number)

    names = ("SIGTERM", "SIGHUP") if threading.current_thread() is threading.main_thread() else ()
    signals = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.signal(number, on_end) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def limited_address_space() -> Generator[None, None, None]:
    """Run what is inside in a child process where the address space is limited.

    The parent leaves with the child's exit code.

    Raises:
        DeltaidError: the limit is too low for the libraries that are loaded inside, or the child
            ended without a word.
    """
    limit = _limit()
    if limit is None:
        yield
        return
    said = os.memfd_create("deltaid")  # what libraries write on standard error
    child = os.fork()
    if child:
        _end_as(child, said, limit)
    kept = os.dup(2)
    os.dup2(said, 2)
    sys.stderr = TextIOWrapper(
        FileIO(kept, "w"), encoding="utf-8", errors="replace", line_buffering=True
    )
    if limit < _NEEDED:
        sys.meta_path.insert(0, _Refusal(limit))
    try:
        yield
    except Exception as error:
        if isinstance(error, DeltaidError | BrokenPipeError):
            raise
        os.write(2, "".join(traceback.format_exception_only(error)).encode(errors="replace"))
        os._exit(1)


class _Refusal:
    """Refuses to import what would not end."""

    def __init__(self, limit: int) -> None:
        self.limit = limit

    def find_spec(self, name: str, path: object, target: object = None) -> None:
        """As Python asks for every module; None leaves it to others.

        Raises:
            DeltaidError: the module is one of these libraries.
        """
        if name in _WITH_THREADS:
            raise _error("too little for this command", self.limit)


def _limit() -> int | None:
    """The limit [B], where there is one, and a system that keeps it."""
    if sys.platform != "linux":
        return None
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit == resource.RLIM_INFINITY else limit


def _end_as(child: int, said: int, limit: int) -> NoReturn:
    """Wait for the child, hand on signals to it, and end as it ended."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: os.kill(child, number))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to the child as well
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    os.lseek(said, 0, os.SEEK_SET)
    with open(said, encoding="utf-8", errors="replace") as file:
        lines = file.read().strip().splitlines()
    if -code not in _FATAL and not (code == 1 and lines):
        sys.stderr.writelines(f"{line}\n" for line in lines)
        sys.exit(code if code >= 0 else 128 - code)
    last = f"; its last words: {quoted(visible(lines[-1]))}" if lines else ""
    raise _error(f"the command ended for lack of memory{last}", limit)


def _error(what: str, limit: int) -> DeltaidError:
    return DeltaidError(
        what,
        where=f"address space limited to {limit / 1e9:.2g} GB",
        cure=f"`ulimit -v unlimited`, or at least twice the {_NEEDED / 1e9:.2g} GB that "
        "libraries and threads take; long recordings need little more",
    )
