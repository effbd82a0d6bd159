"""Files: errors of reading, and writing of each one whole or not at all, or of several together."""

import glob
import os
import secrets
import shutil
import signal
import socket
import sys
import threading
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from deltaid.errors import DeltaidError, visible

if TYPE_CHECKING:
    import polars as pl

# Endings of names of descriptions, mappings and models.
YAML_ENDINGS = (".yaml", ".yml")
# Names that Windows reserves for devices, as a pattern in lower case.
DEVICES = r"con|prn|aux|nul|com\d|lpt\d"
# Ending of the names of files that are being written.
_UNFINISHED = ".part"
# Errors for names that no file can have: too long, a link to itself, a NUL.
_NO_PLACE = (OSError, ValueError, RuntimeError)


@contextmanager
def readable(path: str | Path, kind: type[DeltaidError]) -> Generator[None, None, None]:
    """Convert errors of the operating system about a file to messages.

    Raises:
        DeltaidError: the file is missing, is a folder, or cannot be read; `kind` is its class.
    """
    name = visible(str(path))
    if os.path.isdir(path):  # unlike Path.is_dir it never raises
        cure = "give the name of a file in it"
        raise kind("is a folder, not a file", where=name, cure=cure)
    try:
        if "\0" in str(path):
            raise FileNotFoundError
        yield
    except FileNotFoundError:
        raise kind("no such file", where=name, cure="check its name and folder") from None
    except OSError as error:
        reason = error.strerror or visible(str(error).partition("\n")[0])
        cure = "check its name and permissions"
        raise kind(f"cannot be read: {reason}", where=name, cure=cure) from None


# A path as the user gave it, the resolved path, and the temporary file that will replace it.
_Finished = tuple[Path, Path, Path]
_finished: ContextVar[list[_Finished] | None] = ContextVar("_finished", default=None)


@contextmanager
def together() -> Generator[None, None, None]:
    """All files written inside the block appear at its end, or none of them.

    Temporary files lie beside their targets, so the final renames need no space. Missing
    folders are made at the end too. A nested block is a part of the outer one.

    Signals that can be caught wait until all files have their names. SIGKILL or a power failure
    within that millisecond leaves the first of them new and the others old.

    Raises:
        DeltaidError: a folder cannot be made, or a place has been taken meanwhile.
    """
    if _finished.get() is not None:
        yield
        return
    finished: list[_Finished] = []
    token = _finished.set(finished)
    try:
        yield
        _appear(finished)
    finally:
        _finished.reset(token)
        for _, _, temporary in finished:
            temporary.unlink(missing_ok=True)


@contextmanager
def written_whole(path: Path) -> Generator[TextIO, None, None]:
    """A text file that appears under its name only when it is complete.

    Raises:
        DeltaidError: it cannot be written.
    """
    with _replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        yield file


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes to a file, whole or not at all.

    Raises:
        DeltaidError: it cannot be written.
    """
    with _replacing(path) as temporary:
        temporary.write_bytes(data)


def write_csv(path: Path, parts: Iterable["pl.DataFrame"]) -> None:
    """Write consecutive parts of a table, whole or not at all, with one of them in memory.

    Raises:
        DeltaidError: the file cannot be written.
    """
    with written_whole(path) as file:
        for k, part in enumerate(parts):
            file.write(part.write_csv(include_header=k == 0))


def require_writable(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Check before a long computation that its result can be written.

    Raises:
        DeltaidError: it cannot, or the file is one of the inputs, which are never overwritten.
    """
    for given in inputs:
        if os.path.exists(given) and os.path.exists(path) and os.path.samefile(given, path):
            raise DeltaidError("would overwrite an input; give another name", where=str(path))
    _begin(path)[1].unlink(missing_ok=True)


@contextmanager
def _replacing(path: Path) -> Generator[Path, None, None]:
    """A temporary file that replaces the one at this path when it is complete."""
    with together():
        (target, temporary), complete = _begin(path), False
        try:
            with refusing(path):
                yield temporary
                complete = True
        finally:
            if not complete:
                temporary.unlink(missing_ok=True)
        finished = _finished.get()
        assert finished is not None
        finished.append((path, target, temporary))


def _begin(path: Path) -> tuple[Path, Path]:
    """The resolved path, and a new temporary file in its folder or the nearest existing one."""
    with refusing(path, kinds=_NO_PLACE):
        target = path.resolve()  # keeps a link, and replaces its target
        if target.is_dir():
            raise DeltaidError("is a folder; give the name of a file", where=str(path))
        if target.exists() and not target.is_file():
            raise DeltaidError("is no regular file; give another name", where=str(path))
        folder = next(folder for folder in target.parents if folder.exists())
        if not folder.is_dir():
            raise DeltaidError(
                f"cannot be written: {folder} is a file, not a folder",
                where=str(path),
                cure="give a name in another folder",
            )
        _remove_abandoned(folder)
        temporary = folder / _new_name()
        temporary.touch(exist_ok=False)
        return target, temporary


def _prefix() -> str:
    return f".deltaid-{socket.gethostname()}-"


def _new_name() -> str:
    return f"{_prefix()}{os.getpid()}-{secrets.token_hex(8)}{_UNFINISHED}"


def _remove_abandoned(folder: Path) -> None:
    """Remove unfinished files and folders that killed processes of this machine have left."""
    if sys.platform == "win32":  # here Python cannot ask whether a process is alive
        return
    for path in folder.glob(f"{glob.escape(_prefix())}*{_UNFINISHED}"):
        process = path.name.removeprefix(_prefix()).partition("-")[0]
        if process.isdecimal() and not _is_alive(int(process)):
            with suppress(OSError):
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _is_alive(process: int) -> bool:
    try:
        with suppress(PermissionError, OverflowError):  # of another account, but alive
            os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@contextmanager
def handling_signals(handler: Callable[[int, object], object], *names: str) -> Generator[None]:
    """Handle signals by a function while the block runs, in the main thread, as Python can."""
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    is_main = threading.current_thread() is threading.main_thread()
    with ExitStack() as after:
        for number in numbers if is_main else ():
            if signal.getsignal(number) is not None:
                after.callback(signal.signal, number, signal.signal(number, handler))
        yield


@contextmanager
def _signals_held() -> Generator[None, None, None]:
    """Hold back signals that end the process until the block has ended.

    This uses handlers and not the thread's signal mask: the system may deliver a signal to any
    other thread, and Python would still run its handler in this one.
    """
    held: list[int] = []
    with handling_signals(lambda number, _: held.append(number), "SIGINT", "SIGTERM", "SIGHUP"):
        yield
    for number in held:
        signal.raise_signal(number)


def _appear(finished: list[_Finished]) -> None:
    """Make missing folders, then give all files their names."""
    made: list[Path] = []
    try:
        for path, target, _ in finished:
            with refusing(path):
                for folder in reversed(target.parents):
                    if not folder.is_dir():
                        folder.mkdir(exist_ok=True)  # another process may make it just now
                        made.append(folder)
        with _signals_held():
            for path, target, temporary in finished:
                with refusing(path):
                    temporary.replace(target)
    except DeltaidError:
        for folder in reversed(made):  # only the empty ones
            with suppress(OSError):
                folder.rmdir()
        raise


@contextmanager
def refusing(
    path: str | Path, what: str = "cannot be written",
    cure: str = "check the folder's permissions and the space left, or give another place",
    kinds: tuple[type[Exception], ...] = (OSError,),
) -> Generator[None, None, None]:  # fmt: skip
    """Turn a failure inside into an error that says what cannot be done with which path, and why.

    Raises:
        DeltaidError: an error of one of these kinds was raised.
    """
    try:
        yield
    except kinds as error:
        reason, where = getattr(error, "strerror", None) or error, str(path).replace("\0", "\\0")
        raise DeltaidError(f"{what}: {reason}", where=where, cure=cure) from None


@contextmanager
def new_folder(path: Path) -> Generator[Path, None, None]:
    """A folder to fill, which appears under its name with all its files, or not at all.

    Raises:
        DeltaidError: the name is taken, or the folder cannot be written.
    """
    target = _free_place(path)
    with refusing(path, kinds=_NO_PLACE):
        parent = next(folder for folder in target.parents if folder.is_dir())
        _remove_abandoned(parent)
        temporary = parent / _new_name()
        temporary.mkdir()
    try:
        with refusing(path):
            yield temporary
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary.rename(_free_place(path))
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def require_new_folder(path: Path) -> None:
    """Check before a long computation that a new folder can be made.

    Raises:
        DeltaidError: it cannot, or the name is taken.
    """
    target = _free_place(path)
    parent = next(folder for folder in target.parents if folder.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise DeltaidError(
            f"cannot be made in {parent}",
            where=str(path),
            cure="check the folder's permissions, or give another place",
        )


def resolved(path: Path) -> Path:
    """The path without links.

    Raises:
        DeltaidError: it holds a NUL, or a link to itself.
    """
    with refusing(path, kinds=_NO_PLACE):
        return path.resolve()


def _free_place(path: Path) -> Path:
    target = resolved(path)
    if os.path.lexists(target):
        raise DeltaidError(
            "is there already", where=str(path), cure="give the name of a new folder, or remove it"
        )
    return target
