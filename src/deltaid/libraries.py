"""Libraries that only some commands need, and that are extras."""

from importlib.util import find_spec

from deltaid.errors import DeltaidError


def require(module: str, *, by: str, name: str, install: str) -> None:
    """Find out whether a library is there, without importing it.

    Args:
        module: its name in Python.
        by: what needs it, a command or an option.
        name: its name in words.
        install: what to call to have it.

    Raises:
        DeltaidError: it is not installed.
    """
    if find_spec(module) is None:
        raise DeltaidError(f"needs {name}, which is not installed", where=by, cure=install)
