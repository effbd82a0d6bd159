"""A message and exit code 2 where a library aborts the whole process.

Rust code aborts if it cannot have memory, and one damaged Parquet file in some thousands makes
polars ask for 10¹⁸ bytes. No exception ever arrives then; trying every file in a process of its own
would cost each command a quarter of a second.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def last_words(message: str, descriptor: int) -> Generator[None, None, None]:
    """Write a message on a file descriptor if the process is aborted, and end it with code 2.

    A handler of Python's own would run only after it is too late. Windows has no such signal.
    """
    if sys.platform == "win32":
        yield
        return
    text = f"error: {message}\n".encode(errors="replace")

    def end(_: int) -> None:
        os.write(descriptor, text)
        os._exit(2)

    library = ctypes.CDLL(None)
    library.signal.restype = ctypes.c_void_p
    library.signal.argtypes = [ctypes.c_int, ctypes.c_void_p]
    handler = ctypes.CFUNCTYPE(None, ctypes.c_int)(end)
    before = library.signal(signal.SIGABRT, ctypes.cast(handler, ctypes.c_void_p))
    try:
        yield
    finally:
        library.signal(signal.SIGABRT, before)
