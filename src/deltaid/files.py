"""Writing files whole or not at all."""

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from deltaid.errors import DeltaidError


@contextmanager
def written_whole(path: Path) -> Iterator[TextIO]:
    """A text file that appears under its name only when everything has been written.

    Raises:
        DeltaidError: the folder does not exist or cannot be written to.
    """
    with (
        _replacing(path) as handle,
        os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file,
    ):
        yield file


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes under a name all at once.

    Raises:
        DeltaidError: the folder does not exist or cannot be written to.
    """
    with _replacing(path) as handle, os.fdopen(handle, "wb") as file:
        file.write(data)


def require_writable(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Find out before a long computation whether its result can be written.

    Raises:
        DeltaidError: the folder does not exist or cannot be written to, or the file is one of the
            inputs, which are never overwritten.
    """
    for given in inputs:
        if os.path.exists(given) and os.path.exists(path) and os.path.samefile(given, path):
            raise DeltaidError("would overwrite an input; give another name", where=str(path))
    _, handle, name = _begin(path)
    os.close(handle)
    Path(name).unlink(missing_ok=True)


@contextmanager
def _replacing(path: Path) -> Iterator[int]:
    """The handle of a temporary file that takes a path's place at the end."""
    target, handle, name = _begin(path)
    temporary = Path(name)
    try:
        yield handle
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except OSError as error:
        raise _failure(path, error) from None
    finally:
        temporary.unlink(missing_ok=True)


def _begin(path: Path) -> tuple[Path, int, str]:
    """Where a path leads, and an open temporary file beside it."""
    try:
        target = path.resolve()  # a link stays a link
        if target.is_dir():
            raise DeltaidError("is a folder; give the name of a file", where=str(path))
        if target.exists() and not target.is_file():
            raise DeltaidError("is no regular file", where=str(path))
        if not target.parent.is_dir():
            raise DeltaidError(
                "cannot be written: its folder does not exist",
                where=str(path),
                cure="make it first",
            )
        return target, *tempfile.mkstemp(dir=target.parent, prefix=".", suffix=".part")
    except OSError as error:
        raise _failure(path, error) from None


def _failure(path: Path, error: OSError) -> DeltaidError:
    return DeltaidError(f"cannot be written: {error.strerror or error}", where=str(path))


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
