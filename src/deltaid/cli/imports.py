"""Imports of a command without Python's search for garbage among what they make."""

import gc
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def uncollected() -> Generator[None, None, None]:
    """Import in here: modules make a great many objects that stay, and looking through them
    again and again for some that do not takes a fifth of the time."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.freeze()
