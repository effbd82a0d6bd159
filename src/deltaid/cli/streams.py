"""Standard input and output that are closed, full, or have lost their reader."""

import errno
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress

from deltaid.errors import DeltaidError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)


def open_closed_streams() -> None:
    """Let streams that are closed lead nowhere, or the next file to be opened takes their place."""
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, "w" if descriptor else "r", encoding="utf-8")  # noqa: SIM115
            if stream.fileno() != descriptor and sys.platform != "win32":
                os.dup2(stream.fileno(), descriptor)
            setattr(sys, name, stream)


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
    except BrokenPipeError:
        _discard_output()
        raise
    except OSError as error:
        if error.errno not in _FULL or error.filename is not None:
            raise
        _discard_output()
        raise DeltaidError(
            f"cannot be written: {error.strerror}",
            where="standard output",
            cure="check the space left, or send it elsewhere; files that were asked for may be "
            "complete",
        ) from None


def _discard_output() -> None:
    """Python would write what is left once more, at its end."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
