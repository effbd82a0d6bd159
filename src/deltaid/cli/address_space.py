"""A command under a limit of address space, as `ulimit -v` sets it.

Libraries that get no memory abort the process, end it, or try again for ever, and no exception ever
arrives. So the command runs in a child process, and its parent, which loads none of them, says what
happened.
"""

import os
import signal
import sys
import traceback
from collections.abc import Generator
from contextlib import contextmanager
from io import FileIO, TextIOWrapper
from typing import NoReturn

from deltaid.errors import DeltaidError, quoted, visible

# Address space of `identify` and `torque` on 1,500 rows, with 2 to 8 threads [B]: libraries,
# stacks and heaps of threads. On one core it is 1.4e9.
_NEEDED = 1.9e9
# What tries for ever to begin threads, or to get their memory, where there is none.
_WITH_THREADS = ("polars", "scipy")
# What libraries end a process with, or the system, where memory is lacking.
_FATAL = (signal.SIGABRT, signal.SIGSEGV, signal.SIGILL, signal.SIGFPE)


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
